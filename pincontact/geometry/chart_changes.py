"""Contact coordinates that come near a pole of their chart move to another one."""

from __future__ import annotations

from ..contours.charts import convert_chart, preferred_chart
from ..jit import INTEGER, entry_kernel, kernel
from ..layout import CHART, KIND, POOL_ADDRESS, POOL_SIZE, system_at
from ..workspace import reals_at


@kernel
def change_charts(system):
    """Move the contact coordinates in `state` to better charts; returns how many contours changed theirs."""
    sizes = system.sizes
    nc, first = sizes.nc, sizes.nq + sizes.nv
    state = system.state
    side_int = system.side_int
    side_shape = system.side_shape
    changed = 0
    for side in range(2 * nc):
        ints = side_int[side]
        u = state[first + 2 * side : first + 2 * side + 2]
        chart = preferred_chart(ints[KIND], ints[CHART], side_shape[side], u[0], u[1])
        if chart != ints[CHART]:
            pool = reals_at(ints[POOL_ADDRESS], ints[POOL_SIZE])
            u[0], u[1] = convert_chart(ints[KIND], side_shape[side], pool, ints[CHART], u[0], u[1], chart)
            ints[CHART] = chart
            changed += 1
    return changed


@entry_kernel(INTEGER)
def move_charts(address):
    """`change_charts` for callers in Python."""
    return change_charts(system_at(address))
