"""Velocities of turning joints carried from one configuration to another as the momenta that go with them.

The axes of a free, planar or spherical joint turn with it. Bodies that turn together have a mass, a centre of mass c
and a moment of inertia J about it that stand still in these axes, the composite ones of the joint's subtree as it is.
Their momentum m (v + omega x c) and their angular momentum J omega about c would stand still in space if nothing
acted: carrying these leaves only what acts for an integrator to do, exactly so for one body.

With velocities so carried to the axes at one instant, their rate there is v' + `turning_rate`.
"""

from __future__ import annotations

from ..arrays import INTEGERS, REALS, array_type
from ..callback import separate_kernel
from ..dynamics.manifold import FREE_FLYER, PLANAR_BLOCK, QUATERNION, rotate_by_quaternion
from ..jit import NOTHING, STEPPING, kernel

# Columns of a block's inertia: c, J by rows and its inverse.
CENTRE, MOMENT, INVERSE = 0, 3, 12
INERTIA_SIZE = 21
# Determinant of J, relative to that of a ball, below which angular velocities are carried instead: of a needle's
# momentum along its axis nothing but the round-off of the others may be left.
_SLENDER = 1e-3

_VECTOR = array_type(REALS, 1)


@kernel
def find_inertias(blocks, mass, out):
    """out (blocks, INERTIA_SIZE) from the lower triangle of the mass matrix (nv, nv)."""
    for b in range(blocks.shape[0]):
        kind, iv = blocks[b, 0], blocks[b, 2]
        row = out[b]
        for i in range(INERTIA_SIZE):
            row[i] = 0.0
        for i in range(3):
            row[MOMENT + 4 * i] = row[INVERSE + 4 * i] = 1.0
        first = iv + 3 if kind == FREE_FLYER else iv
        whole = mass[iv, iv]
        x = y = z = 0.0
        if whole > 0.0 and kind == FREE_FLYER:
            x, y, z = mass[iv + 5, iv + 1] / whole, -mass[iv + 5, iv] / whole, mass[iv + 4, iv] / whole
        elif whole > 0.0 and kind == PLANAR_BLOCK:
            x, y = mass[iv + 2, iv + 1] / whole, -mass[iv + 2, iv] / whole
        row[CENTRE], row[CENTRE + 1], row[CENTRE + 2] = x, y, z
        if kind not in (FREE_FLYER, QUATERNION):
            continue
        if kind == QUATERNION:
            whole = 0.0
        # the six entries of J
        xx = mass[first, first] - whole * (y * y + z * z)
        yy = mass[first + 1, first + 1] - whole * (x * x + z * z)
        zz = mass[first + 2, first + 2] - whole * (x * x + y * y)
        xy, xz = mass[first + 1, first] + whole * x * y, mass[first + 2, first] + whole * x * z
        yz = mass[first + 2, first + 1] + whole * y * z
        # and of its adjugate
        a, d, f = yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy
        ab, ac, bc = xz * yz - xy * zz, xy * yz - xz * yy, xy * xz - xx * yz
        determinant, mean = xx * a + xy * ab + xz * ac, (xx + yy + zz) / 3.0
        if determinant > _SLENDER * mean * mean * mean > 0.0:
            _fill_symmetric(row, MOMENT, xx, xy, xz, yy, yz, zz, 1.0)
            _fill_symmetric(row, INVERSE, a, ab, ac, d, bc, f, 1.0 / determinant)


@kernel
def _fill_symmetric(row, at, xx, xy, xz, yy, yz, zz, factor):
    row[at], row[at + 1], row[at + 2] = factor * xx, factor * xy, factor * xz
    row[at + 3], row[at + 4], row[at + 5] = factor * xy, factor * yy, factor * yz
    row[at + 6], row[at + 7], row[at + 8] = factor * xz, factor * yz, factor * zz


@kernel
def _times(row, at, x, y, z):
    """Product of a matrix of a block's inertia and (x, y, z)."""
    return (
        row[at] * x + row[at + 1] * y + row[at + 2] * z,
        row[at + 3] * x + row[at + 4] * y + row[at + 5] * z,
        row[at + 6] * x + row[at + 7] * y + row[at + 8] * z,
    )


