"""Bad input is answered by a typed error before any work is done; what goes wrong later ends the run and keeps what
there is."""

import dataclasses
import math
import re
import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from shared import one_body

import pincontact as pc

URDF = Path(__file__).resolve().parent.parent / "urdf"

RADIUS, LEAN = 0.3, 1.2


def disk_model():
    return one_body(
        pin.JointModelFreeFlyer(), pin.Inertia(1.0, np.zeros(3), np.diag([0.02, 0.02, 0.04])), "disk", joint="root"
    )


def disk_scene(friction=None, model=None, **contact):
    scene = pc.Scene(disk_model() if model is None else model)
    rim, floor = scene.add_contour("rim", pc.Circle(RADIUS), "disk"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("rim/floor", rim, floor, friction=friction, **contact)
    return scene


HEIGHT = RADIUS * math.sin(LEAN)


def leaning(height=HEIGHT):
    """q of the disk, its axis at LEAN to the vertical."""
    return np.array([0.0, 0.0, height, 0.0, math.sin(0.5 * LEAN), 0.0, math.cos(0.5 * LEAN)])


ROLLING = np.array([0.3, -0.1, 0.2, 0.1, 0.4, 6.0])


@pytest.fixture
def scene():
    return disk_scene(pc.Coulomb(0.8))


@pytest.fixture
def state(scene):
    return scene.initial_state(leaning(), ROLLING)


# ---------------------------------------------------------------------------------------------------- models


def test_missing_urdf(tmp_path):
    with pytest.raises(pc.ModelError, match=r"not found.*nowhere\.urdf"):
        pc.Scene.from_urdf(tmp_path / "nowhere.urdf")


def test_broken_urdf(tmp_path):
    path = tmp_path / "broken.urdf"
    path.write_text("<robot name='r'><link name='a'/><joint")
    with pytest.raises(pc.ModelError, match=r"broken\.urdf"):
        pc.Scene.from_urdf(path)


def test_scene_needs_a_model():
    with pytest.raises(pc.ModelError, match="str"):
        pc.Scene("disk.urdf")


def test_unknown_frame_with_a_hint(scene):
    with pytest.raises(pc.ModelError, match="did you mean disk"):
        scene.add_contour("other", pc.Plane(), "disc")
    with pytest.raises(pc.ModelError, match="universe"):
        scene.add_contour("other", pc.Plane(), "completely elsewhere")
    assert "other" not in scene.contours


# ---------------------------------------------------------------------------------------------------- contours


@pytest.mark.parametrize(
    ("make", "number"),
    [
        (lambda: pc.Circle(-0.3), "-0.3"),
        (lambda: pc.Sphere(0.0), "0.0"),
        (lambda: pc.Ellipsoid(0.1, math.nan, 0.1), "nan"),
        (lambda: pc.Cylinder(math.inf), "inf"),
        (lambda: pc.Torus(0.1, 0.2), "0.2"),
        (lambda: pc.Cone(2.0), "2.0"),
    ],
)
def test_shapes_out_of_bounds(make, number):
    with pytest.raises(pc.ContourError, match=number):
        make()


def test_contour_names_and_placements(scene):
    with pytest.raises(pc.ContourError, match="already a contour named 'rim'"):
        scene.add_contour("rim", pc.Plane())
    with pytest.raises(pc.ContourError, match=r"0\.3"):
        scene.add_contour("number", 0.3)
    with pytest.raises(pc.ContourError, match="finite"):
        scene.add_contour("lost", pc.Plane(), placement=pin.SE3(np.eye(3), np.array([0.0, math.nan, 0.0])))
    with pytest.raises(pc.ContourError, match="rotation"):
        scene.add_contour("sheared", pc.Plane(), placement=pin.SE3(2.0 * np.eye(3), np.zeros(3)))


# ---------------------------------------------------------------------------------------------------- contacts


@pytest.mark.parametrize("mu", [-0.1, math.nan, math.inf, "rough"])
def test_friction_out_of_bounds(mu):
    with pytest.raises(pc.FrictionError, match="mu"):
        pc.Coulomb(mu)


def test_static_friction_below_sliding():
    with pytest.raises(pc.FrictionError, match=r"0\.2 < 0\.3"):
        pc.Coulomb(0.3, mu_static=0.2)


@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        ({"friction": 0.4}, pc.ArgumentError, r"0\.4"),
        ({"side": 2}, pc.ArgumentError, "side"),
        ({"restitution": 1.5}, pc.ArgumentError, r"1\.5"),
        ({"location": 0.3}, pc.ArgumentError, r"0\.3"),
        ({"location": ((0.1, 0.2), None)}, pc.ArgumentError, "'rim' needs 1"),
        ({"location": (math.nan, None)}, pc.ArgumentError, "finite"),
        ({"pattern": "S-S"}, pc.PatternError, "3C-S, not S-S"),
        ({"pattern": "2D"}, pc.PatternError, "2D"),
    ],
)
def test_contact_arguments(options, error, text):
    with pytest.raises(error, match=text) as caught:
        disk_scene(**options)
    assert "rim/floor" in str(caught.value)


