"""MuJoCo: soft contacts, made as hard as they go; its own `rollout`, which makes all steps in C."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from .measure import Case, Engine, Unsupported
from .problem import NO_SLIP, WORLD, Body, Problem, Shape, Touch, marked, matrix, quaternion

# points and rims get this much thickness in m, since contacts are between bodies with an inside
THICKNESS = 1e-5
# half the length in m of a box that stands for a plane
BOX = 10.0
# of friction where the scene has ideal rolling
STICKY = 10.0
# method -> integrator, and how hard contacts are: impedance, time constant (in steps, 2 is the least) and damping ratio
# of the restoring acceleration, and how much harder friction is than the normal
METHODS = {
    "RK4": ("RK4", {"impedance": 0.99, "impratio": 100.0, "tau": 2.0, "ratio": 1.0}),
    "RK4 soft": ("RK4", {"impedance": 0.9, "impratio": 1.0, "tau": 20.0, "ratio": 1.0}),
    "implicit": ("implicitfast", {"impedance": 0.99, "impratio": 100.0, "tau": 2.0, "ratio": 1.0}),
}
# in scenes of many events: what lands does not rebound, which it does with less damping
EVENT_METHODS = {
    "RK4": METHODS["RK4"],
    "implicit": METHODS["implicit"],
    "implicit plastic": ("implicitfast", {"impedance": 0.99, "impratio": 100.0, "tau": 2.0, "ratio": 5.0}),
    "implicit soft": ("implicitfast", {"impedance": 0.9, "impratio": 1.0, "tau": 2.0, "ratio": 2.0}),
}
STEPS = (1, 2, 3, 5, 10, 20, 50, 200, 500, 2000)


def _numbers(values: Any) -> str:
    return " ".join(repr(float(x)) for x in np.ravel(values))


def _scalar_last(turn: np.ndarray) -> str:
    x, y, z, w = quaternion(np.array(turn))
    return _numbers((w, x, y, z))


def _geom(shape: Shape, touch: Touch, group: int) -> str:
    place = np.array(shape.place)
    if shape.kind == "disk":
        kind, size = "cylinder", (shape.size[0], THICKNESS)
    elif shape.kind in ("sphere", "circle"):
        kind, size = "sphere", shape.size
    elif shape.kind == "ellipsoid":
        kind, size = "ellipsoid", shape.size
    elif shape.kind == "point":
        kind, size, place = "sphere", (THICKNESS,), np.add(place, (0.0, 0.0, THICKNESS))
    elif shape.kind == "plane" and shape.body == WORLD:
        kind, size = "plane", (0.0, 0.0, 1.0)
    elif shape.kind == "plane":
        # planes do not move: the top of a box does
        kind, size, place = "box", (BOX, BOX, 1.0), np.add(place, (0.0, 0.0, -1.0))
    elif shape.kind == "line":
        # a thick bar whose lower face holds the line
        kind, size, place = "box", (1.0, 0.1, 0.5), np.add(place, (0.0, 0.1, 0.0))
    else:
        raise Unsupported(f"no {shape.kind} among its contact shapes")
    dimension = 1 if touch.mu == 0.0 else 3
    friction = STICKY if touch.mu == NO_SLIP else max(touch.mu, 1e-5)
    return (
        f'<geom type="{kind}" size="{_numbers(size)}" pos="{_numbers(place)}" condim="{dimension}" mass="0" '
        f'friction="{friction} 0 0" contype="{group}" conaffinity="{group}"/>'
    )


def _joint(body: Body) -> str:
    if body.joint == "free":
        return "<freejoint/>"
    if body.joint == "translation":
        raise Unsupported("not set up for point masses")
    kind = {"revolute": "hinge", "prismatic": "slide"}[body.joint]
    return (
        f'<joint type="{kind}" axis="{_numbers(body.axis)}" damping="{body.damping}" stiffness="{body.stiffness}" '
        f'springref="{body.rest}" limited="false"/>'
    )


def model_text(problem: Problem, step: float, integrator: str, options: dict[str, Any]) -> str:
    """MJCF of a scene."""
    geoms: dict[str, list[str]] = {}
    for i, touch in enumerate(problem.touches):
        # the floor of several feet appears once for each, in a group of its own: no other pairs are looked at
        for shape in (touch.first, touch.second):
            geoms.setdefault(shape.body, []).append(_geom(shape, touch, 1 << i))

    def element(body: Body) -> str:
        tensor = np.array(body.inertia)
        six = (tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2])
        children = "".join(element(b) for b in problem.bodies if b.parent == body.name)
        return (
            f'<body name={quoteattr(body.name)} pos="{_numbers(body.place)}" quat="{_scalar_last(body.turn)}">'
            f'<inertial pos="{_numbers(body.com)}" mass="{body.mass}" fullinertia="{_numbers(six)}"/>'
            f"{_joint(body)}{''.join(geoms.get(body.name, []))}{children}</body>"
        )

    roots = "".join(element(body) for body in problem.bodies if body.parent == WORLD)
    hard = options["impedance"]
    return f"""<mujoco><compiler angle="radian" autolimits="false"/>