@separate_kernel(
    NOTHING, array_type(INTEGERS, 2), array_type(REALS, 2), _VECTOR, _VECTOR, _VECTOR, _VECTOR, when=STEPPING
)
def transport(blocks, inertias, source, target, v, out):
    """out = velocities v (nv,) at the configuration `source`, in whose axes they are, carried to `target` (out may be
    v). Both configurations are normalised."""
    for b in range(blocks.shape[0]):
        kind, iq, iv, n = blocks[b, 0], blocks[b, 1], blocks[b, 2], blocks[b, 3]
        row = inertias[b]
        if kind in (FREE_FLYER, QUATERNION):
            first, k = (iq + 3, iv + 3) if kind == FREE_FLYER else (iq, iv)
            x, y, z, w = source[first], source[first + 1], source[first + 2], source[first + 3]
            a, e, c, d = target[first], target[first + 1], target[first + 2], target[first + 3]
            # conjugate of the target's quaternion times the source's
            tx, ty = d * x - a * w - e * z + c * y, d * y + a * z - e * w - c * x
            tz, tw = d * z - a * y + e * x - c * w, d * w + a * x + e * y + c * z
            wx, wy, wz = v[k], v[k + 1], v[k + 2]
            lx, ly, lz = _times(row, MOMENT, wx, wy, wz)
            lx, ly, lz = rotate_by_quaternion(tx, ty, tz, tw, lx, ly, lz)
            ox, oy, oz = _times(row, INVERSE, lx, ly, lz)
            out[k], out[k + 1], out[k + 2] = ox, oy, oz
            if kind == FREE_FLYER:
                cx, cy, cz = row[CENTRE], row[CENTRE + 1], row[CENTRE + 2]
                px, py, pz = rotate_by_quaternion(
                    tx,
                    ty,
                    tz,
                    tw,
                    v[iv] + wy * cz - wz * cy,
                    v[iv + 1] + wz * cx - wx * cz,
                    v[iv + 2] + wx * cy - wy * cx,
                )
                out[iv], out[iv + 1] = px - (oy * cz - oz * cy), py - (oz * cx - ox * cz)
                out[iv + 2] = pz - (ox * cy - oy * cx)
        elif kind == PLANAR_BLOCK:
            c = source[iq + 2] * target[iq + 2] + source[iq + 3] * target[iq + 3]
            s = source[iq + 3] * target[iq + 2] - source[iq + 2] * target[iq + 3]
            turning, cx, cy = v[iv + 2], row[CENTRE], row[CENTRE + 1]
            px, py = v[iv] - turning * cy, v[iv + 1] + turning * cx
            out[iv], out[iv + 1] = c * px - s * py + turning * cy, s * px + c * py - turning * cx
            out[iv + 2] = turning
        else:
            for i in range(iv, iv + n):
                out[i] = v[i]


@kernel
def turning_rate(blocks, inertias, v, out):
    """out (nv,): what carried velocities change by beyond v', which is zero for joints that do not turn; whether there
    are others."""
    found = False
    for b in range(blocks.shape[0]):
        kind, iv, n = blocks[b, 0], blocks[b, 2], blocks[b, 3]
        row = inertias[b]
        for i in range(iv, iv + n):
            out[i] = 0.0
        if kind in (FREE_FLYER, QUATERNION):
            found = True
            k = iv + 3 if kind == FREE_FLYER else iv
            x, y, z = v[k], v[k + 1], v[k + 2]
            lx, ly, lz = _times(row, MOMENT, x, y, z)
            dx, dy, dz = _times(row, INVERSE, y * lz - z * ly, z * lx - x * lz, x * ly - y * lx)
            out[k], out[k + 1], out[k + 2] = dx, dy, dz
            if kind == FREE_FLYER:
                cx, cy, cz = row[CENTRE], row[CENTRE + 1], row[CENTRE + 2]
                px, py, pz = v[iv] + y * cz - z * cy, v[iv + 1] + z * cx - x * cz, v[iv + 2] + x * cy - y * cx
                out[iv] = y * pz - z * py - (dy * cz - dz * cy)
                out[iv + 1] = z * px - x * pz - (dz * cx - dx * cz)
                out[iv + 2] = x * py - y * px - (dx * cy - dy * cx)
        elif kind == PLANAR_BLOCK:
            found = True
            turning = v[iv + 2]
            px, py = v[iv] - turning * row[CENTRE + 1], v[iv + 1] + turning * row[CENTRE]
            out[iv], out[iv + 1] = -turning * py, turning * px
    return found
