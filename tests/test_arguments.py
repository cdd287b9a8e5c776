"""Every public constructor and call, every numeric argument: what is no number of its kind is refused by name."""

import inspect
import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

# Whatever a number is expected for. None is left out where it means "not given".
NO_NUMBERS = [
    "0.3",
    b"0.3",
    True,
    np.True_,
    1j,
    np.complex128(0.3),
    [0.3],
    np.array([0.3]),
    {},
    np.str_("0.3"),
    math.nan,
]
INFINITE = [math.inf, -math.inf]
NEGATIVE = [-0.3, -1]
NUMBER = [*NO_NUMBERS, *INFINITE]
NOT_NEGATIVE = [*NUMBER, *NEGATIVE]
POSITIVE = [*NOT_NEGATIVE, 0.0]
COUNT = [*POSITIVE, 2.5]
# Intervals: of ends that are no numbers, too few or too many, and empty ones.
INTERVAL = ["01", 0.3, True, (0.0,), (0.0, 0.5, 1.0), ("0", "1"), (0.0, math.nan), (0.5, 0.5), (0.0, 1j), (False, True)]
PATCH = [*INTERVAL, ((0.0, 0.5), ("0", "1")), ((0.0, 0.5), (0.5, 0.0)), ((0.0, 0.5), 3)]


def vectors(count, *others):
    """What is no array of finite numbers of this length."""
    good = [0.3] * count
    entries = ["0.3", None, 1j, math.nan, math.inf]
    return [0.3, "0.3", True, good[1:], [*good, 0.3], [True] * count, [str(x) for x in good], *others] + [
        [*good[1:], entry] for entry in entries
    ]


def table(count):
    """What is no array (n, count) of finite numbers."""
    return [0.3, "points", True, [[0.3] * (count + 2)] * 8, *([[0.3] * (count - 1) + [bad]] * 8 for bad in (1j, "0.3"))]


FLAG = ["yes", None, 0.5, 2, []]
CONTACT_SOLVER = ["qp", "ProxQP", "", None, 3, True, [], ["auto"], np.array(["auto", "auto"])]
WAVE = [[math.cos(u), math.sin(u), 0.1 * math.sin(2 * u)] for u in np.linspace(0.0, 6.0, 12)]
BUMPS = np.array([[[x, y, 0.1 * x * y] for y in range(7)] for x in range(7)], dtype=float)
POSES = [pin.SE3(np.eye(3), np.array([0.1 * i, 0.0, 0.0])) for i in range(8)]


def ball_scene():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    scene = pc.Scene(model)
    scene.add_contour("ball", pc.Sphere(0.1), "root")
    scene.add_contour("floor", pc.Plane())
    return scene


def touching(friction=None):
    scene = ball_scene()
    scene.add_contact("c", "ball", "floor", friction)
    return scene, scene.initial_state([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0])


def call_of(function):
    def call(**options):
        scene, state = touching(pc.Coulomb(0.3))
        return function(scene, state, **options)

    return call


