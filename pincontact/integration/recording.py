"""Outputs of a run: rows that the compiled steps write."""

from __future__ import annotations

import math

from ..dynamics.equations import guard_force
from ..dynamics.resistance import count_items
from ..jit import kernel
from ..layout import (
    BASIS,
    CHART,
    CONTACT_INT,
    CONTACT_INTS,
    CONTACT_REAL,
    CONTACT_REALS,
    COUNTERS,
    COUNTERS_SIZE,
    FORCE,
    FREE,
    FROZEN_COLUMNS,
    GUARD_COUNT,
    GUARD_INT,
    GUARD_INTS,
    GUARD_REAL,
    GUARD_REALS,
    GUARD_V,
    HAS_REFERENCE,
    LOCATION,
    MODE,
    NC,
    NEXT_OUTPUT,
    NQ,
    NV,
    NWORK,
    NY,
    OUTPUT_COUNT,
    OUTPUT_TIMES,
    OUTPUTS_DONE,
    OWNER,
    RECORDED,
    RECORDED_INTEGERS,
    RECORDED_REALS,
    REFERENCE,
    ROW_WIDTH,
    ROWS,
    SCALARS,
    SCALARS_SIZE,
    SIDE_INT,
    SIDE_INTS,
    SIZES,
    STAGE_STATE,
    START,
    TANGENTS,
    TAU,
    Q,
    V,
)
from ..memory import cube, integer_matrix, integers, matrix, reals

# Integers of a contact in a row: its own, and its two charts.
INTEGERS_PER_CONTACT = CONTACT_INTS + 2
# Rows that the compiled steps may write before they have to come back.
BLOCK = 256


@kernel
def record_row(table, t):
    """Write the state in (Q, V, LOCATION) at t as the next row: t, q, v, tau, works, location, frozen directions,
    redundant forces where they were chosen, torques on body 2 that resist turning where there may be any.
    """
    sizes, counters = integers(table[SIZES], 8), integers(table[COUNTERS], COUNTERS_SIZE)
    nq, nv, nc, nwork = sizes[NQ], sizes[NV], sizes[NC], sizes[NWORK]
    index = counters[RECORDED]
    row = matrix(table[RECORDED_REALS], BLOCK, counters[ROW_WIDTH])[index]
    whole = integer_matrix(table[RECORDED_INTEGERS], BLOCK, max(nc, 1) * INTEGERS_PER_CONTACT)[index]
    q, v, tau, location = (
        reals(table[Q], nq),
        reals(table[V], nv),
        reals(table[TAU], nv),
        reals(table[LOCATION], 4 * nc),
    )
    state = reals(table[STAGE_STATE], sizes[NY])
    contact_int = integer_matrix(table[CONTACT_INT], nc, CONTACT_INTS)
    contact_real = matrix(table[CONTACT_REAL], nc, CONTACT_REALS)
    side_int = integer_matrix(table[SIDE_INT], 2 * nc, SIDE_INTS)
    row[0] = t
    at = 1
    for k in range(nq):
        row[at + k] = q[k]
    at += nq
    for k in range(nv):
        row[at + k] = v[k]
        row[at + nv + k] = tau[k]
    at += nv
    # the forces of limits, dry friction and resistances go with the torques, so that contact forces can be found again
    ng, n = integers(table[GUARD_COUNT], 1)[0], count_items(table)
    modes = integer_matrix(table[CONTACT_INT], n, CONTACT_INTS)
    guards, guard_real = integer_matrix(table[GUARD_INT], ng, GUARD_INTS), matrix(table[GUARD_REAL], ng, GUARD_REALS)
    force, reference = matrix(table[FORCE], n, 3), matrix(table[REFERENCE], n, 3)
    basis, rows = cube(table[BASIS], n, 3, 3), cube(table[ROWS], n, 3, nv)
    for g in range(ng):
        mode = modes[nc + g, MODE]
        held = force[nc + g, 2] if mode != FREE else 0.0
        row[at + guards[g, GUARD_V]] += held + guard_force(mode, guards[g], guard_real[g])
    for i in range(nc + ng, n):
        if modes[i, MODE] != FREE:
            for j in range(modes[i, TANGENTS]):
                for k in range(nv):
                    row[at + k] += rows[i, j, k] * force[i, j]
    at += nv
    for k in range(nwork):
        row[at + k] = state[sizes[NY] - nwork + k]
    at += nwork
    for k in range(4 * nc):
        row[at + k] = location[k]
    at += 4 * nc
    for c in range(nc):
        for k in range(FROZEN_COLUMNS):
            row[at + k] = contact_real[c, START + k]
        at += FROZEN_COLUMNS
        for k in range(CONTACT_INTS):
            whole[c * INTEGERS_PER_CONTACT + k] = contact_int[c, k]
        for k in range(2):
            whole[c * INTEGERS_PER_CONTACT + CONTACT_INTS + k] = side_int[2 * c + k, CHART]
    chosen = reals(table[SCALARS], SCALARS_SIZE)[HAS_REFERENCE]
    for c in range(nc):
        for k in range(3):
            row[at + k] = chosen * reference[c, k]
        at += 3
    if n > nc + ng:
        for k in range(3 * nc):
            row[at + k] = 0.0
    for i in range(nc + ng, n):
        if modes[i, MODE] != FREE:
            for j in range(modes[i, TANGENTS]):
                for k in range(3):
                    row[at + 3 * modes[i, OWNER] + k] += force[i, j] * basis[i, j, k]
    counters[RECORDED] = index + 1


@kernel
def output_done(table):
    """Go on to the next output time."""
    counters = integers(table[COUNTERS], COUNTERS_SIZE)
    counters[OUTPUTS_DONE] += 1
    announce_output(table)


@kernel
def announce_output(table):
    """NEXT_OUTPUT from the list of output times."""
    counters = integers(table[COUNTERS], COUNTERS_SIZE)
    done, count = counters[OUTPUTS_DONE], counters[OUTPUT_COUNT]
    times = reals(table[OUTPUT_TIMES], count)
    reals(table[SCALARS], SCALARS_SIZE)[NEXT_OUTPUT] = times[done] if done < count else math.inf