def test_contact_names_and_partners(scene):
    with pytest.raises(pc.ArgumentError, match="already a contact named 'rim/floor'"):
        scene.add_contact("rim/floor", "rim", "floor")
    with pytest.raises(pc.ArgumentError, match="unknown contour 'roof'"):
        scene.add_contact("other", "rim", "roof")
    with pytest.raises(pc.ArgumentError, match="itself"):
        scene.add_contact("other", "rim", "rim")
    hub = scene.add_contour("hub", pc.Point(), "disk")
    with pytest.raises(pc.ArgumentError, match="same body"):
        scene.add_contact("other", hub, "rim")
    stranger = disk_scene().contours["floor"]
    with pytest.raises(pc.ArgumentError, match="another scene"):
        scene.add_contact("other", "rim", stranger)
    tip = scene.add_contour("tip", pc.Point())
    with pytest.raises(pc.PatternError, match="point against a point"):
        scene.add_contact("other", hub, tip)
    assert list(scene.contacts) == ["rim/floor"]


def test_planar_pattern_in_space():
    """A disk that can fall over is not planar: said at once, not found out during the run."""
    scene = pc.Scene(disk_model())
    rim, rail = scene.add_contour("rim", pc.Circle(RADIUS), "disk"), scene.add_contour("rail", pc.Line())
    with pytest.raises(pc.PatternError, match="can leave the plane"):
        scene.add_contact("rim/rail", rim, rail, pattern="2C-2C")


# ---------------------------------------------------------------------------------------------------- states


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda q, v: (q[:-1], v), "q must have 7 entries, got 6"),
        (lambda q, v: (q, v[:-1]), "v must have 6 entries, got 5"),
        (lambda q, v: (np.where(np.arange(7) == 2, np.nan, q), v), r"q\[2\] is nan"),
        (lambda q, v: (q, np.where(np.arange(6) == 4, np.inf, v)), r"v\[4\] is inf"),
        (lambda q, v: ("upright", v), "q must be 7 numbers"),
        (lambda q, v: (np.where(np.arange(7) >= 3, 1.01 * q, q), v), r"quaternion.*1\.01"),
    ],
)
def test_states_out_of_bounds(scene, change, text):
    with pytest.raises(pc.StateError, match=text):
        scene.initial_state(*change(leaning(), ROLLING))


def test_time_of_a_state(scene):
    with pytest.raises(pc.StateError, match="nan"):
        scene.initial_state(leaning(), ROLLING, t=math.nan)


def test_angle_pairs_of_planar_joints():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
    with pytest.raises(pc.StateError, match=r"\(cos, sin\)"):
        pc.Scene(model).initial_state([0.0, 0.0, 1.0, 0.1])


@pytest.mark.parametrize("gap", [0.1, -0.1])
def test_contours_apart(scene, gap):
    with pytest.raises(pc.NoContactError, match="rim/floor") as caught:
        scene.initial_state(leaning(HEIGHT + gap), ROLLING)
    assert caught.value.gap == pytest.approx(gap, abs=1e-12)


def ball_on(shape, side=None, **options):
    scene = pc.Scene.from_urdf(URDF / "ball.urdf", floating_base=True)
    ball, ground = scene.add_contour("ball", pc.Sphere(0.1), "ball"), scene.add_contour("ground", shape)
    scene.add_contact("c", ball, ground, side=side, **options)
    return scene


