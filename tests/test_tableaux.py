"""Interpolants of the explicit pairs, on one step of a scalar equation that is neither linear nor autonomous."""

import math

import numpy as np
import pytest
from made_tableaux import free_dense, rooted_trees, sharp98_estimate

from pincontact.integration.tableaux import tableau

THETAS = np.array([0.1, 0.35, 0.6, 0.85])


def slope(t, y):
    return math.cos(t + y) + 0.3 * y


def solution(times):
    from scipy.integrate import solve_ivp

    return solve_ivp(lambda t, y: [slope(t, y[0])], (0.0, 1.0), [0.2], "DOP853", times, rtol=1e-13, atol=1e-15).y[0]


def errors(pair, h):
    """Largest errors of the interpolant within one step, and its value at the end against the new state."""
    n = pair.stages + 1 + pair.extra
    k, new = np.zeros(n), 0.0
    for i in range(n):
        state = 0.2 + h * (pair.a[i, :i] @ k[:i])
        if i == pair.stages:
            new = state
        k[i] = slope(pair.c[i] * h, state)
    rows = h * pair.dense[:, :n] @ k + pair.dense[:, -1] * (new - 0.2)

    def value(theta):
        out = 0.0
        for i in reversed(range(len(rows))):
            out = (out + rows[i]) * (1.0 - theta if pair.nested and i % 2 else theta)
        return 0.2 + out

    expected = solution(h * THETAS)
    return max(abs(value(theta) - y) for theta, y in zip(THETAS, expected, strict=True)), abs(value(1.0) - new)


def test_trees():
    """Their numbers are those of Table 2.1 in Hairer, Norsett, Wanner, Sec. II.2."""
    assert [len(rooted_trees(order)) for order in range(1, 9)] == [1, 1, 2, 4, 9, 20, 48, 115]


def density(tree):
    """Of a rooted tree: the product of its subtrees' numbers of vertices."""
    return vertices(tree) * math.prod(density(part) for part in tree)


def vertices(tree):
    return 1 + sum(vertices(part) for part in tree)


def elementary_weights(tree, a):
    return math.prod((a @ elementary_weights(part, a) for part in tree), start=np.ones(len(a)))


def defects(pair, b, order, expected):
    """How far the sums over all trees of this order, which are 1 for a solution of the order, are off."""
    return max(abs(density(tree) * (b @ elementary_weights(tree, pair.a)) - expected) for tree in rooted_trees(order))


@pytest.mark.parametrize(("name", "order"), [("RK23", 3), ("RK45", 5), ("DOP853", 8), ("Sharp98", 9)])
def test_order_conditions(name, order):
    pair = tableau(name)
    end = pair.stages
    np.testing.assert_allclose(pair.a[: end + 1].sum(axis=1), pair.c[: end + 1], rtol=0.0, atol=1e-14)
    # weights of up to 25, of either sign, in doubles
    assert max(defects(pair, pair.a[end], vertices, 1.0) for vertices in range(1, order + 1)) < 1e-13
    if order < 9:
        assert defects(pair, pair.a[end], order + 1, 1.0) > 1e-3


@pytest.mark.parametrize("name", ["RK23", "RK45", "DOP853"])
def test_pairs_are_those_of_scipy(name):
    from scipy import integrate

    pair, theirs = tableau(name), getattr(integrate, name)
    n = theirs.n_stages
    assert (pair.stages, pair.order, pair.error_order) == (n, theirs.order, theirs.error_estimator_order)
    assert (pair.a[:n, : theirs.A.shape[1]] == theirs.A).all() and (pair.a[n, :n] == theirs.B).all()
    assert (pair.c[:n] == theirs.C).all() and pair.c[n] == 1.0
    if name == "DOP853":
        assert (pair.a[n + 1 :] == theirs.A_EXTRA).all() and (pair.c[n + 1 :] == theirs.C_EXTRA).all()
        assert (pair.errors[:, : n + 1] == [theirs.E5, theirs.E3]).all()
        # Hairer's form: the difference, the slopes at both ends, and four combinations of all stages
        ends = np.zeros((3, n + 5))
        ends[0, -1], ends[1, -1], ends[2, -1] = 1.0, -1.0, 2.0
        ends[1, 0], ends[2, 0], ends[2, n] = 1.0, -1.0, -1.0
        assert (pair.dense[:3] == ends).all() and (pair.dense[3:, :-1] == theirs.D).all()
    else:
        assert (pair.errors[0] == theirs.E).all() and (pair.dense[:, :-1] == theirs.P.T).all()


