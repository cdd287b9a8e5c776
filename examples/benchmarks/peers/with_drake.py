"""Drake: discrete plants in steps, and its error-controlled convex integrator; contacts as stiff as they go."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from .measure import Case, Engine, Unsupported
from .problem import NO_SLIP, WORLD, Body, Problem, Shape, Touch, matrix, skew

# points and rims get this much thickness in m, since contacts are between bodies with an inside
THICKNESS = 1e-5
STICKY = 10.0
STEPS = (1, 2, 3, 5, 10, 20, 50, 200, 500)
ACCURACIES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)


def _shape(shape: Shape) -> tuple[Any, np.ndarray]:
    """Drake's shape and its place on the body."""
    import pydrake.all as drake

    place = np.array(shape.place)
    if shape.kind == "disk":
        return drake.Cylinder(shape.size[0], 2.0 * THICKNESS), place
    if shape.kind in ("sphere", "circle"):
        return drake.Sphere(shape.size[0]), place
    if shape.kind == "ellipsoid":
        return drake.Ellipsoid(*shape.size), place
    if shape.kind == "point":
        return drake.Sphere(THICKNESS), np.add(place, (0.0, 0.0, THICKNESS))
    if shape.kind == "plane":
        return drake.HalfSpace(), place
    if shape.kind == "line":
        return drake.Box(2.0, 0.2, 1.0), np.add(place, (0.0, 0.1, 0.0))
    raise Unsupported(f"no {shape.kind} among its contact shapes")


def _inertia(body: Body):
    import pydrake.all as drake

    com = np.array(body.com)
    about_origin = np.array(body.inertia) - body.mass * skew(com) @ skew(com)
    unit = about_origin / body.mass
    return drake.SpatialInertia(
        mass=body.mass,
        p_PScm_E=com,
        G_SP_E=drake.UnitInertia(unit[0, 0], unit[1, 1], unit[2, 2], unit[0, 1], unit[0, 2], unit[1, 2]),
    )


def _add_joint(plant, body: Body, parent, child) -> None:
    import pydrake.all as drake

    if body.joint == "free":
        return
    if body.joint == "translation":
        raise Unsupported("not set up for point masses")
    frame = plant.AddFrame(
        drake.FixedOffsetFrame(
            f"{body.name} base", parent, drake.RigidTransform(drake.RotationMatrix(body.turn), body.place)
        )
    )
    kinds = {"revolute": drake.RevoluteJoint, "prismatic": drake.PrismaticJoint}
    joint = plant.AddJoint(
        kinds[body.joint](body.name, frame, child.body_frame(), np.array(body.axis), damping=body.damping)
    )
    if body.stiffness:
        spring = drake.RevoluteSpring if body.joint == "revolute" else drake.PrismaticSpring
        plant.AddForceElement(spring(joint, body.rest, body.stiffness))


def build(problem: Problem, step: float, options: dict[str, Any]):
    """A diagram with the scene in it, its plant and a context at the start; step 0 for a continuous plant."""
    import pydrake.all as drake

    builder = drake.DiagramBuilder()
    plant, graph = drake.AddMultibodyPlantSceneGraph(builder, step)
    plant.mutable_gravity_field().set_gravity_vector(np.array(problem.gravity))
    if step:
        kinds = drake.DiscreteContactApproximation
        plant.set_discrete_contact_approximation(getattr(kinds, options["approximation"]))
    bodies = {WORLD: plant.world_body()}
    for body in problem.bodies:
        bodies[body.name] = plant.AddRigidBody(body.name, _inertia(body))
        _add_joint(plant, body, bodies[body.parent].body_frame(), bodies[body.name])
    ids = []
    for i, touch in enumerate(problem.touches):
        pair = []
        for end, shape in (("a", touch.first), ("b", touch.second)):
            kind, place = _shape(shape)
            pair.append(
                plant.RegisterCollisionGeometry(
                    bodies[shape.body],
                    drake.RigidTransform(place),
                    kind,
                    f"{i}{end}",
                    _properties(touch, step, options),
                )
            )
        ids.append(pair)
    # only the pairs that are in contact are looked at
    manager = graph.collision_filter_manager()
    everything = [g for pair in ids for g in pair]
    for i, a in enumerate(everything):
        for j in range(i + 1, len(everything)):
            if not (j == i + 1 and i % 2 == 0):
                manager.Apply(
                    drake.CollisionFilterDeclaration().ExcludeBetween(
                        drake.GeometrySet(a), drake.GeometrySet(everything[j])
                    )
                )
    plant.Finalize()
    if not step:
        plant.set_stiction_tolerance(options["stiction"])
    if problem.drive is not None:
        _add_drive(problem, builder, plant, step)
    diagram = builder.Build()
    return diagram, plant


def _add_drive(problem: Problem, builder, plant, step: float) -> None:
    """Sines of time as generalised forces; a discrete plant takes those of its steps' middles."""
    import pydrake.all as drake

    given = problem.drive
    assert given is not None
    amplitude, phase = np.zeros(plant.num_velocities()), np.zeros(plant.num_velocities())
    rate = np.full(plant.num_velocities(), given.rate)
    for body, (_, iv) in zip(problem.bodies, problem.slices().values()):
        if body.joint == "free":
            # angular before linear
            at = plant.GetBodyByName(body.name).floating_velocities_start_in_v()
            where = [*range(at + 3, at + 6), *range(at, at + 3)]
        else:
            where = [plant.GetJointByName(body.name).velocity_start()]
        amplitude[where], phase[where] = given.amplitude[iv], given.phase[iv] + 0.5 * given.rate * step
    source = builder.AddSystem(drake.Sine(amplitude, rate, phase, True))
    builder.Connect(source.get_output_port(0), plant.get_applied_generalized_force_input_port())