def at(*place):
    return np.r_[place, 0.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("shape", "side", "place"),
    [(pc.Plane(), 1, (0.0, 0.0, 0.1)), (pc.Sphere(1.0), 1, (0.0, 0.0, 1.1)), (pc.Sphere(1.0), -1, (0.0, 0.0, -0.9))],
)
def test_wrong_side_is_named(shape, side, place):
    """On a plane, on a ball and in a bowl: where the bodies touch, the message says which side it takes."""
    ball_on(shape, side).initial_state(at(*place))
    with pytest.raises(
        pc.NoContactError, match=re.escape(f"other side: add_contact has side={-side:+d}, try side={side:+d}")
    ):
        ball_on(shape, -side).initial_state(at(*place))


def test_what_to_do_about_gaps():
    scene = pc.Scene.from_urdf(URDF / "ball.urdf", floating_base=True)
    tip, floor = scene.add_contour("tip", pc.Point(), "ball"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", tip, floor)
    with pytest.raises(pc.NoContactError, match=r"gap is 0\.3 m.*move q, or to start open pass free=\['c'\]"):
        scene.initial_state(at(0.0, 0.0, 0.3))
    with pytest.raises(
        pc.NoContactError, match=r"gap is -0\.3 m.*move q, or give add_contact side=-1 \(here it is \+1"
    ):
        scene.initial_state(at(0.0, 0.0, -0.3))


def test_all_contacts_that_do_not_touch_are_named():
    scene = pc.Scene.from_urdf(URDF / "ball.urdf", floating_base=True)
    floor = scene.add_contour("floor", pc.Plane())
    for name, height in (("low", -0.1), ("middle", 0.0), ("high", 0.1)):
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, height]))
        scene.add_contact(name, scene.add_contour(name, pc.Point(), "ball", place), floor)
    beside = scene.add_contour("beside", pc.Plane(domain=((5.0, 6.0), (5.0, 6.0))))
    scene.add_contact("beside", "low", beside)
    with pytest.raises(
        pc.NoContactError, match=r"'middle'.*gap is 0\.1 m.*nor .* 'high' \(0\.2 m\), 'beside' \(no point"
    ) as told:
        scene.initial_state(at(0.0, 0.0, 0.1))
    assert told.value.gap == pytest.approx(0.1)


def test_a_step_that_fails_names_contacts_and_what_goes_on():
    noise = np.random.default_rng(0)
    scene = ball_on(pc.Plane(), friction=pc.NoSlip())
    run = pc.simulate(
        scene, scene.initial_state(at(0.0, 0.0, 0.1)), 1.0, control=lambda t, q, v: noise.normal(0.0, 1e6, 6)
    )
    assert run.status == -1
    assert "'c' stick" in run.message and 'fallback="Moreau"' in run.message
    # the location equations have nothing to do with it
    assert "conditioning" not in run.message


