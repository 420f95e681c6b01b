"""New Exodus files: labels are ids of blocks and side sets, cell sets names or element sets."""

from __future__ import annotations

from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.decks import alike, indices
from odt_plugins.adapters.formats.exodus import BLOCK, SIDE
from odt_plugins.adapters.formats.exodus_tables import CORNERS, ORDER, WORDS, facets_in
from odt_plugins.errors import UnsupportedMeshError

LARGEST = 2**31 - 1
"""Largest id of a block or a side set."""

ENDS = {2: ("_R", "_Z"), 3: ("X", "Y", "Z")}
"""Ends of the names of the components of arrays of so many."""

LETTERS = 33
"""Least length of names."""


class _Part(NamedTuple):
    """Cells of one block and one label: the block, their rows in it, and the label."""

    block: int
    rows: NDArray[np.int64]
    label: int


def write(path: Path, mesh: Any, binary: bool | None) -> list[str]:
    """Write blocks of elements, one for each block and label, and sides as side sets.

    Lines, triangles and quadrilaterals that are sides of cells of a higher dimension become side
    sets, one for each label. Arrays are variables at a time of 0.

    Raises
    ------
    UnsupportedMeshError    the format does not hold such cells
    """
    import netCDF4

    del binary
    labels = _labels(mesh)
    top = max((block.dim for block in mesh.cells), default=0)
    parts: list[_Part] = []
    skin: list[_Part] = []
    found = [None if block.dim == top or block.type not in CORNERS
             else _sides(mesh, i, top) for i, block in enumerate(mesh.cells)]
    for i, block in enumerate(mesh.cells):
        if block.type not in WORDS:
            msg = f"it holds no cells of type {block.type}"
            raise UnsupportedMeshError(msg)
        for label in dict.fromkeys(labels[i].tolist()):
            part = _Part(i, np.flatnonzero(labels[i] == label), label)
            (parts if found[i] is None else skin).append(part)
    starts = np.cumsum([0, *(len(part.rows) for part in parts)])
    place = {(part.block, row): start + k for part, start in zip(parts, starts, strict=False)
             for k, row in enumerate(part.rows.tolist())} if skin else {}
    with netCDF4.Dataset(str(path), "w") as file:
        file.set_auto_maskandscale(False)
        file.setncatts({"title": "mesh", "version": np.float32(5.1),
                        "api_version": np.float32(5.1), "floating_point_word_size": np.int32(8),
                        "file_size": np.int32(1)})
        for name, size in {"num_nodes": len(mesh.points), "num_dim": mesh.points.shape[1],
                           "num_elem": int(starts[-1]), "num_el_blk": len(parts), "len_line": 81,
                           "len_string": _longest(mesh), "four": 4, "time_step": None}.items():
            file.createDimension(name, size)
        _put(file, "time_whole", ("time_step",), np.zeros(1))
        _strings(file, "coor_names", "num_dim", list("xyz"[: mesh.points.shape[1]]))
        for i in range(mesh.points.shape[1]):
            _put(file, f"coord{'xyz'[i]}", ("num_nodes",), np.asarray(mesh.points[:, i], float))
        named = _blocks(file, mesh, parts)
        _side_sets(file, mesh, skin, found, place)
        _element_sets(file, mesh, parts, named, starts)
        _node_sets(file, mesh)
        _variables(file, "nod", "num_nod_var", _columns(mesh.point_data), [
            ("num_nodes", "", lambda values: values)])
        arrays = {name: values for name, values in mesh.cell_data.items()
                  if name not in (BLOCK, SIDE)}
        _variables(file, "elem", "num_elem_var", _columns(arrays), [
            (f"num_el_in_blk{k + 1}", f"eb{k + 1}", _of_part([part]))
            for k, part in enumerate(parts)])
        sets = _by_label(skin)
        if sets:
            _variables(file, "sset", "num_sset_var", _columns(arrays), [
                (f"num_side_ss{k + 1}", f"ss{k + 1}", _of_part(own))
                for k, own in enumerate(sets.values())])
    return []


