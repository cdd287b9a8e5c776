"""Parameters of the friction laws."""

import dataclasses
import math

import numpy as np
import pinocchio as pin
import pytest
import random_scenes
from shared import kinds_of, one_body
from test_unprojected import SLIDING

import pincontact as pc
from pincontact.errors import FrictionError
from pincontact.friction.laws import Coulomb, FrictionLaw, NoSlip, Stribeck


def test_every_law_is_listed_in_the_tables_of_the_tests():
    for table, laws in (("SLIDING", SLIDING.values()), ("LAWS of random_scenes.py", random_scenes.LAWS)):
        missing = kinds_of(FrictionLaw) - {"NoSlip"} - {type(law).__name__ for law in laws}
        assert not missing, f"{table} lacks {missing}"


def test_coulomb_without_a_static_coefficient_sticks_up_to_mu():
    law = Coulomb(0.4)
    assert law.sliding == 0.4
    assert law.sticking == 0.4
    assert law.mu_static is None


def test_coulomb_with_a_static_coefficient():
    law = Coulomb(mu=0.4, mu_static=0.6)
    assert law.sliding == 0.4
    assert law.sticking == 0.6
    assert Coulomb(0.4, 0.4).sticking == 0.4


def test_no_slip_has_no_bound():
    assert NoSlip().sliding == math.inf
    assert NoSlip().sticking == math.inf


@pytest.mark.parametrize("mu", [-0.1, math.nan, math.inf, "rough", None])
def test_bad_mu_is_refused_by_value(mu):
    with pytest.raises(FrictionError, match=r"mu must be .*" + str(mu)):
        Coulomb(mu)


@pytest.mark.parametrize("mu_static", [-0.1, math.nan, math.inf])
def test_bad_mu_static_is_refused(mu_static):
    with pytest.raises(FrictionError, match="mu_static"):
        Coulomb(0.0, mu_static)


def test_mu_static_below_mu_is_refused():
    with pytest.raises(FrictionError, match=r"0\.3 < 0\.4"):
        Coulomb(0.4, 0.3)


def test_laws_are_values():
    assert Coulomb(1) == Coulomb(1.0)
    assert NoSlip() == NoSlip()
    assert len({Coulomb(0.2), Coulomb(0.2), NoSlip(), NoSlip()}) == 2
    with pytest.raises(dataclasses.FrozenInstanceError):
        Coulomb(0.2).mu = 0.3


def test_the_base_class_is_abstract():
    with pytest.raises(TypeError):
        FrictionLaw()


def test_two_directions():
    law = Coulomb((0.2, 0.5), (0.4, 1.0), along="blade")
    assert (law.sliding, law.sticking, law.aspect) == (0.2, 0.4, 2.5)
    assert Coulomb([0.2, 0.5]) == Coulomb((0.2, 0.5))
    assert Coulomb(0.2).aspect == 1.0


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"mu": (0.2, 0.0)}, r"mu of two directions must be positive, got \(0\.2, 0\.0\)"),
        ({"mu": (0.2, 0.1, 0.1)}, r"number or a pair .*got \(0\.2, 0\.1, 0\.1\)"),
        ({"mu": (0.2, -0.1)}, r"not negative, got -0\.1"),
        ({"mu": (0.2, 0.4), "mu_static": 0.5}, "both be numbers or both be pairs"),
        ({"mu": (0.2, 0.4), "mu_static": (0.3, 0.5)}, "in the proportion of mu"),
        ({"mu": (0.2, 0.4), "mu_static": (0.1, 0.2)}, "must not be below mu"),
        ({"mu": 0.2, "along": "blade"}, r"along='blade' needs mu=\(along, across\)"),
        ({"mu": (0.2, 0.4), "along": 3}, "name of a contour, got 3"),
        ({"mu": 0.2, "viscous": -1.0}, r"viscous must be .*-1\.0"),
        ({"mu": 0.2, "spinning": math.inf}, "spinning must be .*inf"),
        ({"mu": 0.2, "rolling": "much"}, "rolling must be a number, got 'much'"),
    ],
)
def test_bad_parameters_are_named(options, match):
    with pytest.raises(FrictionError, match=match):
        Coulomb(**options)