def test_time_stepping_warns_of_what_it_does_not_use(scene, state):
    for given in ({"rtol": 1e-5, "fixed_step": 1e-2}, {"atol": 1e-7}, {"max_step": 0.1}, {"first_step": 1e-3}):
        with pytest.warns(UserWarning, match=f"{', '.join(given)} have no effect with method 'Moreau'") as told:
            pc.simulate(scene, state, 1e-3, method="Moreau", **given)
        assert told[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pc.simulate(scene, state, 1e-3, method="Moreau", dt=5e-4)
        pc.simulate(scene, state, 1e-3, fallback="Moreau", rtol=1e-6)


def test_forgotten_floating_base():
    scene = pc.Scene.from_urdf(URDF / "disk.urdf")
    rim, floor = scene.add_contour("rim", pc.Circle(0.3), "disk"), scene.add_contour("floor", pc.Plane())
    with pytest.raises(pc.ArgumentError, match=r"'rim' \(frame 'disk'\).*the universe.*floating_base=True"):
        scene.add_contact("c", rim, floor)
    moving = pc.Scene.from_urdf(URDF / "disk.urdf", floating_base=True)
    pair = [moving.add_contour(name, pc.Circle(0.3), "disk") for name in ("one", "two")]
    with pytest.raises(pc.ArgumentError, match="same body, that of joint 'root_joint', and cannot move") as caught:
        moving.add_contact("c", *pair)
    assert "floating_base" not in str(caught.value)


def test_open_contacts_may_start_where_nothing_can_touch():
    """A ball beside a plate falls past it; one above it lands there. A barrel that is tilted beyond the end of its
    profile falls until it hits, or not at all."""
    shape = pc.ParametricSurface(lambda u, v: (u, v, 0.0), ((-0.5, 0.5), (-0.5, 0.5)))
    scene = ball_on(shape)
    with pytest.raises(pc.ContactError):
        scene.initial_state(at(1.0, 0.0, 0.1))
    for x, lands in ((1.0, False), (0.0, True)):
        run = pc.simulate(scene, scene.initial_state(at(x, 0.0, 0.3), free=["c"]), 0.5)
        assert run.status == 0, run.message
        fallen = 0.3 - 0.5 * 9.81 * 0.5**2
        assert run.q[-1, 2] == pytest.approx(0.1 if lands else fallen, abs=1e-8)
        assert bool(run.events) == lands
    scene = pc.Scene.from_urdf(URDF / "ball.urdf", floating_base=True)
    barrel = scene.add_contour("barrel", pc.SurfaceOfRevolution(lambda u: (0.1 - 0.4 * u * u, u), (-0.1, 0.1)), "ball")
    scene.add_contact("c", barrel, scene.add_contour("floor", pc.Plane()))
    turned = pin.Quaternion(pin.utils.rotate("x", 0.5 * np.pi + 0.3)).coeffs()
    run = pc.simulate(scene, scene.initial_state(np.r_[0.0, 0.0, 0.5, turned], free=["c"]), 0.2)
    assert run.status == 0, run.message
    assert run.q[-1, 2] == pytest.approx(0.5 - 0.5 * 9.81 * 0.2**2, abs=1e-8)


def test_arcs_that_face_away_from_each_other_need_their_side():
    """Where no points of open contacts are nearest, and both contours end, the side is not seen; given, it runs."""
    model = pin.Model()
    model.gravity.linear = np.zeros(3)
    for name, x in (("one", 0.0), ("two", 0.3)):
        joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])), name)
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    away = [np.pi, 0.0]
    for side in (None, 1, -1):
        scene = pc.Scene(model)
        arc = pc.ParametricCurve(lambda u: (0.14 * np.cos(u), 0.1 * np.sin(u), 0.0), domain=(-0.4, 0.4))
        pair = [scene.add_contour(f"arc {name}", arc, name) for name in ("one", "two")]
        scene.add_contact("c", *pair, side=side)
        if side is None:
            with pytest.raises(pc.NoContactError, match="give side="):
                scene.initial_state(away, free=["c"])
        else:
            assert pc.simulate(scene, scene.initial_state(away, free=["c"]), 0.1).status == 0


def test_small_gap_is_closed_and_reported(scene):
    state = scene.initial_state(leaning(HEIGHT + 1e-3), ROLLING)
    assert state.correction.gaps["rim/floor"] == pytest.approx(1e-3, rel=1e-9)
    assert 1e-4 < state.correction.dq < 1e-2
    with pytest.raises(pc.NoContactError):
        scene.initial_state(leaning(HEIGHT + 1e-3), ROLLING, max_gap=1e-4)


def test_free_contacts(scene):
    with pytest.raises(pc.ArgumentError, match="unknown contact 'roof'"):
        scene.initial_state(leaning(), ROLLING, free=["roof"])
    held = disk_scene(bilateral=True)
    with pytest.raises(pc.ArgumentError, match="bilateral"):
        held.initial_state(leaning(), ROLLING, free=["rim/floor"])
    apart = scene.initial_state(leaning(1.0), ROLLING, free=["rim/floor"])
    assert apart.q[2] == 1.0


def test_flat_disk_is_singular(scene):
    """A disk that lies flat touches along its whole rim: no point contact, and no NaN."""
    flat = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    with pytest.raises((pc.SingularContactError, pc.NoContactError), match="rim"):
        scene.initial_state(flat)


