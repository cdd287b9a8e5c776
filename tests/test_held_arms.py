"""An arm whose dry joints, and whose rough tip that a line guides, hold it together until no forces do."""

import math

import numpy as np
import pinocchio as pin
from scipy.optimize import linprog

import pincontact as pc

MU, LIMITS = 0.67, np.array([0.29335, 0.2152])
START = np.array([0.63089, -0.27934])
# of the pulse of torque that draws it, in s
BEGINS, LASTS = 0.1786, 0.1362


def _torque(t, q=None, v=None):
    phase = (t - BEGINS) / LASTS
    drawn = math.sin(math.pi * phase) ** 4 if 0.0 < phase < 1.0 else 0.0
    return np.array([-0.86873, 0.21171]) + drawn * np.array([0.16257, -3.46534])


def _arm():
    """The scene, its weight in N m at the start, and rows of the tip's velocity along and across the line."""
    model, parent, place = pin.Model(), 0, pin.SE3.Identity()
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    for name, mass, length, moment in (("j0", 0.41, 0.309, 0.00305), ("j1", 1.32, 0.3814, 0.0177)):
        parent = model.addJoint(parent, pin.JointModelRZ(), place, name)
        body = pin.Inertia(mass, np.array([0.5 * length, 0.0, 0.0]), moment * np.eye(3))
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
        place = pin.SE3(np.eye(3), np.array([length, 0.0, 0.0]))
    tip = model.addFrame(pin.Frame("tip", parent, 0, place, pin.FrameType.OP_FRAME))
    model.lowerDryFrictionLimit[:], model.upperDryFrictionLimit[:] = -LIMITS, LIMITS
    data = model.createData()
    pin.computeJointJacobians(model, data, START)
    pin.updateFramePlacements(model, data)
    line = pin.SE3(pin.utils.rotate("z", 2.0638), data.oMf[tip].translation)
    scene = pc.Scene(model)
    scene.add_contour("tip", pc.Point(), "tip")
    scene.add_contour("line", pc.Line(), placement=line)
    scene.add_contact("c", "tip", "line", friction=pc.Coulomb(MU), bilateral=True, pattern="P-2C")
    rows = line.rotation.T @ pin.getFrameJacobian(model, data, tip, pin.LOCAL_WORLD_ALIGNED)[:3]
    return scene, pin.computeGeneralizedGravity(model, data, START), rows[:2]


def _is_held(weight, rows, side, t):
    """Whether forces inside their bounds hold the arm at rest; side: that of the line on which its load is."""
    # friction along the line, the load, and friction of the joints
    found = linprog(
        np.zeros(4),
        A_ub=[[1.0, -MU, 0.0, 0.0], [-1.0, -MU, 0.0, 0.0]],
        b_ub=np.zeros(2),
        A_eq=np.column_stack([rows[0], side * rows[1], np.eye(2)]),
        b_eq=weight - _torque(t),
        bounds=[(None, None), (0.0, None), *((-limit, limit) for limit in LIMITS)],
    )
    return found.status == 0


def test_holds_as_long_as_forces_do():
    """It comes to rest from a slow motion, with all joints at once: which of them slides then is none of it."""
    scene, weight, rows = _arm()
    v = np.linalg.solve(rows, [0.003, 0.0])
    times = np.arange(0.0, 0.23, 1e-3)
    run = pc.simulate(scene, scene.initial_state(START, v), times[-1], control=_torque, t_eval=times)
    assert run.status == 0, run.message
    rests = np.abs(run.v).max(axis=1) <= 1e-9
    begins = int(np.argmax(rests))
    held = [[_is_held(weight, rows, side, t) for t in times[begins:]] for side in (-1.0, 1.0)]
    # only one side holds it at first; the load does not leave that side while there are forces
    (side,) = [side for side in held if side[0]]
    assert side.index(False) * 1e-3 > 0.02 and not any(side[side.index(False) :])
    assert rests[begins:].tolist() == side
