"""MuJoCo's model of a file beside Pinocchio's: the same coordinates, mass matrix, bias and joint forces."""

import mujoco
import numpy as np
import pinocchio as pin


class Peer:
    """MuJoCo's model of an MJCF file, in Pinocchio's coordinates.

    Quaternions change their order, and the velocity of a free body is in its own axes instead of the world's.
    """

    def __init__(self, path):
        self.model = mujoco.MjModel.from_xml_path(str(path))
        # contacts are no part of what is compared
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        # shapes that are where a body or its inertia is, to single precision, would be put there
        self.model.geom_sameframe[:] = 0
        self.data = mujoco.MjData(self.model)
        free, ball = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
        joints = list(zip(self.model.jnt_type, self.model.jnt_qposadr, self.model.jnt_dofadr))
        self.free = [(q, v) for kind, q, v in joints if kind == free]
        self._quaternions = [q + 3 for q, _ in self.free] + [q for kind, q, _ in joints if kind == ball]

    def to_mujoco(self, q):
        return self._rolled(q, 1)

    def to_pinocchio(self, qpos):
        return self._rolled(qpos, -1)

    def _rolled(self, q, by):
        out = np.array(q)
        for start in self._quaternions:
            out[start : start + 4] = np.roll(out[start : start + 4], by)
        return out

    def velocity_map(self, q, v):
        """S with qvel = S v, and S' v."""
        s, rate = np.eye(self.model.nv), np.zeros(self.model.nv)
        for iq, iv in self.free:
            r = pin.XYZQUATToSE3(np.array(q[iq : iq + 7])).rotation
            s[iv : iv + 3, iv : iv + 3] = r
            rate[iv : iv + 3] = r @ np.cross(v[iv + 3 : iv + 6], v[iv : iv + 3])
        return s, rate

    def set(self, q, v):
        self.data.qpos[:] = self.to_mujoco(q)
        self.data.qvel[:] = self.velocity_map(q, v)[0] @ v
        mujoco.mj_forward(self.model, self.data)

    def mass_and_bias(self, q, v):
        """M (nv, nv) and the bias forces (nv,) in Pinocchio's coordinates."""
        self.set(q, v)
        s, rate = self.velocity_map(q, v)
        mass = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, mass)
        return s.T @ mass @ s, s.T @ (self.data.qfrc_bias + mass @ rate)

    def frames(self):
        """Name, kind, position (3,) and rotation (9,) of bodies and of sites with a name, as last set."""
        for i in range(1, self.model.nbody):
            name = self.model.body(i).name or f"body_{i}"
            yield name, pin.FrameType.BODY, self.data.xpos[i], self.data.xmat[i]
        for i in range(self.model.nsite):
            if self.model.site(i).name:
                yield self.model.site(i).name, pin.FrameType.OP_FRAME, self.data.site_xpos[i], self.data.site_xmat[i]

    def gravity(self):
        """(3,) in m/s^2, zero where it is switched off."""
        off = self.model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
        return np.zeros(3) if off else self.model.opt.gravity

    def limits(self):
        """(nq, 2) of hinges and slides, infinite where there are none."""
        out = np.tile([-np.inf, np.inf], (self.model.nq, 1))
        for kind, limited, ends, q in zip(
            self.model.jnt_type, self.model.jnt_limited, self.model.jnt_range, self.model.jnt_qposadr
        ):
            if limited and kind in (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)):
                out[q] = ends
        return out