# ---------------------------------------------------------------------------------------------------- simulate


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"duration": -1.0}, "duration.*-1"),
        ({"duration": math.nan}, "duration.*nan"),
        ({"duration": math.inf}, "duration"),
        ({"duration": "long"}, "duration.*long"),
        ({"rtol": -1e-6}, "rtol"),
        ({"atol": 0.0}, "atol"),
        ({"atol": math.nan}, "atol"),
        ({"max_step": 0.0}, "max_step"),
        ({"first_step": -1.0}, "first_step"),
        ({"fixed_step": 0.0}, "fixed_step"),
        ({"max_steps": 0}, "max_steps"),
        ({"method": "Euler"}, "Euler.*DOP853.*Moreau"),
        ({"method": "Sharp98", "rtol": 1e-4}, r"rtol must be at most 1e-05.*Sharp98.*0\.0001"),
        ({"control": 3.0}, r"3\.0"),
        ({"events": [None]}, r"events\[0\]"),
        ({"t_eval": [0.0, 2.0]}, r"t_eval must lie in \[0.0, 1.0\]"),
        ({"t_eval": [-0.5, 0.5]}, "t_eval must lie"),
        ({"t_eval": [0.5, 0.2]}, "must not decrease"),
        ({"t_eval": [0.1, math.nan]}, "not finite"),
    ],
)
def test_arguments_of_simulate(scene, state, options, text):
    with pytest.raises(pc.ArgumentError, match=text):
        pc.simulate(scene, state, **({"duration": 1.0} | options))


def test_states_of_other_scenes(scene, state):
    with pytest.raises(pc.ArgumentError, match="another scene"):
        pc.simulate(disk_scene(), state, 1.0)
    with pytest.raises(pc.ArgumentError, match="initial_state"):
        pc.simulate(scene, leaning(), 1.0)
    with pytest.raises(pc.ArgumentError, match="Scene"):
        pc.simulate(scene.model, state, 1.0)
    tip = scene.add_contour("tip", pc.Point(), "disk")
    scene.add_contact("late", tip, "floor")
    with pytest.raises(pc.ArgumentError, match="added after"):
        pc.simulate(scene, state, 1.0)


# ---------------------------------------------------------------------------------------------------- controllers


@pytest.mark.parametrize(
    ("control", "text"),
    [
        (lambda t, q, v: np.full(6, np.nan) if t > 0.3 else np.zeros(6), "control returned nan"),
        (lambda t, q, v: np.zeros(5) if t > 0.3 else np.zeros(6), r"shape \(5,\), not \(6,\)"),
        (lambda t, q, v: "left" if t > 0.3 else np.zeros(6), r"t = .* s: control returned 'left': could not convert"),
        (lambda t, q, v: None if t > 0.3 else np.zeros(6), r"t = .* s: control returned None, not an array of"),
        (lambda t, q, v: np.zeros(6) + (1j if t > 0.3 else 0j), r"t = .* s: control returned complex numbers: \["),
        (lambda t, q, v: [0.0, 0.0, 0.0, 0.0, 0.0, 1j] if t > 0.3 else np.zeros(6), "complex numbers"),
    ],
)
def test_failing_controllers_end_the_run(scene, state, control, text):
    run = pc.simulate(scene, state, 1.0, control=control, t_eval=np.linspace(0.0, 1.0, 21))
    assert run.status < 0
    assert not run.success
    assert re.search(text, run.message), run.message
    # everything up to the failure is there, and is what it would have been
    assert 1 <= run.t.size <= 7
    reference = pc.simulate(scene, state, 1.0, control=lambda t, q, v: np.zeros(6), t_eval=run.t)
    np.testing.assert_allclose(run.q, reference.q, rtol=0.0, atol=1e-8)
    assert np.isfinite(run.contacts["rim/floor"].force).all()


def test_failing_at_once(scene, state):
    run = pc.simulate(scene, state, 1.0, control=lambda t, q, v: [math.nan] * 6)
    assert run.status < 0
    assert "t = 0 s" in run.message
    assert run.t.size == 1
    assert run.q.shape == (1, 7)
    # the quaternion has been normalised once more
    assert np.allclose(run.q[0], state.q, rtol=1e-15, atol=1e-16)
    assert run.contacts["rim/floor"].force.shape == (1, 3)


def test_controller_cannot_change_the_state(scene, state):
    """It sees the state read-only: writing to it raises, and changes nothing."""

    def meddling(t, q, v):
        if t > 0.2:
            q[:], v[:] = 0.0, 0.0
        return np.zeros(6)

    with pytest.raises(ValueError, match="read-only") as caught:
        pc.simulate(scene, state, 0.5, control=meddling)
    a = caught.value.run
    assert a.t.size > 1
    b = pc.simulate(scene, state, 0.5, control=lambda t, q, v: np.zeros(6))
    np.testing.assert_array_equal(a.q, b.q[: a.t.size])


