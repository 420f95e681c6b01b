"""XDMF files written into themselves: the XML and its data with other points, cells and arrays."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.change import Change, NotRewritable
from odt_plugins.adapters.formats.decks import indices
from odt_plugins.adapters.formats.xdmf import Cells, cells_of, layout_of, members_of, offset_of
from odt_plugins.adapters.formats.xdmf_items import (
    Document,
    dimensions,
    form_of,
    items_of,
    local,
    parse,
    slab,
    stored,
    type_of,
    values_of,
)

Edits = list[tuple[int, int, bytes]]
"""First and last byte of what is exchanged, and what takes its place."""


def rewrite(source: Path, target: Path, change: Change) -> list[str]:
    """Copy the XML and all files of data, and replace the numbers that changed.

    Raises
    ------
    NotRewritable    it has arrays of edges, faces or finite elements of what changed, or data that
                     have no room for the new ones
    """
    doc = parse(source)
    layout = layout_of(doc)
    other = change.renumbered or any(
        change.exchanged(b).any() or not np.array_equal(rows, np.arange(len(layout.blocks[b][1])))
        for b, rows in enumerate(change.cells))
    if layout.unknown and other:
        msg = f"{layout.unknown[0]} refers to cells that changed"
        raise NotRewritable(msg)
    edits: Edits = []
    names = _copied(doc, target, edits)
    for element in layout.geometries:
        items = items_of(doc, element)
        points = np.asarray(change.after.points)
        for axis, item in enumerate(items):
            _put(doc, item, points if len(items) == 1 else points[:, axis], names, edits)
    followed: dict[int, NDArray[np.int64]] = {}
    for own in layout.cells:
        place, rows = _followed(change, own)
        followed[id(own)] = rows
        item = items_of(doc, own.grid.topology)[0]
        before = values_of(doc, item)
        values = _nodes(doc, change, own, place, rows)
        if before.size != values.size or not np.array_equal(before.ravel(), values.ravel()):
            _put(doc, item, values, names, edits)
        for name in ("NumberOfElements", "Dimensions"):
            stated = (own.grid.topology.get(name) or "").split()
            if stated == [str(len(own.where))] and len(rows) != len(own.where):
                _attribute(doc, own.grid.topology, name, str(len(rows)), edits)
    for array in layout.arrays:
        if array.cells is None:
            values = np.asarray(change.after.point_data[array.title])
        else:
            rows = followed[id(array.cells)]
            parts = [np.asarray(part) for part in change.after.cell_data[array.title]]
            values = np.zeros((len(rows), *parts[0].shape[1:]), dtype=parts[0].dtype)
            for b, part in enumerate(parts):
                here = rows[:, 0] == b
                values[here] = part[rows[here, 1]]
        _put(doc, items_of(doc, array.element)[0], values, names, edits)
    for one in layout.sets:
        old = members_of(doc, one)
        home = change.after.point_sets if one.cells is None else change.after.cell_sets
        if one.title not in home:
            msg = f"the set {one.title!r} is gone"
            raise NotRewritable(msg)
        new = indices(home[one.title] if one.cells is None else [])
        if one.cells is not None:
            rows = followed[id(one.cells)]
            inside = np.zeros(len(rows), dtype=np.bool_)
            for b, members in enumerate(home[one.title]):
                inside |= (rows[:, 0] == b) & np.isin(rows[:, 1], indices(members))
            new = np.flatnonzero(inside)
        if set(new.tolist()) != set(old.tolist()):
            _put(doc, items_of(doc, one.element)[0], new, names, edits)
    data = bytearray(doc.data)
    for start, end, text in sorted(dict.fromkeys(edits), reverse=True):
        data[start:end] = text
    target.write_bytes(data)
    return []


def _copied(doc: Document, target: Path, edits: Edits) -> dict[Path, Path]:
    """Copy the files of data to the target, and write their new names into the XML."""
    names: dict[Path, Path] = {}
    for item in doc.root.iter():
        if local(item) != "DataItem" or item.get("Reference") or form_of(item) == "xml" or len(
                item) or slab(doc, item) is not None:
            continue
        file = stored(doc, item).file
        if file not in names:
            stem = doc.path.stem
            alike = file.name.startswith(stem)
            name = target.stem + (file.name[len(stem):] if alike else f"-{file.name}")
            if target.name == doc.path.name:
                name = file.name
            while target.parent / name in names.values():
                name = f"{Path(name).stem}-{Path(name).suffix}"
            names[file] = target.parent / name
            shutil.copyfile(file, names[file])
        old = (item.text or "").strip()
        inside = old.rpartition(":")[2] if form_of(item) == "hdf" else ""
        new = names[file].name + (f":{inside}" if form_of(item) == "hdf" else "")
        start, end = _text(doc, item)
        if new != old:
            head = len(doc.data[start:end]) - len(doc.data[start:end].lstrip())
            tail = len(doc.data[start:end].rstrip())
            text = new.replace("&", "&amp;").replace("<", "&lt;")
            edits.append((start + head, start + tail, text.encode()))
    return names


def _text(doc: Document, element: Any) -> tuple[int, int]:
    """First and last byte of the text of an element.

    Raises
    ------
    NotRewritable    it is not the text alone
    """
    start = doc.tags[element][1]
    end = doc.data.find(b"<", start)
    if doc.data[start:end].decode("utf-8", "replace") != (element.text or ""):
        msg = "the text of its items is not plain"
        raise NotRewritable(msg)
    return start, end


def _attribute(doc: Document, element: Any, name: str, value: str, edits: Edits) -> None:
    """Give an attribute of an element another value."""
    start, end = doc.tags[element]
    found = re.search(rb"\s" + name.encode() + rb"\s*=\s*[\"']([^\"']*)", doc.data[start:end])
    if found:
        edits.append((start + found.start(1), start + found.end(1), value.encode()))


def _followed(change: Change, own: Cells) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cells of a grid as they are now: the place in the grid, and block and row, of each."""
    places, rows = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 2), dtype=np.int64)]
    for b, source in enumerate(change.cells):
        here = np.flatnonzero(own.where[:, 0] == b)
        order = np.argsort(source, kind="stable")
        first = np.searchsorted(source[order], own.where[here, 1], "left")
        count = np.searchsorted(source[order], own.where[here, 1], "right") - first
        behind = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
        new = order[np.repeat(first, count) + behind]
        places.append(np.repeat(here, count))
        rows.append(np.stack([np.full(len(new), b), new], axis=1))
    place = np.concatenate(places)
    order = np.argsort(place, kind="stable")
    return place[order], np.concatenate(rows)[order]