# (what is called, arguments that are right, argument -> what it must refuse, arguments that are no numbers)
CASES = {
    "Point": (pc.Point, {}, {}, ()),
    "Line": (pc.Line, {}, {"domain": INTERVAL}, ()),
    "Circle": (pc.Circle, {"radius": 0.3}, {"radius": [*POSITIVE, None], "domain": INTERVAL}, ()),
    "Ellipse": (
        pc.Ellipse,
        {"a": 0.3, "b": 0.2},
        {"a": [*POSITIVE, None], "b": [*POSITIVE, None], "domain": INTERVAL},
        (),
    ),
    "Helix": (
        pc.Helix,
        {"radius": 0.3, "pitch": -0.2},
        {"radius": [*POSITIVE, None], "pitch": [*NUMBER, None], "domain": INTERVAL},
        (),
    ),
    "Cycloid": (pc.Cycloid, {"radius": 0.3}, {"radius": [*POSITIVE, None], "domain": [*INTERVAL, None]}, ()),
    "FourierCurve": (
        pc.FourierCurve,
        {"cosine": [[0, 0], [1, 0]], "sine": [[0, 0], [0, 1]]},
        {"cosine": [*table(3), None], "sine": [*table(3), None]},
        (),
    ),
    "SplineCurve": (
        pc.SplineCurve,
        {"points": WAVE},
        {"points": [*table(3), None], "periodic": FLAG, "degree": [*COUNT, None, 3], "parameters": vectors(12)},
        (),
    ),
    "ParametricCurve": (
        pc.ParametricCurve,
        {"f": lambda u: (u, u * u, 0.0), "domain": (0.0, 1.0)},
        {"domain": [*INTERVAL, None], "periodic": FLAG, "time_domain": INTERVAL},
        ("f", "derivatives"),
    ),
    "Plane": (pc.Plane, {}, {"domain": PATCH}, ()),
    "Sphere": (pc.Sphere, {"radius": 0.3}, {"radius": [*POSITIVE, None]}, ()),
    "Ellipsoid": (
        pc.Ellipsoid,
        {"a": 0.3, "b": 0.2, "c": 0.1},
        {name: [*POSITIVE, None] for name in "abc"},
        (),
    ),
    "Cylinder": (pc.Cylinder, {"radius": 0.3}, {"radius": [*POSITIVE, None], "domain": PATCH}, ()),
    "Cone": (pc.Cone, {"half_angle": 0.3}, {"half_angle": [*POSITIVE, None, 1.6], "domain": PATCH}, ()),
    "Torus": (
        pc.Torus,
        {"major": 0.3, "minor": 0.1},
        {"major": [*POSITIVE, None], "minor": [*POSITIVE, None]},
        (),
    ),
    "SurfaceOfRevolution": (
        pc.SurfaceOfRevolution,
        {"profile": lambda s: (1.0 + 0.1 * s, s), "domain": (0.0, 1.0)},
        {"domain": [*INTERVAL, None, (0.0, math.inf)], "periodic": FLAG},
        ("profile",),
    ),
    "HeightField": (
        pc.HeightField,
        {"f": np.arange(7.0), "y": np.arange(7.0), "z": BUMPS[..., 2]},
        {
            "f": [*vectors(7), None],
            "y": [*vectors(7), None],
            "z": [*table(7), None],
            "degree": [*COUNT, None, 3],
            "domain": PATCH,
            "time_domain": INTERVAL,
        },
        ("derivatives",),
    ),
    "SplineSurface": (
        pc.SplineSurface,
        {"points": BUMPS},
        {"points": [*table(3), None], "periodic": [*FLAG, (0.5, True)], "degree": [*COUNT, None, 3]},
        ("parameters",),
    ),
    "ParametricSurface": (
        pc.ParametricSurface,
        {"f": lambda u, v: (u, v, u * v), "domain": ((0.0, 1.0), (0.0, 1.0))},
        {"domain": [*PATCH, None], "periodic": [*FLAG, (0.5, True)], "time_domain": INTERVAL},
        ("f", "derivatives"),
    ),
    "ConstantTwist": (
        pc.ConstantTwist,
        {},
        {name: [*vectors(3), None] for name in ("angular", "linear", "center")},
        (),
    ),
    "HarmonicMotion": (
        pc.HarmonicMotion,
        {},
        {
            **{name: [*vectors(3), None] for name in ("amplitude", "center")},
            "axis": [*vectors(3), [0.0, 0.0, 0.0]],
            **{name: [*NUMBER, None] for name in ("frequency", "phase", "angle", "turn_phase")},
            "turn_frequency": NUMBER,
        },
        (),
    ),
    "SplineMotion": (
        pc.SplineMotion,
        {"times": np.arange(8.0), "poses": POSES},
        {"times": [*vectors(8), None], "periodic": FLAG},
        ("poses",),
    ),
    "CallableMotion": (
        pc.CallableMotion,
        {"f": lambda t: pin.SE3.Identity(), "time_domain": (0.0, 1.0)},
        {"time_domain": [*INTERVAL, (0.0, math.inf)]},
        ("f",),
    ),
    "Coulomb": (
        pc.Coulomb,
        {"mu": 0.3},
        {
            "mu": [*NOT_NEGATIVE, None, ("0.3", 0.3), (0.3, True), (0.3, 0.3, 0.3)],
            "mu_static": [*NOT_NEGATIVE, 0.2],
            **{name: [*NOT_NEGATIVE, None] for name in ("viscous", "spinning", "rolling")},
        },
        ("along",),
    ),
    "Stribeck": (
        pc.Stribeck,
        {"mu": 0.3, "mu_static": 0.4, "speed": 0.1},
        {
            "mu": [*NOT_NEGATIVE, None],
            "mu_static": [*NOT_NEGATIVE, None, 0.2],
            "speed": [*POSITIVE, None],
            "exponent": [*POSITIVE, None, 0.5, 51],
            **{name: [*NOT_NEGATIVE, None] for name in ("viscous", "spinning", "rolling")},
        },
        ("along",),
    ),
    "NoSlip": (pc.NoSlip, {}, {name: [*NOT_NEGATIVE, None] for name in ("spinning", "rolling")}, ()),
    "add_contact": (
        lambda **options: ball_scene().add_contact(**options),
        {"name": "c", "first": "ball", "second": "floor"},
        {
            "restitution": [*NOT_NEGATIVE, None, 1.1],
            "side": [*NUMBER, 0, 0.5, 2],
            "bilateral": FLAG,
            "location": [0.3, "ab", True, (0.3,), *(((0.1, 0.2), bad) for bad in vectors(2))],
            "friction": [0.3, "0.3", True],
            "name": [3, None],
            "first": [3, None, "roof"],
            "second": [3, None, "roof"],
            "pattern": [3, "S"],
        },
        (),
    ),
    "add_contacts": (
        lambda **options: ball_scene().add_contacts(**options),
        {"firsts": "ball", "seconds": "floor"},
        {
            "firsts": [3, None, True, "roof", ["roof"], [3], [None]],
            "seconds": [3, None, True, "roof", ["roof"], [3], [None]],
            "friction": [0.3, "0.3", True],
            "bilateral": FLAG,
            "side": [*NUMBER, 0, 0.5, 2],
            "restitution": [*NOT_NEGATIVE, None, 1.1],
        },
        (),
    ),
    "propose_contacts": (
        lambda **options: ball_scene().propose_contacts(**options),
        {"distance": 0.1},
        {"distance": [*POSITIVE, None], "q": vectors(7, [0.3] * 7), "within": FLAG},
        (),
    ),
    "add_contour": (
        lambda **options: ball_scene().add_contour(**options),
        {"name": "new", "contour": pc.Plane()},
        {
            "name": [3, None],
            "contour": [0.3, None, "Plane"],
            "frame": [0, None],
            "placement": [0.3, "here", np.eye(4), pin.SE3(np.eye(3), np.array([0.0, 0.0, math.nan]))],
            "motion": [0.3, "still"],
        },
        (),
    ),
    "add_contours_from_collision": (
        lambda **options: ball_scene().add_contours_from_collision(**options),
        {"geometry": pin.GeometryModel()},
        {"links": [3, [3]], "kinds": [3, [3], None, "vertices"], "geometry": [3, "shapes"]},
        (),
    ),
    "initial_state": (
        lambda **options: touching()[0].initial_state(**options),
        {"q": [0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0]},
        {
            "q": [*vectors(7, [0.3] * 7), None],
            "v": vectors(6),
            "t": [*NUMBER, None],
            "max_gap": [*NO_NUMBERS, *NEGATIVE],
            "free": [3, [3], None],
        },
        (),
    ),
    "simulate": (
        call_of(pc.simulate),
        {"duration": 0.01},
        {
            "duration": [*NOT_NEGATIVE, None],
            "rtol": [*NOT_NEGATIVE, None],
            "atol": [*POSITIVE, None],
            "max_step": [*NO_NUMBERS, *NEGATIVE, 0.0, None],
            "first_step": [*NO_NUMBERS, *NEGATIVE, 0.0],
            "fixed_step": [*NO_NUMBERS, *NEGATIVE, 0.0],
            "dt": POSITIVE,
            "step": POSITIVE,
            "max_steps": [*COUNT, None],
            "breakpoints": ["now", True, [True], ["0.0"], [1j], [math.nan], [None], [math.inf]],
            "fallback": [3, "Euler", True],
            "contact_solver": CONTACT_SOLVER,
            "t_eval": ["now", True, [True], ["0.0"], [1j], [math.nan], [None], [0.005, math.inf], [0.005, 0.0]],
            "method": [3, None, "Euler"],
            "control": [3, "pd"],
            "events": [3, [None]],
            "energies": FLAG,
            "progress": FLAG,
            "dense_output": FLAG,
        },
        (),
    ),
    "Stepper": (
        call_of(pc.Stepper),
        {},
        {"dt": POSITIVE, "step": POSITIVE, "contact_solver": CONTACT_SOLVER},
        (),
    ),
    "Stepper.step": (
        call_of(lambda scene, state, **options: pc.Stepper(scene, state).step(**options)),
        {"tau": np.zeros(6)},
        {"tau": [*vectors(6), None], "count": [*COUNT, None]},
        (),
    ),
    "Stepper.rollout": (
        call_of(lambda scene, state, **options: pc.Stepper(scene, state).rollout(**options)),
        {"torques": np.zeros((2, 6))},
        {"torques": [*vectors(6), None, np.zeros((2, 5)), np.full((2, 6), True)], "count": [*COUNT, None]},
        (),
    ),
    "Stepper.pd": (
        call_of(lambda scene, state, **options: pc.Stepper(scene, state).pd(**options)),
        {"kp": 0.0, "kd": 0.3, "target": np.ones(7)},
        {"kp": [*NOT_NEGATIVE, None], "kd": [*NOT_NEGATIVE, None], "target": [*vectors(7), None]},
        (),
    ),
    "rollout": (
        call_of(pc.rollout),
        {"torques": np.zeros((2, 3, 6))},
        {
            "torques": [*vectors(6), None, np.zeros((2, 5)), np.full((2, 6), True), [["0.3"] * 6], [[math.nan] * 6]],
            "dt": POSITIVE,
            "step": POSITIVE,
            "substeps": [*COUNT, None],
            "threads": COUNT,
            "contact_solver": CONTACT_SOLVER,
            "pd": [3, "pd", (1.0, 2.0), [1.0, 2.0, 3.0]],
        },
        # as the state of all others: test_rollouts
        ("states",),
    ),
    "Scene": (
        pc.Scene,
        {"model": pin.Model()},
        {"model": [3, None, "robot.urdf"], "visual_model": [3], "collision_model": ["shapes"]},
        (),
    ),
    "solve_contacts": (
        pc.solve_contacts,
        {"delassus": np.eye(3), "b": [0.0, 0.0, -1.0], "mu": 0.3},
        {
            "delassus": [0.3, "1", True, np.eye(2), np.eye(3) * 1j, np.eye(3) == 1.0, np.full((3, 3), math.nan), None],
            "b": [*vectors(3), None],
            "mu": ["0.3", True, 1j, [True], ["0.3"], math.nan, -0.3, [0.3, 0.3], None],
            "tolerance": [*NO_NUMBERS, *NEGATIVE, 0.0, None],
            "quick": FLAG,
            "contact_solver": CONTACT_SOLVER,
        },
        ("warm",),
    ),
    "linearize": (
        call_of(pc.linearize),
        {},
        {"tolerance": [*NO_NUMBERS, *NEGATIVE, 0.0, None], "tau": vectors(6)},
        ("coordinates",),
    ),
    "Contour.evaluate": (
        pc.Sphere(0.3).evaluate,
        {"u": [0.1, 0.2]},
        {"u": vectors(2)[:-2], "t": NO_NUMBERS[:-1], "chart": [*NUMBER, 2, 0.5, None]},
        (),
    ),
}
# Public names that are not walked: the first are made by the package, the second check no numbers of their own.
RESULTS = {
    *("AttachedContour", "Contact", "State", "LoadedScene", "Trajectory", "ContactTrack", "Event", "SweepTable"),
    *("ContactKinematics", "Linearization", "SteadyMotion", "InverseDynamics", "FarkasCertificate", "ContactSolution"),
}
OTHERS = {
    **dict.fromkeys(("Contour", "Motion", "FrictionLaw"), "base classes: what derives from them checks"),
    **dict.fromkeys(("load_scene", "sweep"), "read files and grids, whose tests are test_scene_file and test_sweep"),
    **dict.fromkeys(("analyze", "external_forces", "inverse_dynamics"), "take states; arrays: test_hostile"),
    **dict.fromkeys(("find_equilibrium", "find_steady_motion"), "take what initial_state takes"),
    **dict.fromkeys(("replay", "export_html"), "take runs; numbers of pictures: test_hostile"),
    "export_rerun": "takes runs: test_rerun",
    "centred_forces": "takes what solve_contacts has made",
}
# Arguments whose check names something else than the argument.
NAMED = {
    ("initial_state", "max_gap"): "max_gap|gap",
    ("add_contact", "first"): "contour",
    ("add_contact", "second"): "contour",
    ("add_contacts", "firsts"): "firsts|contour",
    ("add_contacts", "seconds"): "seconds|contour",
    ("add_contour", "contour"): "expected a contour",
    ("SplineCurve", "parameters"): "parameters",
    ("Contour.evaluate", "chart"): "chart",
    ("Scene", "model"): "Model",
    ("HeightField", "f"): "x|z",
    ("HeightField", "y"): "y|z",
    ("solve_contacts", "delassus"): "Delassus",
    ("Contour.evaluate", "u"): "parameters|u and t",
}