# ---------------------------------------------------------------------------------------------------- limits


def test_zero_duration(scene, state):
    run = pc.simulate(scene, state, 0.0)
    assert run.status == 0
    np.testing.assert_array_equal(run.t, [0.0])
    np.testing.assert_allclose(run.q[0], state.q, rtol=0.0, atol=1e-15)
    assert run.contacts["rim/floor"].normal_force[0] > 0.0


@pytest.mark.parametrize("duration", [5e-324, 1e-300, 1e-18, 1e-12, 1e-6])
@pytest.mark.parametrize("t", [0.0, 12.5])
def test_tiny_durations(scene, duration, t):
    state = scene.initial_state(leaning(), ROLLING, t)
    run = pc.simulate(scene, state, duration, t_eval=[t, t + duration])
    assert run.status == 0, run.message
    assert run.t.size == 2
    speeds = np.abs(state.v).max()
    assert np.abs(run.q[-1] - state.q).max() <= 2.0 * duration * speeds + 1e-14
    assert np.abs(run.v[-1] - state.v).max() <= 1e3 * duration + 1e-13


@pytest.mark.parametrize("t_eval", [[], [0.0], [1.0], [0.0, 0.0, 0.5, 0.5, 1.0], np.linspace(0.0, 1.0, 1001)])
def test_any_output_times(scene, state, t_eval):
    run = pc.simulate(scene, state, 1.0, t_eval=t_eval)
    assert run.status == 0
    np.testing.assert_array_equal(run.t, t_eval)
    assert run.q.shape == (len(t_eval), 7)


def test_step_limit(scene, state):
    run = pc.simulate(scene, state, 100.0, max_steps=12)
    assert run.status < 0
    assert "12 steps" in run.message
    assert 1 < run.t.size <= 13
    assert run.t[-1] < 100.0
    assert np.isfinite(run.q).all()


