"""Contact coordinates near a pole of their chart are moved to another chart of the contour (see `contours.charts`)."""

from __future__ import annotations

from ..contours.charts import convert_chart, preferred_chart
from ..jit import INTEGER, entry_kernel, kernel
from ..layout import CHART, KIND, system_at


@kernel
def change_charts(system):
    """Move the contact coordinates in `system.state` to better charts; returns how many contours changed theirs."""
    first = system.sizes.nq + system.sizes.nv
    changed = 0
    for side in range(2 * system.sizes.nc):
        ints, shape = system.side_int[side], system.side_shape[side]
        u = system.state[first + 2 * side : first + 2 * side + 2]
        chart = preferred_chart(ints[KIND], ints[CHART], shape, u[0], u[1])
        if chart != ints[CHART]:
            u[0], u[1] = convert_chart(ints[KIND], shape, ints[CHART], u[0], u[1], chart)
            ints[CHART] = chart
            changed += 1
    return changed


@entry_kernel(INTEGER)
def move_charts(address):
    """`change_charts` for callers in Python."""
    return change_charts(system_at(address))
