"""Exodus files written into themselves: all but points and cells that changed is copied."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.change import Change, NotRewritable
from odt_plugins.adapters.formats.decks import indices
from odt_plugins.adapters.formats.exodus import (
    AXES,
    Block,
    Sides,
    blocks_of,
    node_sets_of,
    raw,
    side_sets_of,
    size_of,
)
from odt_plugins.adapters.formats.exodus_factors import continued
from odt_plugins.adapters.formats.exodus_tables import (
    CORNERS,
    ORDER,
    components,
    facets_in,
    side_of,
    step_names,
    texts,
)

UNKNOWN = ("num_ed_blk", "num_fa_blk", "num_edge_sets", "num_face_sets", "num_edge", "num_face")
"""Dimensions of parts that refer to elements in ways that are not known here."""


def rewrite(source: Path, target: Path, change: Change) -> list[str]:
    """Copy all dimensions, attributes and variables; those of what changed have other values."""
    import netCDF4

    with netCDF4.Dataset(str(source)) as old:
        raw(old)
        if old.groups or old.cmptypes or old.vltypes or old.enumtypes:
            msg = "it has groups or types of its own"
            raise NotRewritable(msg)
        values, sizes = _changed(old, change)
        with netCDF4.Dataset(str(target), "w", format=old.data_model) as new:
            raw(new)
            new.setncatts({name: old.getncattr(name) for name in old.ncattrs()})
            for name, dim in old.dimensions.items():
                new.createDimension(name, None if dim.isunlimited() else sizes.get(name, len(dim)))
            for name, variable in old.variables.items():
                _copy(new, name, variable, sizes, values)
    return []


def _copy(new: Any, name: str, variable: Any, sizes: Any, values: Any) -> None:
    """Make a variable as it is, with other values where it has some, packed in the same way."""
    attributes = {key: variable.getncattr(key) for key in variable.ncattrs()}
    options: dict[str, Any] = {"fill_value": attributes.pop("_FillValue", None)}
    packing = variable.filters()
    if packing is not None and variable.dimensions:
        chunks = variable.chunking()
        same = not set(variable.dimensions) & set(sizes)
        options |= {"compression": "zlib" if packing.get("zlib") else None,
                    "complevel": packing.get("complevel") or 4,
                    "shuffle": bool(packing.get("shuffle")),
                    "fletcher32": bool(packing.get("fletcher32")), "endian": variable.endian(),
                    "contiguous": chunks == "contiguous" and not packing.get("zlib")}
        if same and chunks != "contiguous":
            options["chunksizes"] = chunks
    made = new.createVariable(name, variable.dtype, variable.dimensions, **options)
    made.setncatts(attributes)
    made.set_auto_maskandscale(False)
    data = values.get(name)
    data = variable[...] if data is None else data
    if np.size(data):
        made[...] = data


def _changed(file: Any, change: Change) -> tuple[dict[str, Any], dict[str, int]]:
    """Values of the variables that are to be other ones, and sizes of the dimensions.

    Raises
    ------
    NotRewritable    something in the file refers to cells or points in ways that are not known
    """
    blocks = blocks_of(file)
    points = np.asarray(change.after.points)
    sides = side_sets_of(file, blocks, points.shape[1] == 3)
    rows = {b.number: change.cells[i] for i, b in enumerate(blocks)}
    moved = [len(rows[b.number]) != len(b.rows) or bool(change.exchanged(i).any())
             or not np.array_equal(rows[b.number], np.arange(len(b.rows)))
             for i, b in enumerate(blocks)]
    strange = [name for name in UNKNOWN if size_of(file, name)]
    if strange and (any(moved) or change.renumbered):
        msg = f"it has {', '.join(strange)}"
        raise NotRewritable(msg)
    source = np.concatenate([np.zeros(0, dtype=np.int64), *(
        b.start + rows[b.number] for b in blocks)])
    starts = np.cumsum([0, *(len(rows[b.number]) for b in blocks)])[:-1]
    values: dict[str, Any] = {}
    sizes: dict[str, int] = {}
    for name, variable in file.variables.items():
        taken = _taken(variable, name, change, rows, source)
        if taken is not None:
            values[name] = taken
    _write_points(file, points, values)
    for i, block in enumerate(blocks):
        nodes = np.asarray(change.after.cells[i].data) + 1
        nodes = nodes[:, ORDER[block.kind]] if block.kind in ORDER else nodes
        values[f"connect{block.number + 1}"] = nodes
        sizes[f"num_el_in_blk{block.number + 1}"] = len(nodes)
    sizes |= {"num_elem": len(source), "num_nodes": len(points)}
    _write_arrays(file, change, blocks, values, sizes)
    _write_numbers(source, change, values)
    _write_node_sets(file, change, values, sizes)
    _write_sets(file, source, values, sizes)
    _write_side_sets(file, change, (blocks, sides), starts, source, values, sizes)
    return values, {name: size for name, size in sizes.items()
                    if name in file.dimensions and size != size_of(file, name)}


def _taken(variable: Any, name: str, change: Change, rows: Any, source: Any) -> Any:
    """Values of a variable that has a row for each element or node; None of others."""
    axes = [(axis, dim) for axis, dim in enumerate(variable.dimensions)
            if dim in ("num_elem", "num_nodes") or dim.startswith("num_el_in_blk")]
    if not axes:
        return None
    data = np.asarray(variable[...])
    for axis, dim in axes:
        if dim == "num_nodes" and not change.renumbered:
            continue
        if dim == "num_nodes":
            if (change.points < 0).any() and not re.match("vals_nod_var|coord|node_num_map", name):
                msg = f"points were added, and it has {name}"
                raise NotRewritable(msg)
            data = data.take(change.points, axis=axis)
        elif dim == "num_elem":
            data = data.take(source, axis=axis)
        else:
            b = int(dim.removeprefix("num_el_in_blk")) - 1
            data = data.take(rows[b], axis=axis) if b in rows else data
    return data


def _write_points(file: Any, points: NDArray[Any], values: dict[str, Any]) -> None:
    if "coord" in file.variables:
        values["coord"] = points.T
        return
    for i in range(points.shape[1]):
        values[f"coord{AXES[i].lower()}"] = points[:, i]


def _write_arrays(
    file: Any, change: Change, blocks: list[Block], values: dict[str, Any], sizes: dict[str, int]
) -> None:
    """Variables of nodes and elements at all steps."""
    steps = size_of(file, "time_step")
    names = texts(file.variables.get("name_nod_var"), size_of(file, "num_nod_var"))
    for name, places in components(names).items() if steps else ():
        titles = step_names(name, steps)
        if any(title not in change.before.point_data or title not in change.after.point_data
               for title in titles):
            continue
        whole = np.stack([np.asarray(change.after.point_data[title]) for title in titles])
        for j, i in enumerate(places):
            part = whole if len(places) == 1 else whole[:, :, j]
            own = f"vals_nod_var{i + 1}"
            if own in file.variables:
                values[own] = part
                sizes[file.variables[own].dimensions[1]] = part.shape[1]
            else:
                table = values.setdefault(
                    "vals_nod_var", np.asarray(file.variables["vals_nod_var"][:]))
                table[:, i] = part
    names = texts(file.variables.get("name_elem_var"), size_of(file, "num_elem_var"))
    for name, places in components(names).items():
        titles = step_names(name, steps)
        if any(title not in change.after.cell_data for title in titles):
            continue
        for k, block in enumerate(blocks):
            tables = [np.asarray(change.after.cell_data[title][k]) for title in titles]
            for j, i in enumerate(places):
                own = f"vals_elem_var{i + 1}eb{block.number + 1}"
                if own in values and titles:
                    values[own] = np.stack([x if len(places) == 1 else x[:, j] for x in tables])


def _write_numbers(source: NDArray[Any], change: Change, values: dict[str, Any]) -> None:
    """Give cells and points that stand for none of before numbers that nobody else has."""
    for name, of in (("elem_num_map", source), ("node_num_map", change.points)):
        if name not in values:
            continue
        numbers = np.array(values[name])
        _, first = np.unique(of, return_index=True)
        fresh = np.ones(len(of), dtype=np.bool_)
        fresh[first] = False
        fresh |= of < 0
        numbers[fresh] = numbers.max(initial=0) + 1 + np.arange(fresh.sum())
        values[name] = numbers
    if "elem_map" in values:
        values["elem_map"] = np.arange(1, len(source) + 1)


def _write_node_sets(
    file: Any, change: Change, values: dict[str, Any], sizes: dict[str, int]
) -> None:
    """Renumber the nodes of sets, and add new ones, with what the file tells of the nearest."""
    from scipy.spatial import cKDTree

    if not change.renumbered:
        return
    number, places = change.number, np.asarray(change.after.points)
    titles = iter(node_sets_of(file, len(change.before.points)))
    for k in range(size_of(file, "num_node_sets")):
        nodes = file.variables.get(f"node_ns{k + 1}")
        if nodes is None:
            continue
        new = number[np.asarray(nodes[:]).astype(np.int64) - 1]
        kept = np.flatnonzero(new >= 0)
        own = indices(change.after.point_sets.get(next(titles), []))
        added = own[change.points[own] < 0]
        near = np.zeros(0, dtype=np.int64)
        if len(kept):
            near = np.asarray(cKDTree(places[new[kept]]).query(places[added])[1])
        rows = np.concatenate([kept, kept[near]])
        values[f"node_ns{k + 1}"] = np.concatenate([new[kept], added[: len(near)]]) + 1
        if len(rows) != len(new) or len(kept) < len(new):
            _thin(file, nodes.dimensions[0], (f"dist_fact_ns{k + 1}",), rows, values, sizes)


def _write_sets(
    file: Any, source: NDArray[Any], values: dict[str, Any], sizes: dict[str, int]
) -> None:
    """Let sets of elements have all the cells whose data come from their elements."""
    for k in range(size_of(file, "num_elem_sets")):
        name = f"elem_els{k + 1}"
        elements = file.variables.get(name)
        if elements is None:
            continue
        members = np.asarray(elements[:]).astype(np.int64) - 1
        order = np.argsort(members, kind="stable")
        inside = np.flatnonzero(np.isin(source, members))
        from_row = order[np.searchsorted(members[order], source[inside])]
        again = np.lexsort((inside, from_row))
        values[name] = inside[again] + 1
        _thin(file, elements.dimensions[0], (f"dist_fact_els{k + 1}",), from_row[again], values,
              sizes)


def _thin(
    file: Any, dimension: str, others: tuple[str, ...], rows: NDArray[Any],
    values: dict[str, Any], sizes: dict[str, int],
) -> None:
    """Take rows of all variables of a dimension, and of some of the same length."""
    length = size_of(file, dimension)
    sizes[dimension] = len(rows)
    for name, variable in file.variables.items():
        dims = variable.dimensions
        own = name in others and len(dims) == 1 and len(variable) == length
        if name in values or not (dimension in dims or own):
            continue
        axis = dims.index(dimension) if dimension in dims else 0
        sizes[dims[axis]] = len(rows)
        values[name] = np.asarray(variable[...]).take(rows, axis=axis)


def _write_side_sets(
    file: Any, change: Change, parts: tuple[list[Block], list[Sides]], starts: Any,
    source: NDArray[Any], values: dict[str, Any], sizes: dict[str, int],
) -> None:
    """Write the side sets with the elements and sides that the old sides have become.

    Faces of shells follow the cells whose data come from their elements.

    Raises
    ------
    NotRewritable    a side is of no element any more, or factors of sides that became others differ
    """
    blocks, sides = parts
    space = np.asarray(change.after.points).shape[1] == 3
    for k in range(size_of(file, "num_side_sets")):
        variable = file.variables.get(f"elem_ss{k + 1}")
        if variable is None:
            continue
        elements = np.asarray(variable[:]).astype(np.int64) - 1
        own = [(j, part) for j, part in enumerate(sides, len(blocks)) if part.number == k]
        named = np.concatenate([np.zeros(0, np.int64), *(part.places for _, part in own)])
        place = np.concatenate([np.setdiff1d(np.arange(len(elements)), named),
                                *(part.places[change.cells[j]] for j, part in own)])
        new_element = np.full(len(place), -1)
        new_side = np.asarray(file.variables[f"side_ss{k + 1}"][:]).astype(np.int64)[place] - 1
        orders: dict[int, Any] = {}
        first = len(elements) - len(named)
        for j, part in own:
            now = np.asarray(change.after.cells[j].data).astype(np.int64)
            old = elements[place[first: first + len(now)]]
            first += len(now)
            known = np.zeros(len(now), dtype=np.bool_)
            found = known.copy()
            for anywhere, i in [(False, i) for i in range(len(blocks))] + [
                    (True, i) for i in range(len(blocks))]:
                block = blocks[i]
                inside = (old >= block.start) & (old < block.start + len(block.rows))
                known |= inside
                mine = np.flatnonzero((known & ~found) if anywhere else inside)
                if not len(mine):
                    continue
                rows = np.asarray(change.after.cells[i].data).astype(np.int64)
                cell, side = facets_in(now[mine][:, : CORNERS[part.kind]], rows, block.kind,
                                       shell=space)
                mine, cell, side = mine[cell >= 0], cell[cell >= 0], side[cell >= 0]
                here = first - len(now) + mine
                found[mine] = True
                new_element[here], new_side[here] = cell + starts[i], side
                orders |= {e: (now[q], rows[c], block.kind, s) for e, q, c, s in zip(
                    here.tolist(), mine.tolist(), cell.tolist(), side.tolist(), strict=True)}
            if (known & ~found).any():
                lost = place[first - len(now) + np.flatnonzero(known & ~found)[0]] + 1
                msg = f"side {lost} of side set {k + 1} is none any more"
                raise NotRewritable(msg)
        order = np.argsort(place, kind="stable")
        place, new_element, new_side = place[order], new_element[order], new_side[order]
        orders = {e: orders[old] for e, old in enumerate(order.tolist()) if old in orders}
        low, high = (np.searchsorted(source, elements[place], side=end)  # type: ignore[call-overload]
                     for end in ("left", "right"))
        times = np.where(new_element < 0, high - low, 1)
        entry = np.repeat(np.arange(len(place)), times)
        within = np.arange(len(entry)) - np.repeat(np.cumsum(times) - times, times)
        new = np.where(new_element[entry] < 0, low[entry] + within, new_element[entry])
        values[f"elem_ss{k + 1}"], values[f"side_ss{k + 1}"] = new + 1, new_side[entry] + 1
        at = place[entry]
        factors = file.variables.get(f"dist_fact_ss{k + 1}")
        given = np.asarray([] if factors is None else factors[:])
        same = np.array_equal(at, np.arange(len(elements)))
        if given.size:
            nodes = {e: row for _, part in own for e, row in zip(
                part.places.tolist(), part.rows, strict=True)}
            new_factors = continued(given, len(elements), [
                (e, nodes.get(e), orders.get(i)) for e, i in zip(
                    at.tolist(), entry.tolist(), strict=True)], change, space)
            if new_factors is None and same and len(orders) == len(elements):
                new_factors = _turned_factors(
                    given, [orders[e] for e in range(len(elements))], space)
            if new_factors is None and not same:
                msg = f"factors in side set {k + 1} differ, and its sides became others"
                raise NotRewritable(msg)
            if new_factors is not None:
                values[f"dist_fact_ss{k + 1}"] = new_factors
                sizes[factors.dimensions[0]] = len(new_factors)
        if not same:
            _thin(file, variable.dimensions[0], (), at, values, sizes)


def _turned_factors(factors: NDArray[Any], orders: list[Any], space: bool) -> NDArray[Any]:
    """Factors of the nodes of sides, in the order in which the sides have their nodes now."""
    if sum(len(before) for before, *_ in orders) != len(factors):
        return factors
    out, at = factors.copy(), 0
    for before, cell, kind, side in orders:
        known = side_of(kind, side, shell=space)
        now = [] if known is None else np.asarray(cell)[known[1]].tolist()
        place = {node: i for i, node in enumerate(before.tolist())}
        if set(now) == set(place):
            out[at: at + len(before)] = factors[at + np.array([place[node] for node in now])]
        at += len(before)
    return out
