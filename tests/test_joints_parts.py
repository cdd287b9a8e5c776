"""Guarded joint coordinates as models state them, and what is wrong with a mechanism, by name."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc
from pincontact.dynamics.energy import energies_at
from pincontact.dynamics.joints import (
    END_SLACK,
    JointLimit,
    JointLock,
    check_joint_limits,
    interrupted_joint,
    joint_limits,
    joint_locks,
    joint_of,
    without_inertia,
)


def mechanism():
    """A slider, a free body on it, a turning joint on that, and a plane joint beside it."""
    model, joint = pin.Model(), 0
    for name, kind in (
        ("slide", pin.JointModelPX()), ("flyer", pin.JointModelFreeFlyer()), ("hinge", pin.JointModelRZ()),
        ("lift", pin.JointModelPZ()), ("wheel", pin.JointModelRUBX()),
    ):  # fmt: skip
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    return model


def test_joint_limits_of_a_model():
    """Limits of coordinates that are numbers, dry friction of all; nothing where there is neither."""
    model = mechanism()
    assert (model.nq, model.nv) == (12, 10)
    assert joint_limits(model) == []
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -0.5, 0.5
    unbounded = np.finfo(float).max
    model.lowerPositionLimit[9], model.upperPositionLimit[8] = -unbounded, unbounded
    model.upperDryFrictionLimit[[3, 8]], model.lowerDryFrictionLimit[[8, 9]] = [0.2, 0.3], [-0.4, -0.6]
    inf = math.inf
    assert joint_limits(model) == [
        JointLimit("slide", 0, 0, 0.0, 0.0, -0.5, 0.5),
        JointLimit("flyer", 3, 3, 0.0, 0.2, -inf, inf),
        JointLimit("hinge", 8, 7, 0.0, 0.0, -0.5, inf),
        JointLimit("lift", 9, 8, -0.4, 0.3, -inf, 0.5),
        JointLimit("wheel", 10, 9, -0.6, 0.0, -inf, inf),
    ]
    assert [limit.dry for limit in joint_limits(model)] == [False, True, False, True, True]
    # one value is no range
    model.lowerPositionLimit[0] = model.upperPositionLimit[0] = 0.25
    assert [limit.joint for limit in joint_limits(model)] == ["flyer", "hinge", "lift", "wheel"]
    assert joint_locks(model) == [JointLock("slide", 0, 0, 0.25)]
    # nor are those of what is no vector limits, nor are bounds beyond all numbers
    model.lowerPositionLimit[3], model.lowerPositionLimit[9], model.upperPositionLimit[9] = 0.5, math.inf, math.inf
    assert [lock.joint for lock in joint_locks(model)] == ["slide"]
    model.lowerPositionLimit[9], model.upperPositionLimit[9] = -unbounded, 0.5
    model.upperPositionLimit[0] = 0.2
    with pytest.raises(pc.ModelError, match="slide"):
        joint_limits(model)
    model.upperPositionLimit[0] = 0.5
    for low, high in ((0.1, 0.2), (-0.2, -0.1)):
        model.lowerDryFrictionLimit[8], model.upperDryFrictionLimit[8] = low, high
        with pytest.raises(pc.ModelError, match="lift"):
            joint_limits(model)


def test_friction_of_one_direction_is_told():
    """As `model.friction` sets it, which is the upper limit alone."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    model.upperDryFrictionLimit[:] = 0.5
    with pytest.warns(UserWarning, match=r"hinge.*0 to 0\.5.*lowerDryFrictionLimit"):
        joint_limits(model)
    model.lowerDryFrictionLimit[:] = -0.5
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        joint_limits(model)


def test_states_beyond_limits_are_named():
    limits = [JointLimit("a", 1, 1, 0.0, 0.0, -0.5, 0.5), JointLimit("b", 2, 2, 0.0, 0.0, -math.inf, math.inf)]
    for value in (-0.5 - 0.9 * END_SLACK, 0.0, 0.5 + 0.9 * END_SLACK):
        check_joint_limits(limits, np.array([9.0, value, 9.0]))
    for value in (-0.5 - 1.1 * END_SLACK, 0.5 + 1.1 * END_SLACK):
        with pytest.raises(pc.StateError, match=r"'a': q\[1\]"):
            check_joint_limits(limits, np.array([9.0, value, 9.0]))


def test_joints_of_velocity_coordinates():
    model = mechanism()
    names = ["slide", *["flyer"] * 6, "hinge", "lift", "wheel"]
    assert [joint_of(model, index) for index in range(10)] == names
    with pytest.raises(pc.ModelError, match="10"):
        joint_of(model, 10)


@pytest.mark.parametrize("empty", ["slide", "lift"])
def test_what_moves_nothing_that_has_inertia(empty):
    """The joint with the largest part in the motion that takes least, of bodies that are heavier beyond it."""
    model = pin.Model()
    for i, name in enumerate(("slide", "turn", "lift")):
        kind = (pin.JointModelPX(), pin.JointModelRY(), pin.JointModelPZ())[i]
        joint = model.addJoint(0, kind, pin.SE3.Identity(), name)
        mass = 1e-12 if name == empty else 1.0 + i
        inertia = pin.Inertia(mass, np.array([0.1, 0.0, 0.0]), (mass + 0.5) * np.eye(3))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    message = without_inertia(model, model.createData(), np.zeros(3))
    assert f"joint {empty!r}" in message
    assert "1e-12" in message


def test_the_order_of_joints():
    """Pinocchio takes those that follow a joint for those on it, as many as there are."""
    model = pin.Model()
    first = model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "first")
    model.addJoint(first, pin.JointModelRX(), pin.SE3.Identity(), "second")
    assert interrupted_joint(model) is None
    model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "between")
    assert interrupted_joint(model) is None
    model.addJoint(first, pin.JointModelRX(), pin.SE3.Identity(), "third")
    assert interrupted_joint(model) == ("third", "first", "between")


def test_energies():
    """Kinetic: with the rotors', by the symmetric mass matrix. Potential: of what is above the world's origin."""
    model = mechanism()
    model.armature[:] = np.linspace(0.1, 1.0, model.nv)
    rng = np.random.default_rng(0)
    q, v = pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv)), rng.normal(size=model.nv)
    data = model.createData()
    mass = np.triu(pin.crba(model, data, q))
    mass = mass + np.triu(mass, 1).T
    pin.forwardKinematics(model, data, q)
    height = sum(data.oMi[j].translation[2] for j in range(1, model.njoints))
    for given in (None, model.createData()):
        found = energies_at(model, q, v, given)
        assert found == pytest.approx((0.5 * v @ mass @ v, 9.81 * height), rel=1e-12)
