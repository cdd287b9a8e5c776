"""Zeros of event functions: the root finder alone, and along a step of the dense output."""

import itertools
import math

import numpy as np
import pinocchio as pin
import pytest
from calling import from_python
from shared import one_body

import pincontact as pc
from pincontact.integration import sign_changes
from pincontact.integration.crossings import find_crossings, find_minima
from pincontact.integration.locator import EventLocator, fastest
from pincontact.integration.runge_kutta import RungeKutta
from pincontact.integration.sign_changes import asked_once, crossing_between, zero_between
from pincontact.integration.steps import FIND_ZERO
from pincontact.layout import (
    DOMAIN_EVENT,
    EVENTS_PER_CONTACT,
    GAP_EVENT,
    LEFT_ROW,
    LOOK_ROW,
    NORMAL_EVENT,
    NOTHING_THERE,
    RIGHT_ROW,
    SPEED_EVENT,
)

ACCURACY = 1e-15
# a bracket is as narrow as that where the search ends, and either end is the zero
WIDTH = 2.0 * (ACCURACY + 2.2e-16)
# bisection alone takes 49 from a width of 1; interpolation that gets nowhere at most doubles that
MOST_LOOKS = 98


def searched(function, low, high):
    """The zero, and where was looked, both ends first."""
    places = []

    def value(x):
        places.append(x)
        return function(x)

    return zero_between(value, low, high, ACCURACY), places


# function, zero, looks (both ends count): as many as secants and parabolas take from there
SMOOTH = {
    "line": (lambda x: 0.3 - x, 0.3, 4),
    "cosine": (lambda x: math.cos(x) - x, 0.7390851332151607, 7),
    "exponential": (lambda x: 1.0 - math.exp(4.0 * (x - 0.9)), 0.9, 9),
    "square root": (lambda x: math.sqrt(0.5) - math.sqrt(x), 0.5, 5),
    "tiny": (lambda x: 1e-300 * (0.25 - x * x), 0.5, 9),
    "huge": (lambda x: 1e90 * (0.25 - x * x), 0.5, 9),
    "rises": (lambda x: x - 0.7, 0.7, 4),
    "falls fast at the end": (lambda x: 1.0 - x**40, 1.0, 4),
}


@pytest.mark.parametrize("case", SMOOTH)
def test_zeros_of_smooth_functions(case):
    function, zero, looks = SMOOTH[case]
    found, places = searched(function, 0.0, 1.0)
    # the functions themselves have a round-off of some 1e-16 over their slopes, which are 1 or steeper
    assert found == pytest.approx(zero, abs=WIDTH)
    assert len(places) <= looks
    assert min(places) == 0.0 and max(places) == 1.0


JUMPS = {
    "step": lambda x: 1.0 if x < 0.3 else -1.0,
    "uneven step": lambda x: 1e-8 if x < 0.3 else -1e8,
    "from zero": lambda x: 0.3 - x if x < 0.3 else -math.inf,
    "flat, then a jump": lambda x: (0.3 - x) ** 21 if x < 0.3 else -math.inf,
    "infinite on both sides": lambda x: math.inf if x < 0.3 else -math.inf,
    "pole": lambda x: 1.0 / (0.3 - x) if x != 0.3 else math.inf,
    "square root of what is left": lambda x: math.sqrt(0.3 - x) if x < 0.3 else -math.sqrt(x - 0.3),
    "cube": lambda x: (0.3 - x) ** 3,
    "flat": lambda x: (0.3 - x) ** 21,
    "flat on one side": lambda x: (0.3 - x) ** 9 if x < 0.3 else 0.3 - x,
}


@pytest.mark.parametrize("case", JUMPS)
def test_zeros_of_what_jumps_or_is_flat(case):
    found, places = searched(JUMPS[case], 0.0, 1.0)
    assert found == pytest.approx(0.3, abs=WIDTH) or JUMPS[case](found) == 0.0
    assert len(places) <= MOST_LOOKS
    assert min(places) == 0.0 and max(places) == 1.0


