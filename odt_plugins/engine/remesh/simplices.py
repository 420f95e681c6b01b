"""Simplices of one dimension that come and go, with a list of those around every vertex."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.topology.tets import FREE, FULL, USED
from odt_plugins.mesh.arrays import BoolArray, IntArray, LongArray


class Simplices(NamedTuple):
    """Simplices in slots of which some may be free.

    Attributes
    ----------
    rows : (room, k) int32      vertices; -1 in column 0 of a free slot
    tag : (room,) int32         label
    held : (room,) bool         whether it must stay as it is
    head : (n,) int32           a corner of each vertex, k times the slot plus the column, or -1
    next : (room, k) int32      next corner of the same vertex, or -1
    slots : (3,) int64          see :mod:`odt_plugins.engine.topology.tets`
    free : (room,) int32        stack of free slots
    """

    rows: IntArray
    tag: IntArray
    held: BoolArray
    head: IntArray
    next: IntArray
    slots: LongArray
    free: IntArray

    def live(self) -> LongArray:
        """Slots in use."""
        return np.flatnonzero(self.rows[: self.slots[USED], 0] >= 0)


def make_simplices(
    rows: IntArray, tag: IntArray, held: BoolArray, n: int, room: int
) -> Simplices:
    """Lay simplices out, with room for ``room`` of them and lists for ``n`` vertices."""
    m, k = rows.shape
    room = max(room, m)
    out = Simplices(
        np.full((room, k), -1, dtype=np.int32), np.zeros(room, dtype=np.int32),
        np.zeros(room, dtype=np.bool_), np.full(n, -1, dtype=np.int32),
        np.full((room, k), -1, dtype=np.int32), np.array([m, 0, 0], dtype=np.int64),
        np.empty(room, dtype=np.int32),
    )
    out.rows[:m], out.tag[:m], out.held[:m] = rows, tag, held
    _link_all(out, m)
    return out


def enlarged(simplices: Simplices, n: int, room: int) -> Simplices:
    """The same simplices in the same slots with more room."""
    old = len(simplices.rows)
    if n <= len(simplices.head) and room <= old:
        return simplices
    room = max(room, old)
    more, last = room - old, n - len(simplices.head)
    wide = ((0, more), (0, 0))
    return Simplices(
        np.pad(simplices.rows, wide, constant_values=-1), np.pad(simplices.tag, (0, more)),
        np.pad(simplices.held, (0, more)),
        np.pad(simplices.head, (0, max(last, 0)), constant_values=-1),
        np.pad(simplices.next, wide, constant_values=-1), simplices.slots,
        np.pad(simplices.free, (0, more)),
    )


@kernel
def _link_all(s: Simplices, m: int) -> None:
    for c in range(m):
        link(s, c)


@kernel
def link(s: Simplices, c: int) -> None:
    """Enter simplex c into the lists of its vertices."""
    k = s.rows.shape[1]
    for i in range(k):
        v = s.rows[c, i]
        s.next[c, i] = s.head[v]
        s.head[v] = c * k + i


@kernel
def _unlink_corner(s: Simplices, c: int, i: int) -> None:
    """Take one corner of simplex c out of the list of its vertex."""
    k = s.rows.shape[1]
    v = s.rows[c, i]
    corner = c * k + i
    at = s.head[v]
    if at == corner:
        s.head[v] = s.next[c, i]
        return
    for _ in range(s.rows.shape[0]):
        after = s.next[at // k, at % k]
        if after == corner:
            s.next[at // k, at % k] = s.next[c, i]
            return
        at = after


@kernel
def remove(s: Simplices, c: int) -> None:
    """Free the slot of simplex c."""
    for i in range(s.rows.shape[1]):
        _unlink_corner(s, c, i)
    s.rows[c, 0] = -1
    s.free[s.slots[FREE]] = c
    s.slots[FREE] += 1


@kernel
def replace_corner(s: Simplices, c: int, old: int, new: int) -> None:
    """Let simplex c have the vertex ``new`` instead of ``old``."""
    k = s.rows.shape[1]
    for i in range(k):
        if s.rows[c, i] == old:
            _unlink_corner(s, c, i)
            s.rows[c, i] = new
            s.next[c, i] = s.head[new]
            s.head[new] = c * k + i
            return


@kernel
def become(s: Simplices, c: int, rows: IntArray, k: int) -> None:
    """Let simplex c have the vertices in row k of others."""
    for i in range(s.rows.shape[1]):
        _unlink_corner(s, c, i)
    for i in range(s.rows.shape[1]):
        s.rows[c, i] = rows[k, i]
    link(s, c)


@kernel
def has_room_for(s: Simplices, more: int) -> bool:
    """Whether there are so many slots for further simplices; what is missing is written down."""
    if more > s.slots[FREE] + s.rows.shape[0] - s.slots[USED]:
        s.slots[FULL] = 1
        return False
    return True


@kernel
def copied(s: Simplices, c: int, old: int, new: int) -> int:
    """A further simplex, as c with the vertex ``new`` instead of ``old``."""
    if s.slots[FREE] > 0:
        s.slots[FREE] -= 1
        d = s.free[s.slots[FREE]]
    else:
        d = s.slots[USED]
        s.slots[USED] += 1
    for i in range(s.rows.shape[1]):
        v = s.rows[c, i]
        s.rows[d, i] = new if v == old else v
    s.tag[d] = s.tag[c]
    s.held[d] = s.held[c]
    link(s, d)
    return d


@kernel
def holds(s: Simplices, c: int, v: int) -> bool:
    """Whether v is a vertex of simplex c."""
    for i in range(s.rows.shape[1]):
        if s.rows[c, i] == v:
            return True
    return False


@kernel
def star(s: Simplices, v: int, out: IntArray) -> int:
    """Write the simplices around v; how many, or -1 where there are more than there is room for."""
    k = s.rows.shape[1]
    count = 0
    at = s.head[v]
    for _ in range(s.next.size):
        if at < 0:
            break
        if count == out.shape[0]:
            return -1
        out[count] = at // k
        count += 1
        at = s.next[at // k, at % k]
    return count


@kernel
def around(s: Simplices, a: int, b: int, out: IntArray) -> int:
    """Write the simplices that hold the edge ab; how many, or -1 where there are too many."""
    k = s.rows.shape[1]
    count = 0
    at = s.head[a]
    for _ in range(s.next.size):
        if at < 0:
            break
        c = at // k
        if holds(s, c, b):
            if count == out.shape[0]:
                return -1
            out[count] = c
            count += 1
        at = s.next[c, at % k]
    return count