def _labels(mesh: Any) -> list[NDArray[np.int64]]:
    """Label of every cell: ids of blocks and sides, else a number for every choice of sets."""
    if BLOCK not in mesh.cell_data:
        return _choices(mesh)
    sides = mesh.cell_data.get(SIDE, mesh.cell_data[BLOCK])
    out = [np.where(np.asarray(own) == 0, np.asarray(side), np.asarray(own)).astype(np.int64)
           for own, side in zip(mesh.cell_data[BLOCK], sides, strict=True)]
    dims = [block.dim for block in mesh.cells]
    bare = [not any(part.any() for part, other in zip(out, dims, strict=True) if other == dim)
            for dim in dims]
    if any(bare) and mesh.cell_sets:
        highest = max((int(part.max(initial=0)) for part in out), default=0)
        choices = _choices(mesh)
        if highest + max(int(part.max(initial=0)) for part in choices) > LARGEST:
            highest = 0
        out = [part + highest if own else label
               for part, label, own in zip(choices, out, bare, strict=True)]
    return out


def _choices(mesh: Any) -> list[NDArray[np.int64]]:
    """A number from 1 on of every cell for the choice of sets that it is in, or for its block."""
    masks = [np.zeros((len(block.data), len(mesh.cell_sets)), dtype=np.bool_)
             for block in mesh.cells]
    for j, members in enumerate(mesh.cell_sets.values()):
        for mask, rows in zip(masks, members, strict=True):
            if rows is not None and len(rows):
                mask[np.asarray(rows), j] = True
    whole = np.concatenate(masks)
    first, inverse = alike(list(whole.T)) if whole.size else (np.zeros(0, dtype=np.int64),) * 2
    number = np.argsort(np.argsort(first)) + 1
    if not whole.size or len(first) > len(mesh.cells) + len(mesh.cell_sets):
        number, inverse = np.arange(len(mesh.cells)) + 1, np.repeat(
            np.arange(len(mesh.cells)), [len(block.data) for block in mesh.cells])
    ends = np.cumsum([len(block.data) for block in mesh.cells])[:-1]
    return np.split(number[inverse.ravel()], ends)


def _sides(mesh: Any, block: int, top: int) -> Any:
    """Block, cell and side of which every cell of a block is a side; None unless all are."""
    wanted = np.asarray(mesh.cells[block].data).astype(np.int64)
    wanted = wanted[:, : CORNERS[mesh.cells[block].type]]
    out = np.full((len(wanted), 3), -1, dtype=np.int64)
    for i, other in enumerate(mesh.cells):
        if other.dim != top or mesh.cells[block].dim != top - 1:
            continue
        shell = top == 2 and mesh.points.shape[1] == 3
        rows = np.asarray(other.data).astype(np.int64)
        cell, side = facets_in(wanted, rows, other.type, shell=shell)
        new = (out[:, 0] < 0) & (cell >= 0)
        out[new] = np.stack([np.full(len(cell), i), cell, side], axis=1)[new]
    return out if (out[:, 0] >= 0).all() and len(out) else None


def _put(file: Any, name: str, dims: tuple[str, ...], values: Any) -> Any:
    array = np.asarray(values)
    array = array.astype(np.int32) if array.dtype.kind in "iub" else array
    variable = file.createVariable(name, array.dtype, dims)
    variable[:] = array
    return variable


def _strings(file: Any, name: str, dimension: str, words: list[str]) -> None:
    length = len(file.dimensions["len_string"])
    table = np.zeros((len(words), length), dtype="S1")
    for i, word in enumerate(words):
        data = word.encode()[: length - 1]
        table[i, : len(data)] = np.frombuffer(data, dtype="S1")
    file.createVariable(name, "S1", (dimension, "len_string"))[:] = table


def _longest(mesh: Any) -> int:
    names = [*mesh.point_data, *mesh.cell_data, *mesh.cell_sets, *mesh.point_sets]
    return max([LETTERS, *(len(name.encode()) + 3 for name in names)])