def test_zeros_at_the_ends():
    """What is zero at an end has its zero there, and what is as narrow as zeros are told apart is not divided."""
    for function, low, high, zero in [
        (lambda x: x, 0.0, 1.0, 0.0),
        (lambda x: 1.0 - x, 0.0, 1.0, 1.0),
        (lambda x: -x, 0.0, 1.0, 0.0),
        (lambda x: 0.5 - x, 0.5, 0.5 + 1e-15, 0.5),
        (lambda x: 1e-3 - x, 0.0, 1e-3, 1e-3),
    ]:
        found, places = searched(function, low, high)
        assert found == pytest.approx(zero, abs=WIDTH)
        assert all(low <= place <= high for place in places) and len(places) <= 5


def test_functions_are_asked_once():
    """What answers otherwise the next time has one answer for each place; those that are known are not asked for."""
    rng, places = np.random.default_rng(0), []

    def noise(x):
        places.append(x)
        return rng.normal()

    function = asked_once(noise, {0.0: 1.5, 1.0: -2.5})
    answers = [function(x) for x in (0.0, 0.5, 1.0, 0.5, 0.25, 0.5)]
    assert (answers[0], answers[2]) == (1.5, -2.5)
    assert answers[1] == answers[3] == answers[5] != answers[4]
    assert places == [0.5, 0.25]


@pytest.mark.parametrize(
    ("before", "after", "found"),
    [(1.0, -1.0, 0.3), (1.0, 0.0, 0.3), (1.0, -math.inf, 0.9), (math.inf, -1.0, 0.9), (-math.inf, math.inf, 0.9)],
)
def test_crossings_of_what_is_infinite_or_stays_zero(before, after, found):
    """Infinite values do not say where between them a function crosses zero: it has at the end. One that comes to zero
    and stays there is zero from its first zero on."""
    place = crossing_between(lambda x: before if x < 0.3 else after, 0.1, 0.9, ACCURACY)
    assert place == pytest.approx(found, abs=WIDTH)


def test_the_bracket_holds_a_sign_change_and_shrinks():
    """Random cubics, and the same with a jump: every look is inside the bracket, whose ends differ in sign and only
    come closer; looks are fewer than bisection takes on the average."""
    rng = np.random.default_rng(0)
    counts = []
    for i in range(200):
        zero, (a, b) = rng.uniform(0.02, 0.98), rng.uniform(-2.4, 2.4, 2)
        jump = 10.0 ** rng.uniform(-6, 1) if i % 4 == 0 else 0.0

        def function(x, zero=zero, a=a, b=b, jump=jump):
            return (zero - x) * (5.0 + a * x + b * x * x) - (jump if x > zero else 0.0)

        bracket, place = [0.0] * 6, 1.0
        sign_changes.begin_bracket(bracket, 0.0, function(0.0))
        low, high, count = 0.0, 1.0, 0
        while not math.isnan(place):
            assert low <= place <= high
            value, count = function(place), count + 1
            place = sign_changes.narrow(bracket, place, value, ACCURACY)
            assert (bracket[1] < 0.0) != (bracket[3] < 0.0)
            ends = sorted((bracket[0], bracket[2]))
            assert low <= ends[0] < ends[1] <= high
            low, high = ends
        assert sign_changes.zero_in(bracket) == pytest.approx(zero, abs=WIDTH)
        counts.append(count)
    assert max(counts) <= MOST_LOOKS and np.median(counts) <= 8


def test_compiled_as_in_python():
    compiled = from_python(sign_changes.narrow)
    for function in (
        lambda x: math.cos(x) - x,
        *(JUMPS[case] for case in ("cube", "step", "from zero", "infinite on both sides")),
    ):
        brackets = [0.0] * 6, np.zeros(6)
        for bracket in brackets:
            sign_changes.begin_bracket(bracket, 0.0, function(0.0))
        places = [1.0, 1.0]
        for _ in range(MOST_LOOKS):
            places = [
                narrow(bracket, place, function(place), ACCURACY)
                for narrow, bracket, place in zip((sign_changes.narrow, compiled), brackets, places)
            ]
            # as exact as a contraction of products may leave it
            np.testing.assert_allclose(brackets[1], brackets[0], rtol=1e-14)
            if math.isnan(places[0]):
                break
        assert np.isnan(places).all()