def test_the_cases_are_complete():
    """Every public name is walked or said not to be; every argument is."""
    errors = {name for name in pc.__all__ if isinstance(getattr(pc, name), type) and "Error" in name}
    public = set(pc.__all__) - errors - RESULTS - set(OTHERS)
    assert public <= set(CASES), f"CASES lacks {public - set(CASES)}"
    for name in public:
        _, right, refused, others = CASES[name]
        parameters = set(inspect.signature(getattr(pc, name)).parameters) - {"scene", "state"}
        assert parameters == set(right) & parameters | set(refused) | set(others), name
    methods = ("add_contact", "add_contacts", "propose_contacts", "add_contour", "add_contours_from_collision")
    for name in (*methods, "initial_state"):
        parameters = set(inspect.signature(getattr(pc.Scene, name)).parameters) - {"self"}
        assert parameters == set(CASES[name][2]), name


@pytest.mark.parametrize("name", CASES)
def test_what_is_no_number_is_refused_by_name(name):
    call, right, refused, _ = CASES[name]
    if name != "add_contours_from_collision":
        call(**right)
    for argument, values in refused.items():
        for value in values:
            with pytest.raises(pc.ContactError) as caught:
                call(**{**right, argument: value})
                pytest.fail(f"{name}: {argument} = {value!r} passes")
            expected = NAMED.get((name, argument), argument).split("|")
            assert any(part in str(caught.value) for part in expected), (argument, value, str(caught.value))


