"""Tapes: a user's formula as a list of instructions, differentiated to second order while it runs.

A tape lives in a pool of floats, so that one compiled kernel evaluates every formula and nothing is compiled
per scene. Each slot of its scratch area holds a value with all first and second derivatives by the tape's
variables (forward mode), in the order value, first derivatives, second derivatives (i <= j).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ..jit import kernel
from .evaluation import contour_kernel
from .periods import wrapped

# Header of a tape: offsets into its pool.
COUNT, VARIABLES, WIDTH, SCRATCH, OUTPUTS = range(5)
RESULTS = 5  # (slot offset or -1, constant) for up to three outputs
ROWS = 11  # derivative row of `base` for each entry of a slot
PERIODS = 21  # (low, high) of u1, then of u2, between which they repeat; equal where they do not
TIMES = 25  # first and last time at which the tape is the function; it has no value at others
INSTRUCTIONS = 27
INSTRUCTION_SIZE = 5  # opcode, offset of a, offset of b, constant c, constant d

# Linear instructions, then SINCOS (two slots), then functions of two arguments, then of one.
LINEAR, AFFINE, SINCOS = range(3)
MULTIPLY, DIVIDE, ATAN2 = range(3, 6)
(
    SQUARE,
    INVERSE,
    POWER_CONSTANT,
    SQRT,
    EXP,
    EXPM1,
    LOG,
    LOG1P,
    TAN,
    ASIN,
    ATAN,
    SINH,
    COSH,
    TANH,
    ASINH,
    ACOSH,
    ATANH,
) = range(6, 23)
# Of a formula before it is a tape: a variable, and sine and cosine, which one instruction computes together.
VARIABLE, SIN, COS = -1, -2, -3


class Node(NamedTuple):
    """An operation of a formula: one of these numbers, the nodes of its arguments (-1: none), its constants and, of a
    variable, the name."""

    op: int
    x: int = -1
    y: int = -1
    c: float = 0.0
    d: float = 0.0
    name: str = ""


@kernel
def chain(pool, a, target, n, f, f_x, f_xx):
    """Slot `target` = f(slot a) for a function of one variable with these derivatives."""
    pool[target] = f
    p = n + 1
    for i in range(1, n + 1):
        x_i = pool[a + i]
        pool[target + i] = f_x * x_i
        for j in range(i, n + 1):
            pool[target + p] = f_x * pool[a + p] + f_xx * x_i * pool[a + j]
            p += 1


@kernel
def chain_two(pool, a, b, target, n, f, f_x, f_y, f_xx, f_xy, f_yy):
    """Slot `target` = f(slot a, slot b) for a function of two variables with these derivatives."""
    pool[target] = f
    p = n + 1
    for i in range(1, n + 1):
        x_i, y_i = pool[a + i], pool[b + i]
        pool[target + i] = f_x * x_i + f_y * y_i
        left = f_xx * x_i + f_xy * y_i
        right = f_xy * x_i + f_yy * y_i
        for j in range(i, n + 1):
            second = f_x * pool[a + p] + f_y * pool[b + p]
            pool[target + p] = second + left * pool[a + j] + right * pool[b + j]
            p += 1


@kernel
def function_of_one(op, x, c):
    """Value, first and second derivative of the function `op` at x; c is its constant."""
    if op == SQUARE:
        return x * x, 2.0 * x, 2.0
    if op == INVERSE:
        f = c / x
        return f, -f / x, 2.0 * f / (x * x)
    if op == POWER_CONSTANT:
        if c >= 2.0:
            # Regular at x = 0, where dividing by x would not be.
            f_xx = x ** (c - 2.0)
            return f_xx * x * x, c * f_xx * x, c * (c - 1.0) * f_xx
        f_x = x ** (c - 1.0)
        return f_x * x if x != 0.0 else x**c, c * f_x, c * (c - 1.0) * f_x / x
    if op == SQRT:
        f = math.sqrt(x)
        f_x = 0.5 / f
        return f, f_x, -0.5 * f_x / x
    if op == EXP:
        f = math.exp(x)
        return f, f, f
    if op == EXPM1:
        f = math.exp(x)
        return math.expm1(x), f, f
    if op == LOG:
        f_x = 1.0 / x
        return math.log(x), f_x, -f_x * f_x
    if op == LOG1P:
        f_x = 1.0 / (1.0 + x)
        return math.log1p(x), f_x, -f_x * f_x
    if op == TAN:
        f = math.tan(x)
        f_x = 1.0 + f * f
        return f, f_x, 2.0 * f * f_x
    if op == ASIN:
        f_x = 1.0 / math.sqrt((1.0 - x) * (1.0 + x))
        return math.asin(x), f_x, x * f_x * f_x * f_x
    if op == ATAN:
        f_x = 1.0 / (1.0 + x * x)
        return math.atan(x), f_x, -2.0 * x * f_x * f_x
    if op == SINH:
        f = math.sinh(x)
        return f, math.cosh(x), f
    if op == COSH:
        f = math.cosh(x)
        return f, math.sinh(x), f
    if op == TANH:
        f = math.tanh(x)
        # 1 - f^2 loses all digits for large x; 1 / cosh^2 does not.
        f_x = 1.0 / math.cosh(x)
        f_x *= f_x
        return f, f_x, -2.0 * f * f_x
    if op == ASINH:
        f_x = 1.0 / math.sqrt(1.0 + x * x)
        return math.asinh(x), f_x, -x * f_x * f_x * f_x
    if op == ACOSH:
        f_x = 1.0 / math.sqrt((x - 1.0) * (x + 1.0))
        return math.acosh(x), f_x, -x * f_x * f_x * f_x
    # ATANH
    f_x = 1.0 / ((1.0 - x) * (1.0 + x))
    return math.atanh(x), f_x, 2.0 * x * f_x * f_x


@kernel
def function_of_two(op, x, y):
    """f, f_x, f_y, f_xx, f_xy, f_yy of the function `op` at (x, y)."""
    if op == MULTIPLY:
        return x * y, y, x, 0.0, 1.0, 0.0
    if op == DIVIDE:
        inverse = 1.0 / y
        f = x / y
        f_y = -f * inverse
        return f, inverse, f_y, 0.0, -inverse * inverse, -2.0 * f_y * inverse
    # ATAN2
    scale = 1.0 / (x * x + y * y)
    f_x, f_y = y * scale, -x * scale
    f_xx = -2.0 * x * f_x * scale
    return math.atan2(x, y), f_x, f_y, f_xx, (x * x - y * y) * scale * scale, -f_xx


@kernel
def run_tape(pool, u1, u2, t):
    """Evaluate the tape: its scratch slots receive values and derivatives.

    With two variables they are (u1, u2), or (u1, t) where the tape's row table says so.
    """
    n = int(pool[VARIABLES])
    width = int(pool[WIDTH])
    target = int(pool[SCRATCH])
    if pool[PERIODS] < pool[PERIODS + 1]:
        u1 = wrapped(u1, pool[PERIODS], pool[PERIODS + 1])
    if pool[PERIODS + 2] < pool[PERIODS + 3]:
        u2 = wrapped(u2, pool[PERIODS + 2], pool[PERIODS + 3])
    if t < pool[TIMES] or t > pool[TIMES + 1]:
        u1, t = math.nan, math.nan
    # The derivatives of the variables themselves are constants, stored when the tape is made.
    pool[target] = u1
    if n == 2:
        pool[target + width] = t if pool[ROWS + 2] == 6.0 else u2
    elif n == 3:
        pool[target + width] = u2
        pool[target + 2 * width] = t
    target += n * width
    at = INSTRUCTIONS
    for _ in range(int(pool[COUNT])):
        op = int(pool[at])
        a = int(pool[at + 1])
        b = int(pool[at + 2])
        c = pool[at + 3]
        if op == LINEAR:
            d = pool[at + 4]
            for k in range(width):
                pool[target + k] = c * pool[a + k] + d * pool[b + k]
        elif op == AFFINE:
            for k in range(width):
                pool[target + k] = c * pool[a + k]
            pool[target] += pool[at + 4]
        elif op < SQUARE and op != SINCOS:
            f, f_x, f_y, f_xx, f_xy, f_yy = function_of_two(op, pool[a], pool[b])
            chain_two(pool, a, b, target, n, f, f_x, f_y, f_xx, f_xy, f_yy)
        else:
            if op == SINCOS:
                # Two slots: the sine now, the cosine below.
                sine, cosine = math.sin(pool[a]), math.cos(pool[a])
                chain(pool, a, target, n, sine, cosine, -sine)
                target += width
                f, f_x, f_xx = cosine, -sine, -cosine
            else:
                f, f_x, f_xx = function_of_one(op, pool[a], c)
            chain(pool, a, target, n, f, f_x, f_xx)
        target += width
        at += INSTRUCTION_SIZE


@kernel
def tape(pool, u1, u2, t, out):
    """Fill out (10, 3) from the tape in `pool`; rows of variables that it does not have are left alone."""
    run_tape(pool, u1, u2, t)
    width = int(pool[WIDTH])
    for i in range(int(pool[OUTPUTS])):
        slot = int(pool[RESULTS + 2 * i])
        if slot < 0:
            for k in range(width):
                out[int(pool[ROWS + k]), i] = 0.0
            out[0, i] = pool[RESULTS + 2 * i + 1]
        else:
            for k in range(width):
                out[int(pool[ROWS + k]), i] = pool[slot + k]


@contour_kernel
def traced(chart, shape, pool, u1, u2, t, out):
    """Evaluates contours whose pool is a tape."""
    tape(pool, u1, u2, t, out)
