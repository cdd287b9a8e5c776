"""Pinocchio's own constraint dynamics with points of the bodies held fixed, in a classical RK4 loop."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from .measure import Case, Engine, Unsupported
from .pinocchio_model import build_model
from .scenes import Problem, marked

STEPS = (1, 2, 3, 5, 10, 20, 50, 100, 200)


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
    if problem.bodies[0].joint != "free":
        raise Unsupported("the loop is written for a floating base")
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

    def slope(q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """dq/dt, with the base's quaternion as four numbers so that RK4 keeps its order, and dv/dt."""
        tau = preload - stiffness * q[angles] - damping * v
        a = pin.constraintDynamics(model, data, q, v, tau, constraints, memory, settings)
        x, y, z, w = q[3:7]
        p, r, s = v[3:6]
        rate[:3] = data.oMi[1].rotation @ v[:3]
        rate[3:7] = (
            0.5 * (w * p + y * s - z * r),
            0.5 * (w * r + z * p - x * s),
            0.5 * (w * s + x * r - y * p),
            -0.5 * (x * p + y * r + z * s),
        )
        rate[7:] = v[6:]
        return rate.copy(), a.copy()

    rate = np.empty(model.nq)

    def run() -> np.ndarray:
        q, v = problem.q.copy(), problem.v.copy()
        rows = np.empty((problem.intervals + 1, model.nq))
        rows[0] = q
        for i in range(problem.intervals):
            for _ in range(each):
                q1, a1 = slope(q, v)
                q2, a2 = slope(q + 0.5 * h * q1, v + 0.5 * h * a1)
                q3, a3 = slope(q + 0.5 * h * q2, v + 0.5 * h * a2)
                q4, a4 = slope(q + h * q3, v + h * a3)
                q = q + h / 6.0 * (q1 + 2.0 * q2 + 2.0 * q3 + q4)
                v = v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
                q[3:7] /= math.sqrt(q[3:7] @ q[3:7])
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


ENGINE = Engine(
    "Pinocchio",
    lambda: pin.__version__,
    _cases,
    {"RK4": "constraintDynamics with 3D contacts, one proximal iteration, in a Python loop of RK4 with constant steps"},
)