def test_step_floor():
    """A controller that drives the velocity to infinity in finite time: the step shrinks to nothing and the run says
    where. v' = v^2 from v = 1 is infinite at t = 1."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    scene = pc.Scene(model)
    state = scene.initial_state([0.0], [1.0])
    run = pc.simulate(scene, state, 2.0, control=lambda t, q, v: v * v)
    assert run.status < 0
    assert "step" in run.message
    assert "t = 1" in run.message or "t = 0.999" in run.message
    assert np.isfinite(run.q).all()
    slow = run.v[:, 0] < 1e4  # beyond, 1 - t has lost the digits that this comparison needs
    np.testing.assert_allclose(run.v[slow, 0], 1.0 / (1.0 - run.t[slow]), rtol=1e-3)


# ---------------------------------------------------------------------------------------------------- files


def test_save_and_load(scene, state, tmp_path):
    def passes(t, q, v):
        return q[0] - 0.05

    run = pc.simulate(scene, state, 1.5, control=lambda t, q, v: np.full(6, 0.01), events=passes, energies=True)
    assert run.events
    path = tmp_path / "run.npz"
    run.save(path)
    for loaded in (pc.Trajectory.load(path), pc.Trajectory.load(path, scene)):
        for key in ("t", "q", "v"):
            np.testing.assert_array_equal(getattr(loaded, key), getattr(run, key))
        assert (loaded.status, loaded.message, loaded.stats) == (run.status, run.message, run.stats)
        assert len(loaded.events) == len(run.events)
        for a, b in zip(loaded.events, run.events, strict=True):
            assert (a.time, a.contact, a.kind, a.index) == (b.time, b.contact, b.kind, b.index)
            np.testing.assert_array_equal(a.q, b.q)
            np.testing.assert_array_equal(a.v, b.v)
        for key, value in vars(run.contacts["rim/floor"]).items():
            np.testing.assert_array_equal(getattr(loaded.contacts["rim/floor"], key), value, err_msg=key)
        for key, value in run.residuals().items():
            np.testing.assert_array_equal(loaded.residuals()[key], value)
    again = pc.Trajectory.load(path, scene)
    np.testing.assert_array_equal(again.energies().friction_work, run.energies().friction_work)
    # a loaded run can be gone on with
    more = pc.simulate(scene, again.state(), 0.1)
    assert more.status == 0
    assert more.t[-1] == pytest.approx(1.6)


@pytest.mark.parametrize("index", [1.5, np.float64(1.0), True, None, "last", 10**6, -(10**6)])
def test_what_is_no_output(scene, state, index):
    run = pc.simulate(scene, state, 0.01)
    with pytest.raises(pc.ArgumentError, match="index must be the number of an output"):
        run.state(index)
    with pytest.raises(pc.ArgumentError, match="index must be the number of an output"):
        run.external_forces(index)
    with pytest.raises(pc.ArgumentError, match="index must be the number of an output"):
        run.contacts["rim/floor"].at(index)
    assert run.state(np.int64(-1)).t == run.state(len(run.t) - 1).t == run.t[-1]


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
@pytest.mark.parametrize(("start", "rounding"), [(1e17, "16"), (-1e12, "0.000122")])
def test_times_that_are_rounded_are_told(scene, state, method, start, rounding):
    """A second is nothing beside 1e17 s: the run ends where it began. Beside 1e12 s lengths of steps are rounded."""
    run = pc.simulate(
        scene, dataclasses.replace(state, t=start), 1.0, method=method, dt=100.0 if method == "Moreau" else None
    )
    assert f"; times near {start:.6g} s are rounded by {rounding} s, of 1 s" in run.message
    assert "rounded" not in pc.simulate(scene, state, 0.0).message


def test_files_that_are_no_runs(scene, state, tmp_path):
    with pytest.raises(pc.TrajectoryError, match=r"gone\.npz"):
        pc.Trajectory.load(tmp_path / "gone.npz")
    text = tmp_path / "text.npz"
    text.write_text("not a run")
    with pytest.raises(pc.TrajectoryError, match=r"text\.npz"):
        pc.Trajectory.load(text)
    numbers = tmp_path / "numbers.npz"
    np.savez(numbers, t=np.zeros(3))
    with pytest.raises(pc.TrajectoryError, match=r"numbers\.npz"):
        pc.Trajectory.load(numbers)
    path = tmp_path / "run.npz"
    pc.simulate(scene, state, 0.1).save(path)
    cut = tmp_path / "cut.npz"
    cut.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(pc.TrajectoryError, match=r"cut\.npz"):
        pc.Trajectory.load(cut)
    other = pc.Scene(disk_model())
    with pytest.raises(pc.TrajectoryError, match="contacts"):
        pc.Trajectory.load(path, other)


def test_unknown_contact_of_a_run(scene, state):
    run = pc.simulate(scene, state, 0.0)
    with pytest.raises(pc.TrajectoryError, match=r"roof.*rim/floor"):
        run.contacts["roof"]
    with pytest.raises(pc.ArgumentError, match="roof"):
        state.location_of("roof")
    with pytest.raises(pc.TrajectoryError, match="energies=True"):
        _ = run.energies().balance


def test_every_error_is_a_contact_error():
    for name in dir(pc):
        found = getattr(pc, name)
        if isinstance(found, type) and issubclass(found, Exception):
            assert issubclass(found, pc.ContactError), name


@pytest.mark.parametrize("seed", range(6))
def test_the_side_on_which_bodies_would_be_inside_each_other_is_refused(seed):
    """Of circles that touch from outside, or from inside, one side can be meant: the other one was taken, and a body
    went through the other one."""
    rng = np.random.default_rng(seed)
    inside, angle = bool(seed % 2), rng.uniform(0.0, 2.0 * np.pi)
    large, small = rng.uniform(0.5, 2.0), rng.uniform(0.1, 0.4)
    distance = large - small if inside else large + small
    right = -1 if inside else 1
    for side in (-1, 1):
        model = pin.Model()
        joint = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "planar")
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
        model.addBodyFrame("wheel", joint, pin.SE3.Identity(), 0)
        scene = pc.Scene(model)
        wheel, ring = scene.add_contour("wheel", pc.Circle(small), "wheel"), scene.add_contour("ring", pc.Circle(large))
        scene.add_contact("touch", wheel, ring, side=side, location=(angle if inside else angle + np.pi, angle))
        q = [distance * np.cos(angle), distance * np.sin(angle), 1.0, 0.0]
        if side == right:
            assert abs(scene.initial_state(q, np.zeros(3)).q[0] - q[0]) < 1e-12
        else:
            with pytest.raises(pc.NoContactError, match=re.escape(f"takes side={right:+d}")):
                scene.initial_state(q, np.zeros(3))
