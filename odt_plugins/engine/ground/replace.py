"""Whether some triangles may take the place of others on the ground, within an envelope.

The ground lies on the sheet as the sheet on the ground: every vertex of the ground is kept in the
list of one triangle of the sheet that is within the envelope of it. Triangles may replace others
when each certainly lies within the envelope of the ground, faces as the ground does, and all ground
vertices in the lists of the old triangles are within the envelope of a new one. With edges of the
sheet near the ground that leaves little for the ground to stick out; `envelope` measures the whole.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.triangle import triangle_in_space
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.closest import Ground, closest_on_triangle, walk
from odt_plugins.engine.ground.overlay import Work as OverlayWork
from odt_plugins.engine.ground.overlay import make_overlay_work
from odt_plugins.engine.ground.triangle_within import triangle_within
from odt_plugins.mesh.arrays import FloatArray, IntArray

ROOM = 64
"""Most triangles that one operation removes or makes."""

COVERED = 1 << 13
"""Most vertices of the ground in the lists of the triangles that one operation removes."""


class Exchange(NamedTuple):
    """Triangles that are to go, and those that are to come; room of one thread.

    Attributes
    ----------
    old : (ROOM,) int32              triangles of the sheet
    new : (ROOM, 3) int32            corners
    covered : (COVERED, 2) int32     vertices of the ground, and which of ``new`` is nearest
    feet : (3,) int32
    overlay : OverlayWork
    """

    old: IntArray
    new: IntArray
    covered: IntArray
    feet: IntArray
    overlay: OverlayWork


def make_exchange() -> Exchange:
    """Make the room of one thread."""
    return Exchange(
        np.empty(ROOM, np.int32), np.empty((ROOM, 3), np.int32), np.empty((COVERED, 2), np.int32),
        np.empty(3, np.int32), make_overlay_work(),
    )


@kernel
def facing(
    points: FloatArray, foot: IntArray, a: int, b: int, c: int, ground: Ground, enough: float,
    slack: float,
) -> float:
    """Cosine between the normal of (a, b, c) and that of the ground under its barycentre.

    The ground is reached from the feet of the corners, of which that counts where it is largest:
    a foot on a crease may lie on the other side. The search ends where the cosine less ``slack`` is
    at least ``enough``. -1 for a flat triangle.
    """
    _, _, _, nx, ny, nz = triangle_in_space(points, a, b, c)
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    best = -1.0
    if not length > 0.0:
        return best
    x = (points[a, 0] + points[b, 0] + points[c, 0]) / 3.0
    y = (points[a, 1] + points[b, 1] + points[c, 1]) / 3.0
    z = (points[a, 2] + points[b, 2] + points[c, 2]) / 3.0
    n = ground.normals
    for corner in range(3):
        if best - slack >= enough:
            break
        v = a if corner == 0 else (b if corner == 1 else c)
        _, face, _, _, _ = walk(x, y, z, foot[v], ground, False)
        best = max(best, (nx * n[face, 0] + ny * n[face, 1] + nz * n[face, 2]) / length)
    return best


@kernel
def gather(
    first: IntArray, following: IntArray, count: int, room: Exchange
) -> int:
    """Put the ground vertices in the lists of room.old[:count] into ``covered``.

    Parameters
    ----------
    first : (m,) int32        first ground vertex in the list of a triangle, -1 for none
    following : (n,) int32    next one in the same list

    Returns
    -------
    int                       how many, -1 when there is no room for all
    """
    number = 0
    for i in range(count):
        v = first[room.old[i]]
        for _ in range(COVERED + 1):
            if v < 0:
                break
            if number == COVERED:
                return -1
            room.covered[number, 0] = v
            number += 1
            v = following[v]
    return number


@kernel
def may_replace(
    points: FloatArray, foot: IntArray, count: int, number: int, least: float, ground: Ground,
    envelope: float, room: Exchange,
) -> bool:
    """Whether room.new[:count] may stand on the ground for what ``covered`` holds.

    Parameters
    ----------
    points : (n, 3) float64    of the sheet, in the unit of the ground
    foot : (n,) int32          triangle of the ground near each of them
    count : int                new triangles
    number : int               rows of ``covered``, from :func:`gather`
    least : float              least cosine of :func:`facing`
    ground : Ground
    envelope : float           length
    room : Exchange            OUT: the second column of ``covered``, for :func:`settle`

    Returns
    -------
    bool                       False also where nothing can be said
    """
    new, feet = room.new, room.feet
    for i in range(count):
        if facing(points, foot, new[i, 0], new[i, 1], new[i, 2], ground, least, 0.0) < least:
            return False
    limit = envelope * envelope
    g = ground.points
    for r in range(number):
        v = room.covered[r, 0]
        best = limit
        found = -1
        for i in range(count):
            far = closest_on_triangle(
                g[v, 0], g[v, 1], g[v, 2], points, new[i, 0], new[i, 1], new[i, 2]
            )[0]
            if far <= best:
                best = far
                found = i
        if found < 0:
            return False
        room.covered[r, 1] = found
    for i in range(count):
        a, b, c = new[i, 0], new[i, 1], new[i, 2]
        feet[0], feet[1], feet[2] = foot[a], foot[b], foot[c]
        if not triangle_within(points, a, b, c, feet, ground, envelope, room.overlay):
            return False
    return True


@kernel
def settle(
    first: IntArray, following: IntArray, places: IntArray, number: int, room: Exchange
) -> None:
    """Write ``covered`` into the lists: new triangle i is stored as places[i], its list empty."""
    for r in range(number - 1, -1, -1):
        v, t = room.covered[r, 0], places[room.covered[r, 1]]
        following[v] = first[t]
        first[t] = v