def environment_class():
    pytest.importorskip("gymnasium", reason="needs gymnasium: pip install pincontact[gym]")
    from pincontact.gym import ContactEnv

    return ContactEnv


def by_environment(scene, state, torques, **options):
    environment = environment_class()(scene, state, ["root"], lambda stepper, tau: 0.0, 1.0, substeps=1, **options)
    environment.reset(seed=0)
    return [environment.step(row)[0] for row in torques][-1]


def by_simulate(run):
    return np.concatenate([run.q[-1], run.v[-1]])


def by_stepper(scene, state, torques, **options):
    stepper = pc.Stepper(scene, state, **options)
    return np.concatenate([rows[-1] for rows in stepper.rollout(torques)])


# Every public call that takes a step of time, with what it makes of three steps.
STEPPED = {
    "simulate": lambda scene, state, torques, **options: by_simulate(
        pc.simulate(scene, state, 0.006, method="Moreau", control=lambda t, q, v: torques[0], **options)
    ),
    "LoadedScene.simulate": lambda scene, state, torques, **options: by_simulate(
        pc.LoadedScene(Path("none"), scene, state, {"duration": 0.006, "method": "Moreau", "dt": 1e-4}).simulate(
            control=lambda t, q, v: torques[0], **options
        )
    ),
    "Stepper": by_stepper,
    "rollout": lambda *given, **options: np.concatenate([x[0, -1] for x in pc.rollout(*given, **options)[:2]]),
    "ContactEnv": by_environment,
}
# What a step of time could be called otherwise; the steps without error control of event-driven methods are no `dt`.
STEP_NAMES = {"dt", "step", "h", "time_step", "timestep", "delta_t", "stepsize", "step_size", "period"}


