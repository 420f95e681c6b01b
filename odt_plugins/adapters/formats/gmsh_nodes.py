"""What replaces nodes and their values in a file of Gmsh's."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats import gmsh_read, gmsh_tables
from odt_plugins.adapters.formats.change import Change, NotRewritable
from odt_plugins.adapters.formats.gmsh_tables import NODE_ENTITY, Block, File, Nodes, Values

Edit = tuple[int, int, bytes]
"""Where bytes start and stop, and what takes their place."""


def coded(file: File, value: Any, kind: str) -> bytes:
    """A number as the file has them."""
    if file.text:
        return repr(value).encode()
    return np.array([value], dtype=np.dtype(kind).newbyteorder(file.order)).tobytes()


def tags(nodes: Nodes, change: Change) -> NDArray[np.int64]:
    """Tag (n',) of every node of the result, new ones after the last or all from 1 on."""
    if nodes.counted:
        return 1 + _positions(nodes, change)
    out = nodes.tags[change.points]
    new = np.flatnonzero(change.points < 0)
    out[new] = nodes.tags.max(initial=0) + 1 + np.arange(len(new))
    return out


def _points(change: Change) -> NDArray[np.float64]:
    """Places (n', 3) of the nodes of the result."""
    out = np.zeros((len(change.points), 3))
    out[:, : change.after.points.shape[1]] = change.after.points
    return out


def places(
    file: File, nodes: Nodes, change: Change, *, parted: bool
) -> tuple[list[Edit], list[str]]:
    """Edits for the nodes that moved, came or went, and what is lost by them.

    Raises
    ------
    NotRewritable    nodes came to an entity with parameters, or to one that is in parts
    """
    points, number, moved = _points(change), change.number, change.moved
    lost = []
    edits: list[Edit] = []
    new = _arrivals(nodes, change, parted=parted)
    stale = 0
    for block in [*nodes.blocks, *(Block(key, False, (0, 0), 0, 0) for key in new)]:
        arrived = new.pop(block.entity, np.zeros(0, dtype=np.int64))
        here = number[block.first: block.last]
        if len(arrived) and block.parametric:
            msg = "nodes came to an entity whose nodes have parameters"
            raise NotRewritable(msg)
        stale += int(moved[here[here >= 0]].sum()) if block.parametric else 0
        if len(arrived) or (here < 0).any() or (nodes.counted and len(here)):
            edits += _block(file, nodes, change, block, arrived)
            continue
        for v, k in zip(range(block.first, block.last), here.tolist(), strict=True):
            if moved[k]:
                edits += [(start, stop, coded(file, x, "f8")) for (start, stop), x in
                          zip(nodes.spans[v].tolist(), points[k].tolist(), strict=True)]
    if change.renumbered:
        section, every = file.all("Nodes")[0], tags(nodes, change)
        known = {block.entity for block in nodes.blocks}
        count = len(nodes.blocks) + sum(key not in known for key in _arrivals(
            nodes, change, parted=parted))
        told = [count, len(every), int(every.min()), int(every.max())]
        if file.version[0] == "4":
            edits += [(*span, coded(file, value, file.long)) for value, span in
                      zip(told, gmsh_tables.heads(file, section), strict=False)]
    if stale:
        lost.append(f"the parameters of {stale} nodes that moved (those of before there)")
    return edits, lost


def _arrivals(
    nodes: Nodes, change: Change, *, parted: bool
) -> dict[tuple[int, int], NDArray[np.int64]]:
    """New nodes of every entity that has some."""
    new = np.flatnonzero(change.points < 0)
    if not len(new):
        return {}
    if parted:
        msg = "nodes came to entities that are in parts"
        raise NotRewritable(msg)
    own = change.after.point_data.get(NODE_ENTITY)
    if own is None:
        return {nodes.blocks[0].entity: new}
    keys = [(int(dim), int(tag)) for dim, tag in np.asarray(own)[new].tolist()]
    return {key: new[[other == key for other in keys]] for key in dict.fromkeys(keys)}


def _block(
    file: File, nodes: Nodes, change: Change, block: Block, arrived: NDArray[np.int64]
) -> list[Edit]:
    """What replaces a block of nodes of which some came or went."""
    points, number, moved, every = _points(change), change.number, change.moved, tags(nodes, change)
    kept = np.flatnonzero(number[block.first: block.last] >= 0) + block.first
    apart = file.version == "4.1"
    rows, heads = [], []
    for v in kept.tolist():
        k = number[v]
        start, stop = nodes.rows[v].tolist()
        heads.append(coded(file, int(every[k]), file.long) if nodes.counted else
                     file.data[nodes.heads[v, 0]: nodes.heads[v, 1]])
        if moved[k]:
            low, high = nodes.spans[v, 0, 0], nodes.spans[v, 2, 1]
            rows.append(file.data[start:low] + _row(file, points[k]) + file.data[high:stop])
        else:
            rows.append(file.data[start:stop])
    for k in arrived.tolist():
        heads.append(coded(file, int(every[k]), file.long if apart else "i4"))
        between = b" " if file.text else b""
        rows.append((b"" if apart else heads[-1] + between) + _row(file, points[k]))
    end = b"" if not file.text else gmsh_tables.line_end(file)
    count = coded(file, len(rows), file.long)
    if file.version in ("1", "2"):
        count = str(len(rows)).encode()
    if block.first == block.last:
        body = end.join([*heads, *rows] if apart else rows)
        if block.at[1]:
            return [(*block.at, count), (block.at[1], block.at[1], end + body)]
        return [_new_block(file, block, count, end, body)]
    out = [(*block.at, count),
           (int(nodes.rows[block.first, 0]), int(nodes.rows[block.last - 1, 1]), end.join(rows))]
    if apart:
        out.append((int(nodes.heads[block.first, 0]), int(nodes.heads[block.last - 1, 1]),
                    end.join(heads)))
    return out


def _new_block(file: File, block: Block, count: bytes, end: bytes, body: bytes) -> Edit:
    """A block of an entity that has none, at the end of the section."""
    dim, tag = block.entity
    told = (dim, tag, 0) if file.version == "4.1" else (tag, dim, 0)
    between = b" " if file.text else b""
    head = between.join([*(coded(file, value, "i4") for value in told), count])
    stop = file.all("Nodes")[0].stop
    while file.data[stop - 1: stop] in ((b"\n", b"\r") if file.text else (b"\n",)):
        stop -= 1
        if not file.text:
            break
    return stop, stop, end + head + end + body


def _row(file: File, values: Any) -> bytes:
    """Some numbers as the file has them."""
    return (b" " if file.text else b"").join(coded(file, float(x), "f8") for x in values)


def _positions(nodes: Nodes, change: Change) -> NDArray[np.int64]:
    """Place (n',) of every node of the result among those of the file, block after block."""
    new = _arrivals(nodes, change, parted=False)
    order = []
    for block in nodes.blocks:
        here = change.number[block.first: block.last]
        order += [here[here >= 0], new.pop(block.entity, here[:0])]
    out = np.empty(len(change.points), dtype=np.int64)
    out[np.concatenate([*order, *new.values()])] = np.arange(len(out))
    return out


def values(
    file: File, nodes: Nodes, part: Values, change: Change, array: NDArray[Any]
) -> list[Edit]:
    """What replaces the values of nodes that are others; all that were and are somewhere else.

    Values in the order of the nodes stay so, as some readers go by it.
    """
    known = np.isin(part.tags, nodes.tags)
    before = np.full(len(known), -1, dtype=np.int64)
    before[known] = gmsh_read.places(nodes.tags, part.tags[known], "node")
    number, every = change.number, tags(nodes, change)
    width = part.values.shape[1]
    table = array.reshape(len(array), width)
    kept = ~known | (number[before] >= 0)
    own = np.where((known & kept)[:, None], table[number[before]], part.values)
    own = np.where(np.isnan(own), part.values, own)
    changed = (own != part.values) & ~np.isnan(own)
    new = np.flatnonzero(change.points < 0)
    new = new[~np.isnan(table[new]).any(axis=1)]
    if kept.all() and not len(new) and not nodes.counted:
        return [(*part.spans[k, j].tolist(), coded(file, float(own[k, j]), "f8"))
                for k, j in np.argwhere(changed).tolist()]
    between = b" " if file.text else b""
    lines = []
    told = every[number[before]] if nodes.counted else part.tags
    for k in np.flatnonzero(kept).tolist():
        line = file.data[part.rows[k, 0]: part.rows[k, 1]]
        lines.append(coded(file, int(told[k]), "i4") + between + _row(file, own[k])
                     if changed[k].any() or nodes.counted else line)
    lines += [coded(file, int(every[k]), "i4") + between + _row(file, table[k])
              for k in new.tolist()]
    if np.array_equal(part.tags, nodes.tags):
        order = np.argsort(_positions(nodes, change)[[*number[kept], *new]], kind="stable")
        lines = [lines[k] for k in order.tolist()]
    end = b"" if not file.text else gmsh_tables.line_end(file)
    start, stop = (int(part.rows[0, 0]), int(part.rows[-1, 1])) if len(part.rows) else (0, 0)
    return [(*part.at, str(len(lines)).encode()), (start, stop, end.join(lines))]
