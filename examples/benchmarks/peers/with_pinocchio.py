"""Pinocchio's own constraint dynamics with points of the bodies held fixed, in a classical RK4 loop."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from .measure import Case, Engine, Unsupported
from .pinocchio_model import build_model
from .scenes import Problem, marked

STEPS = (1, 2, 5, 10, 20, 50, 100, 200)


def case(problem: Problem, each: int) -> Case:
    model = build_model(problem)
    constraints = pin.StdVec_RigidConstraintModel()
    for touch in problem.touches:
        if (touch.first.kind, touch.second.kind) != ("point", "plane"):
            raise Unsupported("its contact points are fixed to the bodies: nothing that rolls or slides along a shape")
        joint = model.getJointId(f"{touch.first.body} joint")
        at = pin.SE3(np.eye(3), np.array(touch.first.place))
        data = model.createData()
        pin.forwardKinematics(model, data, problem.q)
        there = pin.SE3(np.eye(3), (data.oMi[joint] * at).translation)
        # no stabilisation, its default: the start is consistent and the drift of RK4 is of its own order
        constraints.append(
            pin.RigidConstraintModel(
                pin.ContactType.CONTACT_3D, model, joint, at, 0, there, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            )
        )
    memory = pin.StdVec_RigidConstraintData()
    memory.extend([c.createData() for c in constraints])
    data = model.createData()
    pin.initConstraintDynamics(model, data, constraints, memory)
    stiffness, rest, damping = (np.zeros(model.nv) for _ in range(3))
    angles = np.zeros(model.nv, dtype=int)
    for body, (iq, iv) in zip(problem.bodies, problem.slices().values()):
        stiffness[iv], rest[iv], damping[iv] = body.stiffness, body.rest, body.damping
        angles[iv] = iq.start
    preload = stiffness * rest
    settings = pin.ProximalSettings(1e-14, 0.0, 1)
    h = problem.duration / (problem.intervals * each)

    def acceleration(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        tau = preload - stiffness * q[angles] - damping * v
        return pin.constraintDynamics(model, data, q, v, tau, constraints, memory, settings).copy()

    def run() -> np.ndarray:
        q, v = problem.q.copy(), problem.v.copy()
        rows = np.empty((problem.intervals + 1, model.nq))
        rows[0] = q
        for i in range(problem.intervals):
            for _ in range(each):
                a1 = acceleration(q, v)
                v2 = v + 0.5 * h * a1
                a2 = acceleration(pin.integrate(model, q, 0.5 * h * v), v2)
                v3 = v + 0.5 * h * a2
                a3 = acceleration(pin.integrate(model, q, 0.5 * h * v2), v3)
                v4 = v + h * a3
                a4 = acceleration(pin.integrate(model, q, h * v3), v4)
                q = pin.integrate(model, q, h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4))
                v = v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
            rows[i + 1] = q
        return rows

    steps = each * problem.intervals
    return Case(
        "RK4",
        f"step {h:.3g} s",
        run,
        lambda rows: marked(problem, rows),
        lambda rows: {"steps": steps, "evaluations": 4 * steps},
    )


def _cases(problem: Problem) -> Iterator[Case]:
    for each in STEPS:
        yield case(problem, each)


ENGINE = Engine("Pinocchio", lambda: pin.__version__, _cases, {})