def _ids(labels: list[int]) -> list[int]:
    """Ids that are positive and differ: labels where these are, else numbers behind them."""
    out: list[int] = []
    last = max([0, *labels])
    fresh = (k for k in count(last + 1 if last + len(labels) <= LARGEST else 1) if k not in labels)
    for label in labels:
        out.append(label if label > 0 and label not in out else next(fresh))
    return out


def _names(mesh: Any, groups: list[list[_Part]], *, whole: bool) -> list[str]:
    """Name of each group of cells: of a set that is it, or that it and others make up; else "".

    Parameters
    ----------
    mesh : meshio.Mesh
    groups : list of list of _Part
    whole : bool                      or also of one that these are a part of
    """
    found = {}
    blocks = {part.block for parts in groups for part in parts}
    group = [np.full(len(block.data), len(groups)) for block in mesh.cells]
    for k, parts in enumerate(groups):
        for part in parts:
            group[part.block][part.rows] = k
    sizes = np.array([sum(len(part.rows) for part in parts) for parts in groups], dtype=np.int64)
    for name, members in mesh.cell_sets.items():
        own = [indices(rows if i in blocks else []) for i, rows in enumerate(members)]
        of = np.concatenate([group[i][np.unique(rows)] for i, rows in enumerate(own)])
        inside = np.flatnonzero(np.bincount(of, minlength=len(groups) + 1)[:-1] == sizes).tolist()
        found[str(name)] = inside, sum(map(len, own)) == int(sizes[inside].sum())
    out = [""] * len(groups)
    for name in sorted(found, key=lambda name: (not found[name][1], len(found[name][0]))):
        inside, same = found[name]
        if same and not any(out[k] for k in inside):
            out = [name if k in inside else old for k, old in enumerate(out)]
    for name, (inside, _) in found.items() if not whole else ():
        out = [old or (name if k in inside else "") for k, old in enumerate(out)]
    return out


def _blocks(file: Any, mesh: Any, parts: list[_Part]) -> set[str]:
    """Write blocks of elements; the names that they got, of sets that they make up."""
    ids = _ids([part.label for part in parts])
    names = _names(mesh, [[part] for part in parts], whole=True)
    _put(file, "eb_status", ("num_el_blk",), np.ones(len(parts), dtype=np.int32))
    _put(file, "eb_prop1", ("num_el_blk",), ids).setncattr("name", "ID")
    _strings(file, "eb_names", "num_el_blk", names)
    for k, part in enumerate(parts, 1):
        block = mesh.cells[part.block]
        nodes = np.asarray(block.data)[part.rows] + 1
        nodes = nodes[:, ORDER[block.type]] if block.type in ORDER else nodes
        file.createDimension(f"num_el_in_blk{k}", len(nodes))
        file.createDimension(f"num_nod_per_el{k}", nodes.shape[1])
        dims = (f"num_el_in_blk{k}", f"num_nod_per_el{k}")
        _put(file, f"connect{k}", dims, nodes).setncattr("elem_type", WORDS[block.type])
    return set(names) - {""}


def _by_label(skin: list[_Part]) -> dict[int, list[_Part]]:
    out: dict[int, list[_Part]] = {}
    for part in skin:
        out.setdefault(part.label, []).append(part)
    return out


def _side_sets(
    file: Any, mesh: Any, skin: list[_Part], found: list[Any], place: dict[Any, int]
) -> None:
    """Write side sets, one a label."""
    sets = _by_label(skin)
    if not sets:
        return
    file.createDimension("num_side_sets", len(sets))
    names = _names(mesh, [*sets.values()], whole=False)
    _put(file, "ss_status", ("num_side_sets",), np.ones(len(sets), dtype=np.int32))
    _put(file, "ss_prop1", ("num_side_sets",), _ids([*sets])).setncattr("name", "ID")
    _strings(file, "ss_names", "num_side_sets", names)
    for k, parts in enumerate(sets.values(), 1):
        table = np.concatenate([found[part.block][part.rows] for part in parts]).tolist()
        file.createDimension(f"num_side_ss{k}", len(table))
        _put(file, f"elem_ss{k}", (f"num_side_ss{k}",),
             [place[block, cell] + 1 for block, cell, _ in table])
        _put(file, f"side_ss{k}", (f"num_side_ss{k}",), [side + 1 for *_, side in table])