# ---------------------------------------------------------------- along a step


def particle(**options):
    """1 kg above a plane, or on it."""
    scene = pc.Scene(one_body(pin.JointModelTranslation(), pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)), "mass"))
    point, plane = scene.add_contour("point", pc.Point(), "mass"), scene.add_contour("plane", pc.Plane())
    scene.add_contact("c", point, plane, **options)
    return scene


class Looked(Exception):
    """Ends a run in which all has been seen."""


class Pressed:
    """A mass without weight is pressed on a plane by a force of time, which is the event function, for a step of 1 s.

    find(function, low, high): where that turns negative, its value there, and how many evaluations that took.
    """

    def __init__(self, monkeypatch):
        self.scene = particle()
        self.scene.model.gravity = pin.Motion.Zero()
        self.monkeypatch, self.pull = monkeypatch, lambda t: 1.0 - 2.0 * t

    def look(self, script):
        """Call script(find) within the first trial step, from 0 to 1."""

        def first(locator, t, step):
            assert (t, step) == (0.0, 1.0)
            locator._set_slack()

            def find(function, low=0.0, high=1.0):
                self.pull, system = function, locator.system
                for i, (row, share) in enumerate([(LEFT_ROW, low), (RIGHT_ROW, high)]):
                    values = system.look(t, step, share)[1]
                    system.scan_shares[[i, row]], system.scan_event_functions[[i, row]] = share, values
                system.counters["scan_count"] = 2
                system.counters["sought_item"], system.counters["sought_kind"] = 0, NORMAL_EVENT
                before = locator.rk.evaluations
                system.run(FIND_ZERO, t, step)
                share, value = system.scan_shares[LOOK_ROW], system.scan_event_functions[LOOK_ROW, 0, NORMAL_EVENT]
                # the last look is the one at the zero
                assert system.scalars["time"] == t + share * step
                return float(share), float(value), locator.rk.evaluations - before

            script(find)
            raise Looked

        self.monkeypatch.setattr(EventLocator, "first", first)
        state = self.scene.initial_state(np.zeros(3), np.zeros(3))
        with pytest.raises(Looked):
            pc.simulate(
                self.scene, state, 1.0, control=lambda t, q, v: [0.0, 0.0, -self.pull(t)], fixed_step=1.0, max_step=2.0
            )


def test_zeros_along_a_step(monkeypatch):
    def script(find):
        for (function, zero, looks), (low, high) in itertools.product(SMOOTH.values(), [(0.0, 1.0), (0.1, 1.0)]):
            if not function(low) > 0.0 > function(high) or not 1e-3 < function(low) < 1e3:
                # forces of the size of 1 N that turn negative
                continue
            share, value, count = find(function, low, high)
            # round-off of forces of 1 N in a solution of equations is zero
            assert share == pytest.approx(zero, abs=WIDTH) or abs(value) <= 1e-14
            assert value == pytest.approx(function(share), abs=1e-15)
            # the ends are known, and the zero may be at the look before the last
            assert count <= looks

    Pressed(monkeypatch).look(script)


def test_a_mode_that_is_entered_on_its_boundary_holds_first(monkeypatch):
    """Zero, or below, at the step's start: the part where the mode holds is looked for, and its end found; where there
    is none it ends at once."""

    def script(find):
        # sin vanishes at 0 and, to round-off, at the end of a half wave
        share, value, count = find(lambda t: math.sin(4.0 * t))
        assert share == pytest.approx(math.pi / 4.0, abs=WIDTH) and abs(value) < 1e-14 and count <= 10
        share, _, _ = find(lambda t: t * (0.4 - t))
        assert share == pytest.approx(0.4, abs=WIDTH)
        share, value, count = find(lambda t: -t)
        assert share == 0.0 and value == 0.0 and count <= 41
        share, value, count = find(lambda t: -1.0)
        assert share == 0.0 and value == -1.0 and count <= 41
        # zero on and on, then negative: what is zero does not hold
        share, value, _ = find(lambda t: min(0.0, 0.6 - t))
        assert share == 0.0

    Pressed(monkeypatch).look(script)


