"""Arrays and records that kernels and Python see under the same names."""

from __future__ import annotations

import numpy as np
import pytest

from pincontact.jit import CHECKED, INTEGER, REAL, entry_kernel, kernel
from pincontact.workspace import INTEGERS, REALS, Layout, Scratch, Workspace, flat, record, square

LAYOUT = Layout(
    "a test's",
    state=(record(REALS, "time", "step"),),
    mass=(REALS, "rows", "rows"),
    order=(Scratch(INTEGERS), "rows"),
    cube=(REALS, "depth", "rows", "rows"),
    parts=(np.dtype([("kind", INTEGERS), ("weight", REALS)]), "parts"),
)
workspace_at = LAYOUT.at


@kernel
def advance(workspace, share):
    """Time goes on by a share of a step; all that can be read and written is."""
    workspace.state.time += share * workspace.state.step
    mass, order = workspace.mass, workspace.order
    for i in range(mass.shape[0]):
        for j in range(mass.shape[1]):
            mass[i, j] += 10.0 * order[i] + workspace.cube[1, i, j]
    return mass.shape[0] * 100 + mass.shape[1] * 10 + order.shape[0]


@entry_kernel(INTEGER, REAL)
def advance_at(address, share):
    return advance(workspace_at(address), share)


@entry_kernel(INTEGER)
def last_at(address):
    workspace = workspace_at(address)
    order = workspace.order
    whole, corner = flat(workspace.cube), square(flat(workspace.cube), order[0])
    return whole[whole.shape[0] - 1] + 1000.0 * corner[1, 0] + 1e6 * corner.shape[1]


@kernel
def grow(part):
    part.weight *= 2.0 if part.kind == 1 else 1.0


@entry_kernel(INTEGER)
def grow_at(address):
    parts = workspace_at(address).parts
    for i in range(len(parts)):
        grow(parts[i])
        parts[i].kind += 10
    return parts[0].weight


def filled(n):
    workspace = Workspace(LAYOUT)
    workspace.zeros("state")
    workspace.state["time"], workspace.state["step"] = 2.0, 0.5
    workspace.zeros("mass", n, 3)
    workspace.put("order", np.arange(n) + 2)
    workspace.zeros("cube", 2, n, 3)[:] = np.arange(6.0 * n).reshape(2, n, 3)
    return workspace


@pytest.mark.parametrize("n", [0, 1, 4, 700])
def test_a_kernel_reads_and_writes_arrays_of_any_size(n):
    """700 rows do not fit into the piece of memory that the others are cut from."""
    workspace = filled(n)
    assert advance_at(workspace.address, 0.5) == 100 * n + 30 + n
    assert workspace.state["time"] == 2.25
    expected = 10.0 * (np.arange(n) + 2)[:, None] + np.arange(3.0 * n, 6.0 * n).reshape(n, 3)
    np.testing.assert_array_equal(workspace.mass, expected)


def test_an_array_that_is_put_in_its_place_is_read_from_then_on():
    workspace = filled(2)
    other = workspace.put("mass", np.zeros((5, 2)))
    workspace.put("order", np.zeros(5, dtype=np.int64))
    workspace.zeros("cube", 2, 5, 2)
    assert advance_at(workspace.address, 1.0) == 525
    assert workspace.mass is other and not other.any()


def test_arrays_are_allocated_as_far_as_their_sizes_are_known():
    workspace = Workspace(LAYOUT)
    workspace.allocate(rows=3)
    mass = workspace.mass
    assert mass.shape == (3, 3) and not mass.any() and workspace.state["time"] == 0.0
    assert (workspace.order < -1e9).all() == CHECKED
    assert not {"cube", "parts"} & vars(workspace).keys()
    workspace.allocate(rows=7, depth=2)
    assert workspace.mass is mass and workspace.cube.shape == (2, 7, 7)


def test_records_of_an_array_are_read_and_written_in_place():
    workspace = Workspace(LAYOUT)
    parts = workspace.zeros("parts", 3)
    parts["kind"], parts["weight"] = [1, 2, 1], [0.5, 3.0, 4.0]
    assert grow_at(workspace.address) == 1.0
    assert workspace.parts.tolist() == [(11, 1.0), (12, 3.0), (11, 8.0)]


def test_what_nobody_has_written_is_marked_in_records_too():
    parts = Workspace(LAYOUT).scratch("parts", 2)
    assert (np.isnan(parts["weight"]).all() and (parts["kind"] < -1e9).all()) == CHECKED


def test_other_shapes_of_the_same_numbers():
    workspace = filled(4)
    # the last of 24 numbers, and the first of the second row of [[0, 1], [2, 3]]
    assert last_at(workspace.address) == 23.0 + 2000.0 + 2e6


def test_what_was_kept_is_restored_to_the_bit():
    workspace = filled(3)
    workspace.mass[:] = np.random.default_rng(0).normal(size=(3, 3))
    kept, order = workspace.mass.copy(), workspace.order
    workspace.keep()
    advance_at(workspace.address, 1.0)
    workspace.put("order", np.zeros(7, dtype=np.int64))
    workspace.restore()
    np.testing.assert_array_equal(workspace.mass, kept)
    assert workspace.order is order and workspace.state["time"] == 2.0
    assert advance_at(workspace.address, 1.0) == 333