def test_stribeck_falls_from_static_to_sliding():
    law = Stribeck(0.1, 0.3, 0.02, 1.5)
    assert (law.sliding, law.sticking, law.onset) == (0.1, 0.3, 0.3)
    speeds = [0.0, 0.01, 0.02, 1e6]
    expected = [0.3, 0.1 + 0.2 * math.exp(-(0.5**1.5)), 0.1 + 0.2 * math.exp(-1.0), 0.1]
    assert law.coefficient(speeds) == pytest.approx(expected, rel=1e-15)
    assert Coulomb(0.4, 0.5).coefficient(speeds).tolist() == [0.4] * 4


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ((0.3, 0.2, 0.1), "mu_static must not be below mu"),
        ((0.1, None, 0.1), "mu_static must be a number"),
        ((0.1, 0.2, 0.0), "speed must be positive"),
        ((0.1, 0.2, -1.0), r"speed must be .*-1\.0"),
        ((0.1, 0.2, 0.1, 0.5), r"exponent must lie in \[1\.0, 50\.0\], got 0\.5"),
    ],
)
def test_bad_curves_are_refused(arguments, match):
    with pytest.raises(FrictionError, match=match):
        Stribeck(*arguments)


class Own(FrictionLaw):
    """A user's law with constant coefficients."""

    sliding, sticking = 0.2, 0.3


class OwnCurve(Own):
    def coefficient(self, speed):
        return 0.2 + 0.1 / (1.0 + np.asarray(speed))


class OwnStribeck(Stribeck):
    def coefficient(self, speed):
        return 2.0 * super().coefficient(speed)


class OwnOnset(Own):
    onset = 0.3


def sliding_point(law):
    scene = pc.Scene(one_body(pin.JointModelTranslation(), pin.Inertia(1.0, np.zeros(3), np.eye(3)), "block"))
    point, floor = scene.add_contour("point", pc.Point(), "block"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("foot", point, floor, friction=law)
    return scene


def test_constant_laws_of_users_are_evaluated():
    scene = sliding_point(Own())
    state = scene.initial_state(np.zeros(3), [1.0, 0.0, 0.0])
    force = pc.analyze(scene, state)["foot"].force
    # of 1 kg; a few ulp
    assert np.linalg.norm(force[:2]) == pytest.approx(0.2 * 9.81, rel=1e-13)


class Renamed(Stribeck):
    """The package's curve by another name."""


def test_laws_that_only_derive_from_a_curve_have_it():
    speed, law = 0.03, Renamed(0.1, 0.3, 0.02, 1.5)
    scene = sliding_point(law)
    force = pc.analyze(scene, scene.initial_state(np.zeros(3), [speed, 0.0, 0.0]))["foot"].force
    # of 1 kg; a few ulp
    expected = 9.81 * (0.1 + 0.2 * math.exp(-((speed / 0.02) ** 1.5)))
    assert np.linalg.norm(force[:2]) == pytest.approx(expected, rel=1e-13)


@pytest.mark.parametrize(
    "law", [OwnCurve(), OwnStribeck(0.1, 0.3, 0.02), OwnOnset()], ids=["curve", "Stribeck", "onset"]
)
def test_laws_without_a_kernel_are_refused(law):
    # they used to slide with the coefficient at the onset of slip, whatever their speed
    with pytest.raises(FrictionError, match=f"'foot': no kernel computes the coefficient of {type(law).__name__}"):
        sliding_point(law).initial_state(np.zeros(3), [1.0, 0.0, 0.0])


class Rising(Stribeck):
    """None as slip starts."""

    @property
    def onset(self):
        return 0.0


def test_a_law_without_friction_as_slip_starts_is_refused():
    with pytest.raises(FrictionError, match=r"'foot': .* has no friction as slip starts"):
        sliding_point(Rising(0.3, 0.3, 0.02)).initial_state(np.zeros(3), [1.0, 0.0, 0.0])