<option timestep="{step!r}" gravity="{_numbers(problem.gravity)}" integrator="{integrator}" cone="elliptic"
 impratio="{options["impratio"]}" solver="Newton" iterations="100" tolerance="1e-12" ls_tolerance="1e-6"/>
<default><geom solref="{options["tau"] * step!r} {options["ratio"]}" solimp="{hard} {hard} 0.001"/></default>
<worldbody>{"".join(geoms.get(WORLD, []))}{roots}</worldbody></mujoco>"""


def build(problem: Problem, step: float, integrator: str, options: dict[str, Any]):
    """A model and its data at the start."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(model_text(problem, step, integrator, options))
    data = mujoco.MjData(model)
    for body, (iq, iv) in zip(problem.bodies, problem.slices().values()):
        joint = model.body(body.name).jntadr[0]
        q_at, v_at = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
        q, v = problem.q[iq], problem.v[iv]
        if body.joint == "free":
            data.qpos[q_at : q_at + 7] = [*q[:3], q[6], q[3], q[4], q[5]]
            data.qvel[v_at : v_at + 6] = [*(matrix(q[3:]) @ v[:3]), *v[3:]]
        else:
            data.qpos[q_at], data.qvel[v_at] = q[0], v[0]
    return model, data


def _coordinates(problem: Problem, model, rows: np.ndarray) -> np.ndarray:
    """MuJoCo's configurations as the problem's."""
    out = np.empty((len(rows), problem.q.size))
    for body, (iq, _) in zip(problem.bodies, problem.slices().values()):
        at = model.jnt_qposadr[model.body(body.name).jntadr[0]]
        if body.joint == "free":
            out[:, iq] = rows[:, [at, at + 1, at + 2, at + 4, at + 5, at + 6, at + 3]]
        else:
            out[:, iq] = rows[:, at : at + 1]
    return out


def case(problem: Problem, label: str, integrator: str, each: int, options: dict[str, Any]) -> Case:
    import mujoco
    from mujoco.rollout import Rollout

    steps = each * problem.intervals
    model, start = build(problem, problem.duration / steps, integrator, options)
    data, whole = mujoco.MjData(model), mujoco.mjtState.mjSTATE_FULLPHYSICS
    first = np.empty((1, mujoco.mj_stateSize(model, whole)))
    mujoco.mj_getState(model, start, first[0], whole)
    # in this thread
    rollout, nq = Rollout(nthread=0), model.nq
    forces: dict[str, Any] = {}
    if problem.drive is not None:
        # constant in a step, with the value of its middle
        rows = problem.drive(problem.duration / steps * (np.arange(steps) + 0.5))
        control = np.zeros((1, steps, model.nv))
        for body, (_, iv) in zip(problem.bodies, problem.slices().values()):
            at = model.jnt_dofadr[model.body(body.name).jntadr[0]]
            control[0, :, at : at + body.sizes[1]] = rows[:, iv]
        forces = {"control": control, "control_spec": mujoco.mjtState.mjSTATE_QFRC_APPLIED.value}

    def run() -> np.ndarray:
        states, _ = rollout.rollout([model], [data], first, nstep=steps, **forces)
        rows = np.empty((problem.intervals + 1, nq))
        # a state is the time, q and v
        rows[0], rows[1:] = start.qpos, states[0, each - 1 :: each, 1 : 1 + nq]
        return rows

    stages = 4 if integrator == "RK4" else 1
    return Case(
        label,
        f"step {problem.duration / steps:.3g} s",
        run,
        lambda rows: marked(problem, _coordinates(problem, model, rows)),
        lambda rows: {"steps": steps, "evaluations": stages * steps},
    )


def _cases(problem: Problem) -> Iterator[Case]:
    for label, (integrator, options) in (EVENT_METHODS if problem.events else METHODS).items():
        for each in STEPS:
            yield case(problem, label, integrator, each, options)


def _version() -> str:
    import mujoco

    return mujoco.__version__


_COMMON = (
    "rollout in one thread, elliptic cones, Newton solver at tolerance 1e-12; rims and points 1e-5 m thick, "
    "ideal rolling as mu = 10; "
)
ENGINE = Engine(
    "MuJoCo",
    _version,
    _cases,
    {
        "RK4": _COMMON + "solref 2 steps, solimp 0.99, impratio 100",
        "RK4 soft": _COMMON + "solref 20 steps, solimp 0.9, impratio 1",
        "implicit": _COMMON + "implicitfast, solref 2 steps, solimp 0.99, impratio 100",
        "implicit plastic": _COMMON + "in scenes of many events: the same with damping ratio 5",
        "implicit soft": _COMMON + "in scenes of many events: damping ratio 2, solimp 0.9, impratio 1",
    },
)