def test_a_step_of_time_has_one_name_and_one_alias():
    """Of all public functions, constructors and methods: those in the table and no other, each with both names."""
    public = {name: getattr(pc, name) for name in pc.__all__} | {"ContactEnv": environment_class()}
    for name, thing in list(public.items()):
        if isinstance(thing, type):
            methods = {f"{name}.{method}": value for method, value in vars(thing).items() if method[0] != "_"}
            public |= {key: value for key, value in methods.items() if inspect.isfunction(value)}
    found = {}
    for name, thing in public.items():
        if callable(thing) and not (isinstance(thing, type) and issubclass(thing, Exception)):
            names = STEP_NAMES & set(inspect.signature(thing).parameters)
            if names:
                found[name] = names
    # which passes its arguments on to simulate
    assert set(found) == set(STEPPED) - {"LoadedScene.simulate"}
    assert all(names == {"dt", "step"} for names in found.values()), found


@pytest.mark.parametrize("name", STEPPED)
def test_a_step_of_time_goes_by_either_name_but_not_by_both(name):
    """By the alias to the last bit what `dt` gives, other than the default's; both names at once are refused."""
    call = STEPPED[name]
    scene, state = touching(pc.Coulomb(0.3))
    torques = np.tile([0.0, 0.5, 0.0, 0.2, 0.0, 0.0], (3, 1))
    by_dt, by_step = (call(scene, state, torques, **{key: 2e-3}) for key in ("dt", "step"))
    assert np.array_equal(by_dt, by_step)
    assert not np.array_equal(by_dt, call(scene, state, torques))
    for value in (1e-3, 2e-3):
        with pytest.raises(pc.ArgumentError, match=f"step is another name of dt.*dt=0.002 and step={value}"):
            call(scene, state, torques, dt=2e-3, step=value)
    for key in ("dt", "step"):
        for value in (0.0, -1e-3, "0.3", math.nan, math.inf, True):
            with pytest.raises(pc.ArgumentError, match=f"^{key} must be positive"):
                call(scene, state, torques, **{key: value})


@pytest.mark.parametrize("number", [np.float32(0.25), np.float64(0.25), np.array(0.25)])
def test_numbers_of_other_types_are_numbers(number):
    assert pc.Circle(number).shape == pc.Circle(0.25).shape
    assert pc.Coulomb(number) == pc.Coulomb(0.25)
    assert pc.HarmonicMotion(frequency=number).parameters[10] == pc.HarmonicMotion(frequency=0.25).parameters[10]
    assert pc.Circle(np.int64(2)).size == 2.0