def test_event_functions_that_jump_along_a_step(monkeypatch):
    def script(find):
        for low, high in [(1.0, -1.0), (1e-6, -1e3), (1e3, -1e-6)]:
            share, value, count = find(lambda t, low=low, high=high: low if t < 0.3 else high)
            assert share == pytest.approx(0.3, abs=WIDTH) and count <= MOST_LOOKS
            # the side that is nearer to zero
            assert value == (low if abs(low) <= abs(high) else high)

    Pressed(monkeypatch).look(script)


def test_samples_foretell_the_zero(monkeypatch):
    """The first crossing in a step: samples go on to one behind it, and a few looks at their polynomial's zero do."""
    monkeypatch.setattr(RungeKutta, "alarm", property(lambda self: True))
    first, found = EventLocator.first, {}

    def counted(locator, t, step, begin=0.0):
        before = locator.rk.evaluations
        found[t] = first(locator, t, step, begin)
        found["looks"] = locator.rk.evaluations - before
        raise Looked

    monkeypatch.setattr(EventLocator, "first", counted)
    scene = particle()
    scene.model.gravity = pin.Motion.Zero()
    state = scene.initial_state(np.zeros(3), np.zeros(3))
    cases = [
        # function, zero, samples to one behind it, none at the step's last stage
        (lambda t: math.cos(2.0 * t), 0.25 * math.pi, 8),
        (lambda t: math.cos(5.0 * t), 0.1 * math.pi, 5),
        (lambda t: 0.05 - t, 0.05, 3),
        # a dip between two samples; samples then go to the end
        (lambda t: (t - 0.56) ** 2 - 0.01**2, 0.55, 8 + 3),
    ]
    for pull, zero, samples in cases:
        with pytest.raises(Looked):
            pc.simulate(
                scene, state, 1.0, control=lambda t, q, v, pull=pull: [0.0, 0.0, -pull(t)], fixed_step=1.0, max_step=2.0
            )
        assert found[0.0].theta == pytest.approx(zero, abs=1e-14)
        assert abs(found[0.0].value) <= 1e-14
        assert found["looks"] <= samples + 5


# ---------------------------------------------------------------- true steps


@pytest.mark.parametrize("rtol", [1e-3, 1e-6, 1e-10])
def test_touches_on_dense_output(monkeypatch, rtol):
    """A point bounces: parabolas, which steps and their dense output follow to round-off, so that no step is needed for
    any touch."""
    height, g, kept = 0.2, 9.81, 0.6
    scene = particle(restitution=kept)
    state = scene.initial_state([0.0, 0.0, height], np.zeros(3), free=["c"])
    refine, try_step = EventLocator.refine, RungeKutta.try_step
    taken, counting = [], []

    def counted_refine(locator, t, step, crossing):
        counting.append(0)
        result = refine(locator, t, step, crossing)
        taken.append(counting.pop())
        return result

    def counted_trial(rk, t, h):
        if counting:
            counting[-1] += 1
        return try_step(rk, t, h)

    monkeypatch.setattr(EventLocator, "refine", counted_refine)
    monkeypatch.setattr(RungeKutta, "try_step", counted_trial)
    run = pc.simulate(scene, state, 0.75, rtol=rtol, atol=1e-2 * rtol)
    times = [event.time for event in run.events if event.kind == "touch"]
    fall = math.sqrt(2.0 * height / g)
    expected = [fall * (1.0 + 2.0 * sum(kept**k for k in range(1, n + 1))) for n in range(len(times))]
    assert len(times) >= 5 and len(taken) == len(times)
    # a gap that is zero to a tenth of what open gaps may be below it (see `accuracy`), over the speed of the lowest hop
    slowest = g * fall * kept ** len(times)
    np.testing.assert_allclose(times, expected, rtol=0.0, atol=len(times) * max(1e-13, 1e-7 * rtol / slowest))
    assert taken == [0] * len(times)


