"""What every flip of an edge of a surface must keep: one edge a pair, normals; and its undoing."""

from __future__ import annotations

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.closest import Ground
from odt_plugins.engine.ground.sheet import Sheet, normal_cosine
from odt_plugins.engine.moves.flips2d import flip
from odt_plugins.engine.topology.lookup import place_in


@kernel
def flip_back(sheet: Sheet, t: int, s: int, e: int) -> None:
    """Undo a flip: flipped again, the edge is as before, and the two triangles change places."""
    i, j = place_in(sheet.edges.of_cell, t, e), place_in(sheet.edges.of_cell, s, e)
    flip(sheet.triangles, sheet.neighbors, sheet.edges, t, i, s, j)
    sheet.first[t], sheet.first[s] = sheet.first[s], sheet.first[t]


@kernel
def edge_is_free(sheet: Sheet, t: int, a: int, s: int, d: int) -> bool:
    """Whether there is no edge from a to d yet; the triangles around one of them tell."""
    if not sheet.pinched[a]:
        return not _meets(sheet, t, a, d)
    if not sheet.pinched[d]:
        return not _meets(sheet, s, d, a)
    return False


@kernel
def _meets(sheet: Sheet, start: int, centre: int, other: int) -> bool:
    """Whether a triangle of the fan around a vertex holds another vertex."""
    t, neighbors = sheet.triangles, sheet.neighbors
    for way in (1, 2):
        c = start
        for _ in range(len(t)):
            i = place_in(t, c, centre)
            if t[c, (i + 1) % 3] == other or t[c, (i + 2) % 3] == other:
                return True
            c = neighbors[c, (i + way) % 3]
            if c == start:
                return False
            if c < 0:
                break
        if c >= 0:
            sheet.lost[0] = centre
            return True
    return False


@kernel
def keeps_normals(
    sheet: Sheet, ground: Ground, a: int, b: int, c: int, d: int, cosine: float
) -> bool:
    """Whether the new triangles face as the ground does, or no worse than the old ones."""
    new = min(normal_cosine(sheet, ground, a, b, d), normal_cosine(sheet, ground, a, d, c))
    if new >= cosine:
        return True
    if not new > 0.0:
        return False
    return new > min(normal_cosine(sheet, ground, a, b, c), normal_cosine(sheet, ground, d, c, b))
