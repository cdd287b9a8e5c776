"""Pinocchio's own constraint dynamics with points of the bodies held fixed, in a classical RK4 loop; and where contacts
slip and open its solver of contact problems in the steps that are made with it, as in the simulator Simple."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from .measure import Case, Engine, Unsupported
from .pinocchio_model import build_model
from .problem import WORLD, Problem, marked

STEPS = (1, 2, 3, 5, 10, 20, 50, 100, 200)
EVENT_STEPS = (5, 10, 20, 50, 200, 500, 2000)
# of the contact problems
ACCURACY = 1e-10


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


class _Stepping:
    """Steps of the symplectic Euler rule: the velocity by an ADMM solution of the contact problem, dampers implicit,
    then the configuration. Gaps close at the end of a step, without rebound."""

    def __init__(self, problem: Problem, step: float) -> None:
        self.model = model = build_model(problem)
        self.data, self.step = model.createData(), step
        self.stiffness, self.rest = np.zeros(model.nv), np.zeros(model.nv)
        self.angles = np.zeros(model.nv, dtype=int)
        for body, (iq, iv) in zip(problem.bodies, problem.slices().values()):
            self.stiffness[iv], self.rest[iv], self.angles[iv] = body.stiffness, body.rest, iq.start
        self.damping = np.array(model.damping)
        # what dampers add to the mass matrix
        self.added = step * self.damping
        self.models, self.datas = pin.StdVec_ConstraintModel(), pin.StdVec_ConstraintData()
        self.touches = []
        for touch in problem.touches:
            kinds = touch.first.kind, touch.second.kind
            if kinds not in (("point", "plane"), ("sphere", "plane")):
                raise Unsupported(f"the loop is for points and spheres on planes, not for a {' on a '.join(kinds)}")
            contact = pin.PointContactConstraintModel(model, 0)
            contact.setFriction(touch.mu)
            self.models.append(pin.ConstraintModel(contact))
            self.datas.append(self.models[-1].createData())
            radius = touch.first.size[0] if touch.first.size else 0.0
            bodies = touch.first.body, touch.second.body
            joints = [0 if body == WORLD else model.getJointId(f"{body} joint") for body in bodies]
            self.touches.append((*joints, np.array(touch.first.place), np.array(touch.second.place), radius))
        self.solver = pin.ADMMConstraintSolver(3 * len(self.touches))
        self.settings = pin.ADMMSolverSettings()
        for which in ("absolute", "relative"):
            for what in ("feasibility", "complementarity"):
                setattr(self.settings, f"{which}_{what}_tol", ACCURACY)
        self.settings.max_iterations = 1000
        self.rows = np.empty((3 * len(self.touches), model.nv))
        self.impulses = np.zeros(len(self.rows))

    def _rows_at(self, joint: int, x: np.ndarray) -> np.ndarray:
        """Velocity (3, nv) in world axes of the point x of a joint's body."""
        if joint == 0:
            return np.zeros((3, self.model.nv))
        jacobian = pin.getJointJacobian(self.model, self.data, joint, pin.LOCAL_WORLD_ALIGNED)
        a, b, c = x - self.data.oMi[joint].translation
        return jacobian[:3] + np.array([[0.0, c, -b], [-c, 0.0, a], [b, -a, 0.0]]) @ jacobian[3:]

    def advance(self, q: np.ndarray, v: np.ndarray, force: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        model, data, h = self.model, self.data, self.step
        pin.computeAllTerms(model, data, q, v)
        gaps = np.zeros(len(self.rows))
        for i, (first, second, place, plane, radius) in enumerate(self.touches):
            x = data.oMi[first].act(place)
            x[2] -= radius
            gaps[3 * i + 2] = (x[2] - data.oMi[second].act(plane)[2]) / h
            rows = self._rows_at(first, x)
            self.rows[3 * i : 3 * i + 3] = rows - self._rows_at(second, x) if second else rows
        tau = self.stiffness * (self.rest - q[self.angles]) - self.damping * v - data.nle
        if force is not None:
            tau += force
        mass = data.M
        mass = np.triu(mass) + np.triu(mass, 1).T
        mass[np.diag_indices_from(mass)] += self.added
        solved = np.linalg.solve(mass, np.column_stack([tau, self.rows.T]))
        after = v + h * solved[:, 0]
        result = pin.ADMMSolverResult()
        result.setConstraintImpulseGuess(self.impulses)
        delassus = pin.DelassusOperatorDense(self.rows @ solved[:, 1:])
        self.solver.solve(delassus, self.rows @ after + gaps, self.models, self.datas, self.settings, result)
        self.impulses = np.array(result.retrieveConstraintImpulses())
        after += solved[:, 1:] @ self.impulses
        return pin.integrate(model, q, h * after), after


def stepped(problem: Problem, each: int) -> Case:
    """A run in steps with impulses."""
    steps = each * problem.intervals
    h = problem.duration / steps
    stepping = _Stepping(problem, h)
    # with the value of the steps' middles
    forces = None if problem.drive is None else problem.drive(h * (np.arange(steps) + 0.5))

    def run() -> np.ndarray:
        q, v = problem.q.copy(), problem.v.copy()
        stepping.impulses = np.zeros(len(stepping.rows))
        rows = np.empty((problem.intervals + 1, q.size))
        rows[0] = q
        for n in range(steps):
            q, v = stepping.advance(q, v, None if forces is None else forces[n])
            if (n + 1) % each == 0:
                rows[(n + 1) // each] = q
        return rows

    return Case("ADMM", f"step {h:.3g} s", run, lambda rows: marked(problem, rows), lambda rows: {"steps": steps})


def _cases(problem: Problem) -> Iterator[Case]:
    if problem.events:
        for each in EVENT_STEPS:
            yield stepped(problem, each)
        return
    for each in STEPS:
        yield case(problem, each)


ENGINE = Engine(
    "Pinocchio",
    lambda: pin.__version__,
    _cases,
    {
        "RK4": "constraintDynamics with 3D contacts, one proximal iteration, in a Python loop with constant steps",
        "ADMM": "ADMMConstraintSolver to 1e-10, warm, in a Python loop of symplectic Euler steps with implicit dampers",
    },
)