def _element_sets(file: Any, mesh: Any, parts: list[_Part], named: set[str], starts: Any) -> None:
    """Write the cells in blocks of the other cell sets as sets of elements."""
    sets = {}
    number = [np.zeros(len(block.data), dtype=np.int64) for block in mesh.cells]
    for part, start in zip(parts, starts, strict=False):
        number[part.block][part.rows] = start + 1 + np.arange(len(part.rows))
    for name in mesh.cell_sets:
        if name not in named:
            own = np.unique(np.concatenate(
                [number[i][indices(rows)] for i, rows in enumerate(mesh.cell_sets[name])]))
            if own.any():
                sets[name] = own[own > 0]
    _put_sets(file, "elem", "els", sets)


def _node_sets(file: Any, mesh: Any) -> None:
    sets = {}
    for name, members in mesh.point_sets.items():
        given = np.asarray(members)
        nodes = np.flatnonzero(given) if given.dtype == np.bool_ else given.ravel()
        if len(nodes):
            sets[name] = nodes.astype(np.int64) + 1
    _put_sets(file, "node", "ns", sets)


def _put_sets(file: Any, what: str, kind: str, sets: dict[str, NDArray[np.int64]]) -> None:
    """Write sets of elements, "elem" and "els", or of nodes, "node" and "ns", if there are any."""
    if not sets:
        return
    count = f"num_{what}_sets"
    file.createDimension(count, len(sets))
    _put(file, f"{kind}_status", (count,), np.ones(len(sets), dtype=np.int32))
    _put(file, f"{kind}_prop1", (count,), np.arange(len(sets)) + 1).setncattr("name", "ID")
    _strings(file, f"{kind}_names", count, [*sets])
    for k, members in enumerate(sets.values(), 1):
        size = f"num_{what[:3]}_{kind}{k}"
        file.createDimension(size, len(members))
        _put(file, f"{what}_{kind}{k}", (size,), members)


def _columns(arrays: Any) -> dict[str, Any]:
    """Numbers of points, or of the cells of every block, by the names of their components."""
    out: dict[str, Any] = {}
    for name, values in arrays.items():
        parts = [np.asarray(part) for part in (values if isinstance(values, list) else [values])]
        if any(part.dtype.kind not in "iubf" or part.ndim > 2 for part in parts):
            continue
        if parts[0].ndim == 1:
            out[name] = parts
            continue
        width = parts[0].shape[1]
        for j, end in enumerate(ENDS.get(width, [f"_{j + 1}" for j in range(width)])):
            out[name + end] = [part[:, j] for part in parts]
    return out


def _of_part(parts: list[_Part]) -> Any:
    return lambda blocks: np.concatenate([blocks[part.block][part.rows] for part in parts])


def _variables(
    file: Any, what: str, dimension: str, columns: dict[str, Any],
    homes: list[tuple[str, str, Any]],
) -> None:
    """Write arrays as variables of nodes, elements or sides at the one time."""
    if not columns:
        return
    file.createDimension(dimension, len(columns))
    _strings(file, f"name_{what}_var", dimension, [*columns])
    if what != "nod":
        sizes = ("num_el_blk" if what == "elem" else "num_side_sets", dimension)
        _put(file, f"{what}_var_tab", sizes, np.ones((len(homes), len(columns)), dtype=np.int32))
    for i, blocks in enumerate(columns.values(), 1):
        for size, tail, of in homes:
            values = np.asarray(of(blocks if what != "nod" else blocks[0]), dtype=np.float64)
            variable = file.createVariable(f"vals_{what}_var{i}{tail}", "f8", ("time_step", size))
            variable[0] = values
