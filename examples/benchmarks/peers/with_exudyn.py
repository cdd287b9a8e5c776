"""Exudyn: ideal rolling discs and spherical joints where the scene has them, contacts by penalty elsewhere."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from .measure import Case, Engine, Unsupported
from .problem import NO_SLIP, WORLD, Problem, Touch, poses, skew

SOLVERS = {"trapezoidal": "TrapezoidalIndex2", "generalized alpha": "GeneralizedAlpha"}
STEPS = (2, 5, 20, 50, 200, 500, 2000, 5000)  # at 1 its bicycle does not end
STIFFNESS, DAMPING, SLIP_ZONE = 1e6, 1e2, 1e-4
STICKY = 10.0
FAR = 10.0  # m, corners of the triangle that stands for a plane


def _basis(axis: np.ndarray) -> np.ndarray:
    """A rotation whose z is the axis."""
    axis = np.asarray(axis) / np.linalg.norm(axis)
    aside = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(aside, axis)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])


class _Builder:
    """A system with the scene in it and a sensor for each marker."""

    def __init__(self, problem: Problem) -> None:
        if problem.drive is not None:
            raise Unsupported("not set up for forces that are functions of time")
        import exudyn
        import exudyn.utilities as items

        self.problem, self.items = problem, items
        self.container = exudyn.SystemContainer()
        self.system = self.container.AddSystem()
        self.ground = self.system.AddObject(items.ObjectGround())
        self.bodies = {WORLD: self.ground}
        self.penalty = False
        self._bodies()
        for touch in problem.touches:
            self._touch(touch)
        self.sensors = [
            self.system.AddSensor(
                items.SensorBody(
                    bodyNumber=self.bodies[name],
                    localPosition=list(point),
                    storeInternal=True,
                    outputVariableType=exudyn.OutputVariableType.Position,
                )
            )
            for name, point in problem.markers
        ]
        self.system.Assemble()

    def marker(self, body: str, place) -> Any:
        return self.system.AddMarker(
            self.items.MarkerBodyRigid(bodyNumber=self.bodies[body], localPosition=[float(x) for x in place])
        )

    def _bodies(self) -> None:
        items, problem = self.items, self.problem
        where = poses(problem, problem.q, problem.v)
        rest = poses(problem, _reference(problem))
        for body in problem.bodies:
            if body.joint == "translation":
                raise Unsupported("no fixed curve among its constraints")
            pose, com = where[body.name], np.array(body.com)
            about_origin = np.array(body.inertia) - body.mass * skew(com) @ skew(com)
            inertia = items.RigidBodyInertia(mass=body.mass, inertiaTensor=about_origin, com=com)
            self.bodies[body.name] = self.system.CreateRigidBody(
                inertia=inertia,
                referencePosition=list(rest[body.name].place),
                referenceRotationMatrix=rest[body.name].turn,
                initialDisplacement=list(pose.place - rest[body.name].place),
                initialRotationMatrix=rest[body.name].turn.T @ pose.turn,
                initialVelocity=list(pose.velocity),
                initialAngularVelocity=list(pose.omega),
                gravity=list(problem.gravity),
            )
            if body.joint == "free":
                continue
            here, there = self.marker(body.name, (0, 0, 0)), self.marker(body.parent, body.place)
            own = _basis(np.array(body.axis))
            carried = np.array(body.turn) @ own
            if body.joint == "revolute":
                axes = [1, 1, 1, 1, 1, 0]
            else:
                axes = [1, 1, 0, 1, 1, 1]
            self.system.AddObject(
                items.ObjectJointGeneric(
                    markerNumbers=[there, here], constrainedAxes=axes, rotationMarker0=carried, rotationMarker1=own
                )
            )
            if body.stiffness or body.damping:
                node = self.system.AddNode(items.NodeGenericData(initialCoordinates=[0.0], numberOfDataCoordinates=1))
                self.system.AddObject(
                    items.ObjectConnectorTorsionalSpringDamper(
                        markerNumbers=[there, here],
                        nodeNumber=node,
                        stiffness=body.stiffness,
                        damping=body.damping,
                        offset=body.rest,
                        rotationMarker0=carried,
                        rotationMarker1=own,
                    )
                )

    def _touch(self, touch: Touch) -> None:
        import exudyn

        items, first, second = self.items, touch.first, touch.second
        kinds = (first.kind, second.kind)
        if kinds == ("disk", "plane"):
            markers = [self.marker(second.body, second.place), self.marker(first.body, first.place)]
            common = {"markerNumbers": markers, "discRadius": first.size[0], "discAxis": [0, 0, 1]}
            if touch.mu == NO_SLIP:
                self.system.AddObject(items.ObjectJointRollingDisc(**common))
                return
            self.penalty = True
            node = self.system.AddNode(items.NodeGenericData(initialCoordinates=[0.0] * 3, numberOfDataCoordinates=3))
            self.system.AddObject(
                items.ObjectConnectorRollingDiscPenalty(
                    **common,
                    nodeNumber=node,
                    contactStiffness=STIFFNESS,
                    contactDamping=DAMPING,
                    dryFriction=[touch.mu, touch.mu],
                    dryFrictionProportionalZone=SLIP_ZONE,
                    useLinearProportionalZone=True,
                )
            )
        elif kinds == ("point", "plane") and not self.problem.events:
            pose = poses(self.problem, self.problem.q)[first.body]
            foot = pose.place + pose.turn @ np.array(first.place)
            self.system.AddObject(
                items.ObjectJointSpherical(
                    markerNumbers=[self.marker(WORLD, foot), self.marker(first.body, first.place)],
                    constrainedAxes=[1, 1, 1],
                )
            )
        elif kinds in (("sphere", "sphere"), ("sphere", "bowl"), ("sphere", "plane")):
            self.penalty = True
            node = self.system.AddNode(items.NodeGenericData(initialCoordinates=[0.0] * 4, numberOfDataCoordinates=4))
            common = {
                "markerNumbers": [self.marker(first.body, first.place), self.marker(second.body, second.place)],
                "nodeNumber": node,
                "dynamicFriction": STICKY if touch.mu == NO_SLIP else touch.mu,
                "frictionProportionalZone": SLIP_ZONE,
                "contactStiffness": STIFFNESS,
                "contactDamping": DAMPING,
            }
            if kinds[1] == "plane":
                corners = exudyn.Vector3DList([[-FAR, -FAR, 0.0], [FAR, -FAR, 0.0], [0.0, FAR, 0.0]])
                contact = items.ObjectContactSphereTriangle(
                    **common, sphereRadius=first.size[0], trianglePoints=corners, includeEdges=0
                )
            else:
                radii = [first.size[0], second.size[0]]
                contact = items.ObjectContactSphereSphere(
                    **common, spheresRadii=radii, isHollowSphere1=kinds[1] == "bowl"
                )
            self.system.AddObject(contact)
        else:
            raise Unsupported(f"no contact of a {kinds[0]} with a {kinds[1]}")


def _reference(problem: Problem) -> np.ndarray:
    """A configuration in which joint angles are zero, so that springs measure from there."""
    q = problem.q.copy()
    for body, (iq, _) in zip(problem.bodies, problem.slices().values()):
        if body.joint != "free":
            q[iq] = 0.0
    return q


def case(problem: Problem, label: str, solver: str, each: int) -> Case:
    import exudyn

    built = _Builder(problem)
    steps = each * problem.intervals
    settings = exudyn.SimulationSettings()
    time = settings.timeIntegration
    time.numberOfSteps, time.endTime = steps, problem.duration
    time.verboseMode = 0
    time.newton.useModifiedNewton = True
    time.newton.absoluteTolerance = 1e-10
    time.newton.relativeTolerance = 1e-10
    time.generalizedAlpha.spectralRadius = 0.95
    time.generalizedAlpha.useIndex2Constraints = solver == "TrapezoidalIndex2"
    time.generalizedAlpha.useNewmark = solver == "TrapezoidalIndex2"
    time.generalizedAlpha.computeInitialAccelerations = not built.penalty
    settings.linearSolverType = exudyn.LinearSolverType.EigenSparse
    output = settings.solutionSettings
    output.writeSolutionToFile = False
    output.solutionWritePeriod = problem.duration
    output.sensorsWritePeriod = problem.duration / problem.intervals
    output.solverInformationFileName = ""
    kind = getattr(exudyn.DynamicSolverType, solver)

    def run() -> bool:
        return bool(built.system.SolveDynamic(settings, solverType=kind, showHints=False))

    def positions(done: bool) -> np.ndarray:
        stored = [np.array(built.system.GetSensorStoredData(s)) for s in built.sensors]
        if not done or len(stored[0]) != problem.intervals + 1:
            return np.full((1, 1, 3), math.nan)
        return np.stack([rows[:, 1:4] for rows in stored], axis=1)

    def counts(done: bool) -> dict[str, int]:
        return {"steps": steps, "evaluations": int(built.system.sys["dynamicSolver"].it.newtonStepsCount)}

    return Case(label, f"step {problem.duration / steps:.3g} s", run, positions, counts)


def _cases(problem: Problem) -> Iterator[Case]:
    for label, solver in SOLVERS.items():
        for each in STEPS:
            yield case(problem, label, solver, each)


def _version() -> str:
    from importlib.metadata import version

    return version("exudyn")


_COMMON = (
    "ideal rolling discs and spherical joints; other contacts by penalty (1e6 N/m, 100 N s/m, friction "
    "regularised below 1e-4 m/s); modified Newton at 1e-10, sparse; evaluations are Newton iterations; "
)
ENGINE = Engine(
    "Exudyn",
    _version,
    _cases,
    {
        "trapezoidal": _COMMON + "index 2 trapezoidal rule",
        "generalized alpha": _COMMON + "spectral radius 0.95",
    },
)