def _nodes(
    doc: Document, change: Change, own: Cells, place: NDArray[np.int64], rows: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Nodes of the cells of a grid as they are now, in the form of its file."""
    offset, number = offset_of(own.grid.topology), change.number
    parts, codes = cells_of(doc, own.grid.topology)
    start = np.cumsum([0, *(len(table) for _, table in parts)])
    lines = []
    for k, (_, table) in enumerate(parts):
        here = (place >= start[k]) & (place < start[k + 1])
        nodes = number[table[place[here] - start[k]]]
        for b in np.unique(rows[here, 0]).tolist():
            inside = rows[here, 0] == b
            new = rows[here][inside, 1]
            other = change.exchanged(b)[new]
            after = np.asarray(change.after.cells[b].data)
            nodes[np.flatnonzero(inside)[other]] = after[new[other]]
        nodes = nodes + offset
        code = codes[k]
        if code is not None:
            head = [code] if code > 0 else [-code, table.shape[1]]
            nodes = np.concatenate([np.tile(head, (len(nodes), 1)), nodes], axis=1)
        lines.append(nodes.ravel() if code is not None else nodes)
    return lines[0] if len(lines) == 1 else np.concatenate(lines)


def _put(
    doc: Document, item: Any, values: NDArray[Any], names: dict[Path, Path], edits: Edits
) -> None:
    """Give an item other numbers, in the place and the form that it has.

    Raises
    ------
    NotRewritable    there are more or fewer, and it is a part of others
    """
    old = values_of(doc, item)
    if old.size == values.size and np.array_equal(
            old.ravel(), values.ravel(), equal_nan=old.dtype.kind == "f"):
        return
    part = slab(doc, item)
    if part is not None:
        whole = values_of(doc, part[0]).copy()
        if whole[part[1]].size != values.size:
            msg = "it keeps arrays of several steps in one, which has no room for more values"
            raise NotRewritable(msg)
        whole[part[1]] = values.reshape(whole[part[1]].shape)
        _put(doc, part[0], whole, names, edits)
        return
    shape = _shape(dimensions(item) or list(old.shape), len(old), values)
    if dimensions(item) and shape != dimensions(item):
        _attribute(doc, item, "Dimensions", " ".join(map(str, shape)), edits)
    if form_of(item) == "xml":
        start, end = _text(doc, item)
        edits.append((start, end, _written(doc.data[start:end], old, values)))
    elif form_of(item) == "hdf":
        place = stored(doc, item)
        _into_hdf(names[place.file], place.inside, values, len(old))
    else:
        _into_bytes(item, names[stored(doc, item).file], stored(doc, item).seek, old, values)


def _shape(stated: list[int], count: int, values: NDArray[Any]) -> list[int]:
    """The shape of values in the form of another one, of which one length was a count."""
    shape = list(stated)
    if int(np.prod(shape)) != values.size:
        at = shape.index(count) if count in shape else 0
        shape[at] = 1
        shape[at] = values.size // max(int(np.prod(shape)), 1)
    return shape


def _written(text: bytes, old: NDArray[Any], values: NDArray[Any]) -> bytes:
    """Write new values into the text of an array; the words of unchanged values stay."""
    def word(value: Any) -> bytes:
        if values.dtype.kind == "f":
            exact = np.asarray(value, dtype=old.dtype)
            return (repr(float(exact)) if old.dtype.itemsize > 4 else str(exact[()])).encode()
        return str(int(value)).encode()

    if old.size == values.size:
        same = old.ravel() == values.ravel()
        new = iter(zip(same.tolist(), values.ravel(), strict=True))

        def replaced(match: re.Match[bytes]) -> bytes:
            stays, value = next(new)
            return match[0] if stays else word(value)

        return re.sub(rb"\S+", replaced, text)
    head = re.match(rb"\s*", text)
    space = head[0] if head and head[0] else b"\n"
    rows = values.reshape(len(values), -1)
    lines = [b" ".join(word(value) for value in row) for row in rows]
    return space + space.join(lines) + text[len(text.rstrip()):]


def _into_hdf(path: Path, inside: str, values: NDArray[Any], count: int) -> None:
    """Give data of a file of HDF5 other values, with the type, attributes and filters they have."""
    import h5py

    with h5py.File(path, "r+") as file:
        data = file[inside]
        shape = tuple(_shape(list(data.shape), count, values))
        if shape == data.shape:
            data[...] = values.reshape(shape).astype(data.dtype)
            return
        attributes = [(key, data.attrs[key], data.attrs.get_id(key).dtype) for key in data.attrs]
        options = {"dtype": data.dtype, "compression": data.compression,
                   "compression_opts": data.compression_opts, "shuffle": data.shuffle or None,
                   "fletcher32": data.fletcher32 or None}
        options = {key: value for key, value in options.items() if value is not None}
        if data.chunks is not None:
            options["chunks"] = tuple(map(min, data.chunks, (max(size, 1) for size in shape)))
            options["maxshape"] = tuple(
                None if most is None else max(size, 0)
                for most, size in zip(data.maxshape, shape, strict=True))
        del file[inside]
        made = file.create_dataset(inside, data=values.reshape(shape), **options)
        for key, value, dtype in attributes:
            made.attrs.create(key, value, dtype=dtype)


def _into_bytes(item: Any, path: Path, seek: int, old: NDArray[Any], values: NDArray[Any]) -> None:
    """Write numbers at their place in a file of bytes.

    Raises
    ------
    NotRewritable    there are more or fewer, and others behind them
    """
    kind = type_of(item)
    data = bytearray(path.read_bytes())
    end = seek + old.size * kind.itemsize
    if old.size != values.size and end != len(data):
        msg = f"{path.name} holds other data behind those that changed"
        raise NotRewritable(msg)
    data[seek:end] = values.ravel().astype(kind).tobytes()
    path.write_bytes(data)
