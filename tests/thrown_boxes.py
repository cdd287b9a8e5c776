"""Random boxes on their corners, thrown onto a floor: all laws, restitutions, resistances to turning, steps."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import pincontact as pc


def random_law(rng: np.random.Generator) -> pc.FrictionLaw | None:
    """Every law, with and without resistance to turning."""
    turning = {name: 10.0 ** rng.uniform(-4.0, -2.0) for name in ("spinning", "rolling") if rng.random() < 0.5}
    mu = float(rng.choice([0.1, 0.2, 0.5, 1.0]))
    kind = rng.integers(6)
    if kind == 0:
        return None
    if kind == 1:
        return pc.NoSlip(**turning)
    if kind == 2:
        return pc.Stribeck(mu, 1.5 * mu, 0.05, **turning)
    if kind == 3:
        return pc.Coulomb((mu, 0.5 * mu), along="floor", **turning)
    return pc.Coulomb(mu, 1.2 * mu if rng.random() < 0.3 else None, viscous=0.3 if kind == 4 else 0.0, **turning)


RANDOM = pc.Coulomb(0.0)


def thrown_box(
    seed: int, law: pc.FrictionLaw | None = RANDOM, bounce: float | None = None
) -> tuple[pc.Scene, pc.State, float]:
    """A scene, its state, and the size of a step in s; a law and a restitution for all contacts, or random ones."""
    rng = np.random.default_rng(seed)
    half = rng.uniform(0.05, 0.3, 3)
    mass, moments = 1.0, (half @ half - half**2) / 3.0
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "box")
    model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), np.diag(moments)), pin.SE3.Identity())
    model.addFrame(pin.Frame("box", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    scene = pc.Scene(model)
    floor = scene.add_contour("floor", pc.Plane())
    alike, laws, bounces = rng.random() < 0.5, random_law(rng), float(rng.choice([0.0, 0.3, 0.6, 1.0]))
    signs = [(x, y, z) for x in (1, -1) for y in (1, -1) for z in (1, -1)][:: 1 if rng.random() < 0.5 else -1]
    for k, sign in enumerate(signs):
        if not alike:
            laws, bounces = random_law(rng), float(rng.choice([0.0, 0.3, 0.6, 1.0]))
        corner = scene.add_contour(f"p{k}", pc.Point(), "box", pin.SE3(np.eye(3), half * sign))
        friction, restitution = laws if law is RANDOM else law, bounces if bounce is None else bounce
        scene.add_contact(f"p{k}", corner, floor, friction=friction, restitution=restitution)
    if rng.random() < 0.5:
        # lands flat, or nearly
        turned = pin.exp3(
            np.array([0.0, 0.0, rng.uniform(-3.0, 3.0)]) + rng.choice([0.0, 1e-3, 1e-2]) * rng.normal(size=3)
        )
        spin = rng.choice([0.0, 0.1, 1.0]) * rng.normal(size=3)
    else:
        turned, spin = pin.exp3(2.0 * rng.normal(size=3)), 3.0 * rng.normal(size=3)
    lowest = min(float(turned[2] @ (half * sign)) for sign in signs)
    q = np.r_[0.0, 0.0, rng.choice([1e-3, 0.02, 0.1]) - lowest, pin.Quaternion(turned).coeffs()]
    v = np.r_[turned.T @ (rng.normal(size=3) * [1.0, 1.0, 0.3]), spin]
    state = scene.initial_state(q, v, free=[f"p{k}" for k in range(8)])
    return scene, state, float(rng.choice([1e-3, 2e-3, 5e-3, 1e-2]))