def tumbling(restitution=0.0):
    """A thrown body that turns, with a foot at its side over a floor."""
    inertia = pin.Inertia(1.0, np.zeros(3), np.diag([0.02, 0.05, 0.06]))
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), inertia))
    foot = scene.add_contour("foot", pc.Point(), "body", pin.SE3(np.eye(3), np.array([0.2, 0.1, -0.05])))
    scene.add_contact("c", foot, scene.add_contour("floor", pc.Plane()), restitution=restitution)
    state = scene.initial_state(
        [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 1.0, 3.0, -8.0, 5.0], free=["c"]
    )  # fmt: skip
    return scene, state


@pytest.mark.parametrize("rtol", [1e-6, 1e-8])
def test_a_true_step_that_just_misses_is_moved_on(monkeypatch, rtol):
    """A thrown body turns, of which the dense output knows less than steps do: one true step for its touch all the
    same, where its gap is zero to round-off, at the time that shorter steps find."""
    scene, state = tumbling()
    exact = pc.simulate(scene, state, 1.0, rtol=1e-13, atol=1e-15).events[0]
    refine, try_step = EventLocator.refine, RungeKutta.try_step
    attempts, moved, gaps, ends = [], [], [], []

    def counted_refine(locator, t, step, crossing):
        attempts.clear()
        result = refine(locator, t, step, crossing)
        gaps.append(locator.system.gaps[0, 0])
        moved.append(len(attempts) == 1 and result[0] != attempts[0])
        ends.append(locator.system.new_state.copy())
        # a true step of that size leads to where it is
        try_step(locator.rk, t, result[0])
        ends.append(locator.system.new_state.copy())
        return result

    def counted_trial(rk, t, h):
        attempts.append(h)
        return try_step(rk, t, h)

    monkeypatch.setattr(EventLocator, "refine", counted_refine)
    monkeypatch.setattr(RungeKutta, "try_step", counted_trial)
    event = pc.simulate(scene, state, 1.0, rtol=rtol, atol=1e-2 * rtol).events[0]
    assert event.kind == exact.kind == "touch"
    assert moved[0] and abs(gaps[0]) <= 1e-14
    # the square of the time by which it was moved on; and the shares of others in a step's round-off
    np.testing.assert_allclose(ends[0], ends[1], rtol=0.0, atol=1e-5 * rtol)
    assert event.time == pytest.approx(exact.time, abs=rtol)
    np.testing.assert_allclose(event.q, exact.q, rtol=0.0, atol=10.0 * rtol)


def test_no_refinement_goes_over_what_was_looked_at_next(monkeypatch):
    """Between the later samples of the step others may end modes: secants, which round-off may lead anywhere, stop at
    the sample behind the crossing."""
    refine, later = EventLocator.refine, []

    def bounded_refine(locator, t, step, crossing):
        end = crossing.theta * step
        later.append(refine(locator, t, step, crossing)[0] > end)
        assert refine(locator, t, step, crossing._replace(until=crossing.theta))[0] <= end
        return refine(locator, t, step, crossing)

    monkeypatch.setattr(EventLocator, "refine", bounded_refine)
    for rtol in (1e-3, 1e-4, 1e-5, 1e-6):
        scene, state = tumbling(restitution=0.5)
        assert pc.simulate(scene, state, 1.2, rtol=rtol, atol=1e-2 * rtol).status == 0
    assert any(later) and not all(later)