def _properties(touch: Touch, step: float, options: dict[str, Any]):
    import pydrake.all as drake

    properties = drake.ProximityProperties()
    mu = STICKY if touch.mu == NO_SLIP else touch.mu
    drake.AddContactMaterial(
        dissipation=options["dissipation"],
        point_stiffness=options["stiffness"],
        friction=drake.CoulombFriction(mu, mu),
        properties=properties,
    )
    if step:
        properties.AddProperty("material", "relaxation_time", options["relaxation"] * step)
    return properties


def _set_start(problem: Problem, plant, context) -> None:
    import pydrake.all as drake

    for body, (iq, iv) in zip(problem.bodies, problem.slices().values()):
        q, v = problem.q[iq], problem.v[iv]
        if body.joint == "free":
            turn = matrix(q[3:])
            link = plant.GetBodyByName(body.name)
            plant.SetFreeBodyPose(context, link, drake.RigidTransform(drake.RotationMatrix(turn), q[:3]))
            plant.SetFreeBodySpatialVelocity(context, link, drake.SpatialVelocity(w=turn @ v[3:], v=turn @ v[:3]))
        else:
            joint = plant.GetJointByName(body.name)
            set_q = joint.set_angle if body.joint == "revolute" else joint.set_translation
            set_v = joint.set_angular_rate if body.joint == "revolute" else joint.set_translation_rate
            set_q(context, q[0])
            set_v(context, v[0])


def _runs(problem: Problem, diagram, plant, prepare) -> tuple[Any, Any]:
    """run() and positions(rows) of a simulator made by `prepare`."""
    import pydrake.all as drake

    simulator = drake.Simulator(diagram)
    prepare(simulator)
    context = simulator.get_mutable_context()
    inside = plant.GetMyMutableContextFromRoot(context)
    _set_start(problem, plant, inside)
    q0, v0 = plant.GetPositions(inside).copy(), plant.GetVelocities(inside).copy()
    times = problem.times

    def run() -> np.ndarray:
        context.SetTime(0.0)
        plant.SetPositions(inside, q0)
        plant.SetVelocities(inside, v0)
        simulator.ResetStatistics()
        simulator.Initialize()
        rows = np.empty((len(times), q0.size))
        rows[0] = q0
        for i, t in enumerate(times[1:], 1):
            simulator.AdvanceTo(t)
            rows[i] = plant.GetPositions(inside)
        return rows

    def positions(rows: np.ndarray) -> np.ndarray:
        out = np.empty((len(rows), len(problem.markers), 3))
        for i, q in enumerate(rows):
            plant.SetPositions(inside, q)
            for k, (name, point) in enumerate(problem.markers):
                out[i, k] = plant.EvalBodyPoseInWorld(inside, plant.GetBodyByName(name)).multiply(np.array(point))
        return out

    return run, positions, simulator


def discrete(problem: Problem, label: str, each: int, options: dict[str, Any]) -> Case:
    step = problem.duration / (problem.intervals * each)
    diagram, plant = build(problem, step, options)
    run, positions, _ = _runs(problem, diagram, plant, lambda simulator: None)
    steps = each * problem.intervals
    return Case(label, f"step {step:.3g} s", run, positions, lambda rows: {"steps": steps, "evaluations": steps})


def continuous(problem: Problem, label: str, accuracy: float, options: dict[str, Any]) -> Case:
    import pydrake.all as drake

    diagram, plant = build(problem, 0.0, options)

    def prepare(simulator) -> None:
        drake.ResetIntegratorFromFlags(simulator, options["integrator"], 0.1)
        simulator.get_mutable_integrator().set_target_accuracy(accuracy)

    run, positions, simulator = _runs(problem, diagram, plant, prepare)

    def counts(rows: np.ndarray) -> dict[str, int]:
        integrator = simulator.get_integrator()
        return {
            "steps": int(integrator.get_num_steps_taken()),
            "evaluations": int(integrator.get_num_derivative_evaluations()),
        }

    return Case(label, f"accuracy {accuracy:.0e}", run, positions, counts)


# method -> contact material; relaxation in steps, of the solvers that know it
DISCRETE = {
    "TAMSI": {"approximation": "kTamsi", "stiffness": 1e6, "dissipation": 0.0, "relaxation": 1.0},
    "SAP": {"approximation": "kSap", "stiffness": 1e6, "dissipation": 0.0, "relaxation": 1.0},
}
CONTINUOUS = {
    "CENIC": {"integrator": "cenic", "stiffness": 1e5, "dissipation": 10.0, "stiction": 1e-4},
    "CENIC stiff": {"integrator": "cenic", "stiffness": 1e6, "dissipation": 100.0, "stiction": 1e-4},
}


def _cases(problem: Problem) -> Iterator[Case]:
    for label, options in DISCRETE.items():
        for each in STEPS:
            yield discrete(problem, label, each, options)
    for label, options in CONTINUOUS.items():
        for accuracy in ACCURACIES:
            yield continuous(problem, label, accuracy, options)


def _version() -> str:
    from importlib.metadata import version

    return version("drake")


_COMMON = "point contact, rims and points 1e-5 m thick, ideal rolling as mu = 10; "
ENGINE = Engine(
    "Drake",
    _version,
    _cases,
    {
        "TAMSI": _COMMON + "discrete, stiffness 1e6 N/m, no dissipation",
        "SAP": _COMMON + "discrete, stiffness 1e6 N/m, relaxation in one step",
        "CENIC": _COMMON + "error-controlled, stiffness 1e5 N/m, dissipation 10 s/m",
        "CENIC stiff": _COMMON + "error-controlled, stiffness 1e6 N/m, dissipation 100 s/m",
    },
)
