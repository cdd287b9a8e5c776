"""Parameters of the friction laws."""

import dataclasses
import math

import pytest

from pincontact.errors import FrictionError
from pincontact.friction.laws import Coulomb, FrictionLaw, NoSlip


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
