"""A mesh of tetrahedra that is being resized, with its surface and its lines."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.cells.metric import seen_square
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.closest import Ground
from odt_plugins.engine.ground.replace import Exchange
from odt_plugins.engine.remesh.boxes import Boxes
from odt_plugins.engine.remesh.simplices import Simplices, enlarged
from odt_plugins.engine.topology.tets import FREE, USED
from odt_plugins.mesh.arrays import ByteArray, FloatArray, IntArray, LongArray

INSIDE, PATCH, LINE, CORNER = 0, 1, 2, 3
"""Kinds of vertices: of no patch, of one patch alone, within one feature line, any other."""

FREELY, STAYS, STIFF = 0, 1, 2
"""What a vertex does: it may move and go, or neither; edges of two stiff ones are not cut."""

STAR = 1 << 12
"""Most simplices around a vertex that an operation looks at."""


class Body(NamedTuple):
    """Vertices and simplices of all dimensions.

    Attributes
    ----------
    points : (n, 3) float64     room for more vertices than there are; more columns as in
                                ``cells.metric``
    size : (n,) float64         length that edges should have there
    kind, hold : (n,) uint8     INSIDE to CORNER; FREELY, STAYS or STIFF
    parent : (n,) int32         a vertex beside which a new one was made
    tets, triangles, segments : Simplices
    used : (1,) int64           vertices there are, gone ones among them
    """

    points: FloatArray
    size: FloatArray
    kind: ByteArray
    hold: ByteArray
    parent: IntArray
    tets: Simplices
    triangles: Simplices
    segments: Simplices
    used: LongArray


class Scratch(NamedTuple):
    """Room of the operations.

    Attributes
    ----------
    first, second, third : (STAR,) int32    simplices around a vertex or an edge
    mark : (n,) int64                       stamps of vertices
    clock : (1,) int64                      the last stamp
    exchange : Exchange
    foot : (n,) int32                       triangles of the ground near vertices, -1 unknown
    places : (STAR,) int32
    """

    first: IntArray
    second: IntArray
    third: IntArray
    mark: LongArray
    clock: LongArray
    exchange: Exchange
    foot: IntArray
    places: IntArray


class Guard(NamedTuple):
    """What a surface that is resized must keep.

    Attributes
    ----------
    ground : Ground                 the input's, its patches apart
    boxes, curves : Boxes           its triangles by patch, and the segments of its lines by line
    first, following : int32        lists of the ground's vertices, see ``ground.replace``
    on_line, next_on_line : int32   the same of vertices of ``curves`` that a segment stands for
    reach : (triangles,) float64    largest distance from a triangle of the ground
    limits : (3,) float64           envelope, cosines of the turn against the ground and against
                                    what a triangle was
    least : Extremes                of tetrahedra; none that passes them becomes worse
    volume : (regions, 3) float64   change so far, largest change, work
    sides : (patches, 2) int32      regions on the sides of a patch, -1 outside
    area : (patches,) float64
    """

    ground: Ground
    boxes: Boxes
    curves: Boxes
    first: IntArray
    following: IntArray
    on_line: IntArray
    next_on_line: IntArray
    reach: FloatArray
    limits: FloatArray
    least: Extremes
    volume: FloatArray
    sides: IntArray
    area: FloatArray

    def offsets(self) -> FloatArray:
        """How far each patch has to go out of its first region to make the volumes as before."""
        change, count = self.volume[:, 0], len(self.volume)
        low, high = self.sides[:, 0], self.sides[:, 1]
        around = np.zeros(count)
        for side in (low, high):
            inner = side >= 0
            np.add.at(around, side[inner], self.area[inner])
        part = np.divide(change, around, out=np.zeros(count), where=around > 0.0)
        out: FloatArray = np.where(high >= 0, part[high] - part[low], -part[low])
        return out


@kernel
def ratio(body: Body, a: int, b: int) -> float:
    """Squared length of an edge, as it is seen, by that which it should have."""
    size = 0.5 * (body.size[a] + body.size[b])
    return seen_square(body.points, a, b) / (size * size)


def with_room(body: Body, scratch: Scratch, guard: Guard, vertices: int, cells: int) -> tuple[
        Body, Scratch, Guard]:
    """The same with room for more vertices and tetrahedra, and as many triangles and segments."""
    n = len(body.points)
    if int(body.used[0]) + vertices + 2 > n:
        n = int(body.used[0]) + vertices + n // 2 + 16
    room = [_room(s, cells) for s in (body.tets, body.triangles, body.segments)]
    more = (0, n - len(body.points))
    body = body._replace(
        points=np.pad(body.points, (more, (0, 0))), size=np.pad(body.size, more),
        kind=np.pad(body.kind, more), hold=np.pad(body.hold, more),
        parent=np.pad(body.parent, more),
        tets=enlarged(body.tets, n, room[0]), triangles=enlarged(body.triangles, n, room[1]),
        segments=enlarged(body.segments, n, room[2]),
    )
    scratch = scratch._replace(mark=np.pad(scratch.mark, (0, n - len(scratch.mark))),
                               foot=_longer(scratch.foot, n))
    guard = guard._replace(first=_longer(guard.first, len(body.triangles.rows)),
                           on_line=_longer(guard.on_line, len(body.segments.rows)))
    return body, scratch, guard


def _room(simplices: Simplices, more: int) -> int:
    """Slots that simplices are to have for so many further ones."""
    room = len(simplices.rows)
    free = int(simplices.slots[FREE]) + room - int(simplices.slots[USED])
    return room if free >= more else room + more + room // 4


def _longer(lists: IntArray, length: int) -> IntArray:
    return np.pad(lists, (0, max(0, length - len(lists))), constant_values=-1)
