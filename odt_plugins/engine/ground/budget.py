"""The change of the volume of a body that vertices of its boundary share."""

from __future__ import annotations

from odt_plugins.engine.cells.triangle import opposite_edge
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.sheet import Sheet
from odt_plugins.engine.topology.star import Stars
from odt_plugins.mesh.arrays import FloatArray


@kernel
def affordable(volume: FloatArray, change: float, v: int) -> bool:
    """Whether vertex v may change the volume: within all budgets, or if debts are paid back."""
    after = abs(volume[0, 0] + change)
    if after > volume[0, 1] and after > abs(volume[0, 0]):
        return False
    after = abs(volume[v + 1, 0] + change)
    return after <= volume[v + 1, 1] * volume[0, 1] or after <= abs(volume[v + 1, 0])


@kernel
def spend(volume: FloatArray, change: float, v: int) -> None:
    """Write down that vertex v changed the volume."""
    volume[0, 0] += change
    volume[v + 1, 0] += change


@kernel
def swept_volume(sheet: Sheet, own: Stars, v: int, x: float, y: float, z: float) -> float:
    """Volume that the star of v swept outwards when v moved from (x, y, z) to where it is."""
    p, t = sheet.points, sheet.triangles
    dx, dy, dz = p[v, 0] - x, p[v, 1] - y, p[v, 2] - z
    indptr, indices = own
    total = 0.0
    for s in range(indptr[v], indptr[v + 1]):
        c = indices[s]
        b, d = opposite_edge(t, c, v)
        ux, uy, uz = p[b, 0] - x, p[b, 1] - y, p[b, 2] - z
        wx, wy, wz = p[d, 0] - x, p[d, 1] - y, p[d, 2] - z
        total += (
            dx * (uy * wz - uz * wy) + dy * (uz * wx - ux * wz) + dz * (ux * wy - uy * wx)
        )
    return total / 6.0