@pytest.mark.parametrize(("name", "further"), [("DOP853", 1), ("Sharp98", 2)])
def test_free_interpolants_are_made_so(name, further):
    pair = tableau(name)
    given = pair.free_dense if name == "DOP853" else pair.dense
    n = pair.stages + 1
    # equations with singular values down to 1e-10 of the largest, solved by whatever LAPACK there is
    made = free_dense(pair.a[:n, :n], 6, further)
    np.testing.assert_allclose(given, made, rtol=0.0, atol=1e-10 * np.abs(made).max())


def test_estimate_of_sharp98():
    """A difference of two solutions of orders 9 and 6, from slopes known before the step's end is evaluated; a jump of
    the slope at any place in the step shows in it."""
    pair = tableau("Sharp98")
    np.testing.assert_allclose(pair.errors[0], sharp98_estimate(pair.c), rtol=1e-13)
    estimate = pair.errors[0] / np.abs(pair.errors[0]).max()
    assert max(defects(pair, estimate, vertices, 0.0) for vertices in range(1, 7)) < 1e-13
    assert defects(pair, estimate, 7, 0.0) > 1e-3
    assert not pair.errors[1].any() and not estimate[pair.estimate_after + 1 :].any()
    jumps = [estimate[: pair.stages][pair.c[: pair.stages] > place].sum() for place in np.linspace(0.001, 0.999, 500)]
    # the largest weight is 1; true errors of such steps are up to 0.1 of the jump
    assert np.abs(jumps).min() > 0.05


@pytest.mark.parametrize(
    ("name", "free", "order"),
    [("RK23", False, 3), ("RK45", False, 4), ("DOP853", False, 7), ("DOP853", True, 6), ("Sharp98", False, 6)],
)
def test_order_of_interpolants(name, free, order):
    pair = tableau(name).without_extra_stages if free else tableau(name)
    sizes = (0.2, 0.1)
    found = [errors(pair, h) for h in sizes]
    # the error of one step is of the order plus one; two steps of finite size show it to a few tenths
    assert math.log2(found[0][0] / found[1][0]) > order + 0.6
    # the free ones' weights are the solution of equations, with singular values down to 1e-10
    assert max(end for _, end in found) < (1e-11 if free or name == "Sharp98" else 1e-15)


@pytest.mark.parametrize(("name", "limit"), [("RK23", 2.5), ("RK45", 3.3), ("DOP853", 6.38), ("Sharp98", 5.18)])
def test_stability_on_the_negative_axis(name, limit):
    """Steps times decay rate up to which a decaying mode decays, which docs/methods.md divides by the evaluations."""
    pair = tableau(name)

    def growth(z):
        k = np.zeros(pair.stages)
        for i in range(pair.stages):
            k[i] = 1.0 - z * (pair.a[i, :i] @ k[:i])
        return abs(1.0 - z * (pair.a[pair.stages, : pair.stages] @ k))

    assert max(growth(z) for z in np.linspace(0.01, limit, 400)) < 1.0 < growth(limit + 0.02)


def test_free_interpolants_are_as_good_at_long_steps():
    """That of DOP853 is chosen for loose tolerances. Sharp98 has no other: its steps are long at all tolerances."""
    pair = tableau("DOP853")
    extra = errors(pair, 1.0)[0]
    assert errors(pair.without_extra_stages, 1.0)[0] < 2.0 * extra
    assert errors(tableau("Sharp98"), 1.0)[0] < 0.2 * extra