@pytest.mark.parametrize("method", ["RK45", "DOP853", "Sharp98"])
def test_dense_output_that_is_as_good_as_a_step(monkeypatch, method):
    """Where the error of the whole step is small its dense output is what is stepped to, and as near to the true step
    as steps are to be to the motion."""
    scene, state = tumbling(restitution=0.5)
    refine, try_step = EventLocator.refine, RungeKutta.try_step
    seen, attempts = [], []

    def compared_refine(locator, t, step, crossing):
        attempts.clear()
        rk, system, error = locator.rk, locator.system, locator.rk.error
        result = refine(locator, t, step, crossing)
        none, reached = not attempts, system.new_state.copy()
        # what follows takes it for the step that led there
        assert attempts or system.scalars["step"] == result[0]
        try_step(rk, t, result[0])
        counted = system.absolute > 0.0
        allowed = system.absolute + system.scale[0] * np.maximum(np.abs(system.state), np.abs(reached))
        off = ((system.new_state - reached) / np.where(counted, allowed, 1.0))[counted]
        seen.append((none, error, math.sqrt(float(off @ off) / off.size)))
        try_step(rk, t, result[0])
        return result

    def counted_trial(rk, t, h):
        attempts.append(h)
        return try_step(rk, t, h)

    monkeypatch.setattr(EventLocator, "refine", compared_refine)
    monkeypatch.setattr(RungeKutta, "try_step", counted_trial)
    for rtol in (1e-6, 1e-9):
        for longest in (0.001, 0.01, 0.03, 0.1, math.inf):
            run = pc.simulate(scene, state, 1.2, rtol=rtol, atol=1e-2 * rtol, method=method, max_step=longest)
            assert run.status == 0, run.message
    assert {none for none, _, _ in seen} == {True, False}
    assert all(none == (error <= 1e-3) for none, error, _ in seen)
    assert all(off < 1.0 for none, _, off in seen if none)


@pytest.mark.parametrize("seed", range(3))
def test_what_samples_show(seed):
    """Sign changes and valleys among samples, with all that is none, against array functions."""
    rng = np.random.default_rng(seed)
    items, nc, kinds = 40, 30, EVENTS_PER_CONTACT
    for n in (2, 3, 9):
        values = rng.choice([-2.0, -1.0, 0.0, 0.1, 0.5, 1.0, 3.0, math.inf, NOTHING_THERE], (n, items, kinds))
        values += np.where(rng.random(values.shape) < 0.5, 0.0, rng.normal(size=values.shape) * 0.01)
        apart = rng.random(nc) < 0.5
        before, after = values[:-1], values[1:]
        crosses = (after < 0.0) & (before >= 0.0)
        crosses[:1] |= after[:1] < 0.0
        crosses &= before != NOTHING_THERE
        speed = before[..., SPEED_EVENT], after[..., SPEED_EVENT]
        crosses[..., SPEED_EVENT] &= (speed[0] >= 0.0) | (speed[1] < speed[0])
        for kind in (GAP_EVENT, DOMAIN_EVENT):
            crosses[:1, :nc, kind] &= (before[:1, :nc, kind] >= 0.0) | apart
        found = np.zeros((values.size, 3), dtype=np.int64)
        assert found[: find_crossings(values, apart, found)].tolist() == np.argwhere(crosses).tolist()
        left, middle, right = values[:-2], values[1:-1], values[2:]
        higher = np.maximum(left, right)
        valleys = (middle >= 0.0) & (middle <= left) & (middle <= right) & (middle < higher)
        valleys &= 1.5 * middle < 0.5 * higher
        for i, end in ((0, left), (-1, right)) if n > 2 else ():
            valleys[i] |= (end[i] >= 0.0) & (end[i] < middle[i]) & (1.5 * end[i] < 0.5 * higher[i])
        assert found[: find_minima(values, found)].tolist() == np.argwhere(valleys).tolist()
        assert n < 9 or (valleys.any() and crosses[:, :, [GAP_EVENT, SPEED_EVENT]].any())


@pytest.mark.parametrize("seed", range(3))
def test_rate_in_tolerances(seed):
    """Of what has a tolerance; the largest of three is either of them."""
    rng = np.random.default_rng(seed)
    for _ in range(20):
        state, slope, absolute = rng.normal(size=(3, 3))
        absolute = np.where(absolute > 0.8, 0.0, np.abs(absolute))
        rates = np.abs(slope) / (absolute + 0.3 * np.abs(state))
        largest = rates[absolute > 0.0].max(initial=0.0)
        # three operations on numbers of that size
        assert fastest(state, slope, absolute, 0.3) == pytest.approx(largest, rel=1e-15)
