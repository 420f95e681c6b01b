"""A mesh as it was to be written and as its file holds it: what is gone, by name."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.fitting import group_names, named_groups
from odt_plugins.adapters.formats import gmsh_tables
from odt_plugins.adapters.formats.decks import indices
from odt_plugins.adapters.gmsh_files import same_names
from odt_plugins.adapters.regions import are_whole
from odt_plugins.errors import counted

FAMILIES = ("cell_tags", "point_tags")
"""Numbers of the families of MED files, which are others in another file of the same groups."""

DERIVED = ("Normals", "texcoord")
"""Arrays that are computed anew for the surface, in the digits of its file."""

ROUNDED = 1e-7
"""Part of the largest coordinate by which coordinates may be rounded."""

ALMOST = 1e-4
"""Relative difference up to which a number was rounded."""


def not_kept(mesh: Any, back: Any) -> list[str]:
    """Name the data that did not come back, and those that did under another name.

    Formats may put the points in another order: .msh has those of one entity together.
    """
    lost = []
    renamed = []
    d = min(mesh.points.shape[1], back.points.shape[1])
    old, new = mesh.points[:, :d], back.points[:, :d]
    if not np.array_equal(old, new):
        one, two = np.unique(old, axis=0), np.unique(new, axis=0)
        fewer = len(one) - len(two)
        if fewer > 0 and len(np.unique(np.concatenate([one, two]), axis=0)) == len(one):
            lost.append(f"{counted(fewer, 'point')} of no cell")
        elif not np.array_equal(one, two, equal_nan=True):
            lost.append("the last digits of the coordinates")
    groups = group_names(mesh)
    families = {name for names in getattr(back, "cell_tags", {}).values() for name in names}
    missing = groups - {*back.cell_sets, *back.field_data, *families}
    missing -= {name for name in back.point_sets if name not in mesh.point_sets}
    named = _sets_as_groups(mesh, back)
    for kind in ("point_data", "cell_data", "field_data", "point_sets", "cell_sets"):
        old, new = getattr(mesh, kind), getattr(back, kind)
        what = kind.replace("_", " ")
        gone = set(old) - set(new) - set(gmsh_tables.BOOKKEEPING)
        if kind in ("field_data", "cell_sets"):
            gone -= groups.union(*(tags for tags in same_names(mesh.field_data)
                                   if next(iter(tags)) in groups))
        if kind == "cell_sets":
            gone -= named
        if set(mesh.cell_sets) <= {*back.cell_sets, *back.cell_data, *named}:
            gone -= {*FAMILIES}
        if gmsh_tables.PHYSICAL in mesh.cell_data:
            gone -= {gmsh_tables.ENTITY}
            gone -= {gmsh_tables.PHYSICAL} if groups and groups <= {*back.cell_sets} else set()
        for name in sorted(gone if kind in ("point_data", "cell_data") else ()):
            values = _by_type(mesh, old[name])
            others = {n: _by_type(back, new[n]) for n in sorted(
                set(new) - set(old), key=lambda name: (name == gmsh_tables.ENTITY, name))}
            # Families of cells have the negative numbers of their labels.
            if FAMILIES[0] in (name, *others):
                values, others = _unsigned(values), {n: _unsigned(others[n]) for n in others}
            ordered = _in_order(mesh, back, cells=kind == "cell_data")
            same = {n: _same(values, others[n], ordered=ordered) for n in others}
            other = next((n for n in others if same[n] == set(others[n])), None)
            best = other or max(others, key=lambda n: len(same[n]), default="")
            kept = same[best] if best else set()
            # Zeros alone are those of any array.
            kept = kept if other or any(values[key].any() for key in kept) else set()
            if kept:
                gone.discard(name)
                renamed.append(f"the name of {what} {name!r} (there {best!r})")
            elif other := next((n for n in others if ordered and _renumbered(values, others[n])),
                               None):
                gone.discard(name)
                renamed.append(f"the numbers of {what} {name!r} (others in {other!r})")
            if kept and not other:
                rest = sorted(key for key in set(values) - kept if values[key].any())
                other_numbers = ordered and _renumbered({key: values[key] for key in rest},
                                                        others[best])
                said = "the numbers of " * other_numbers + f"{what} {name!r} of "
                lost += [said + " and ".join(rest)] * bool(rest)
        lost += _others(mesh, back, kind, what)
        # The formats of VTK have arrays in place of sets.
        arrays = "_sets" in kind and gone <= set(getattr(back, kind.replace("_sets", "_data")))
        if gone:
            lost.append(f"{what} {', '.join(map(repr, sorted(gone)))}"
                        + " (arrays of 0 and 1 there)" * arrays)
    if _periodic(mesh) and not _periodic(back):
        lost.append("which points of periodic faces correspond")
    if missing:
        lost.append(f"the names of the groups {', '.join(map(repr, sorted(missing)))}")
    return lost + renamed


def _sets_as_groups(mesh: Any, back: Any) -> set[str]:
    """Cell sets that are named groups of as many cells in the file."""
    groups = named_groups(back)
    return {name for name, members in mesh.cell_sets.items() if name in groups
            and _members(members) == _members(groups[name])}


def _members(members: Any) -> int:
    """Cells of a set."""
    return sum(len(indices(rows)) for rows in members)


def _unsigned(arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Arrays whose whole numbers have no sign."""
    return {key: np.abs(values) if values.dtype.kind == "i" else values
            for key, values in arrays.items()}


def _periodic(mesh: Any) -> bool:
    """Whether a mesh tells of points that correspond, as files of Gmsh and Netgen do."""
    known = getattr(mesh, "identified", None)
    return bool(getattr(mesh, "gmsh_periodic", None)) or (known is not None and len(known) > 0)


def _others(mesh: Any, back: Any, kind: str, what: str) -> list[str]:
    """Name the arrays and sets that came back with other values or members."""
    old, new = getattr(mesh, kind), getattr(back, kind)
    out = []
    ordered = _in_order(mesh, back, cells=kind == "cell_data")
    for name in sorted((set(old) & set(new)) - {*gmsh_tables.BOOKKEEPING, *FAMILIES}):
        if kind.endswith("_sets"):
            sizes = [_members(part if kind == "cell_sets" else [part])
                     for part in (old[name], new[name])]
            if sizes[0] > sizes[1] or not (
                    sizes[0] == sizes[1] or _keys(mesh, back, kind, old[name]) < _keys(
                        back, mesh, kind, new[name])):
                out.append(f"{sizes[0]} members of {what[:-1]} {name!r} (there {sizes[1]})")
            continue
        if kind == "field_data":
            was, now = {"": np.asarray(old[name])}, {"": np.asarray(new[name])}
        else:
            was, now = _by_type(mesh, old[name]), _by_type(back, new[name])
        found = {key: _difference(was[key], now[key], ordered=ordered or kind == "field_data")
                 for key in sorted(set(was) & set(now))}
        for worst in sorted(set(found.values()) - {0} - ({1} if name in DERIVED else set())):
            kinds = [key for key in found if found[key] == worst]
            rest = f" of {' and '.join(kinds)}" if len(kinds) < len(found) else ""
            out.append(f"{('the last digits', 'the values')[worst - 1]} of {what} {name!r}{rest}")
    return out


def _keys(mesh: Any, other: Any, kind: str, members: Any) -> set[Any]:
    """Members of a set, by their numbers where points are in one order, or else by their places."""
    same = mesh.points.shape == other.points.shape and np.allclose(mesh.points, other.points)
    spots = np.arange(len(mesh.points)).reshape(-1, 1) if same else np.asarray(mesh.points)
    if kind == "point_sets":
        return set(map(tuple, spots[indices(members)].tolist()))
    return {tuple(sorted(map(tuple, corners)))
            for block, part in zip(mesh.cells, members, strict=True)
            for corners in spots[np.asarray(block.data)[indices(part)]].tolist()}


def _in_order(mesh: Any, back: Any, *, cells: bool) -> bool:
    """Whether points, or the cells of each type, are in the same order."""
    one, two = _in_space(mesh), _in_space(back)
    if one.shape != two.shape or not np.allclose(one, two, rtol=0.0, atol=ROUNDED * abs(
            one).max(initial=0.0)):
        return False
    both = [_by_type(one, [np.sort(block.data, axis=1) for block in one.cells])
            for one in (mesh, back)] if cells else [{}, {}]
    return all(np.array_equal(both[0][kind], both[1][kind]) for kind in set(both[0]) & set(both[1]))


def _in_space(mesh: Any) -> NDArray[Any]:
    """Places with as many coordinates as differ from 0."""
    points = np.asarray(mesh.points)
    return points[:, :2] if points.shape[1] == 3 and not points[:, 2].any() else points


def _difference(old: NDArray[Any], new: NDArray[Any], *, ordered: bool) -> int:
    """How much values differ: 0 not at all, 1 by rounding, 2 otherwise; in any order if need be."""
    if old.dtype.kind == "c" and new.dtype.kind == "f":
        old = np.stack([old.real, old.imag], axis=-1)
    if old.size != new.size or old.dtype.kind not in "biufc" or new.dtype.kind not in "biufc":
        return 2 * (old.size != new.size or not np.array_equal(old.astype(str).ravel(),
                                                               new.astype(str).ravel()))
    rows = len(old) if old.ndim else 1
    one, two = old.reshape(rows, -1), new.reshape(rows, -1)
    if not ordered:
        one, two = np.sort(one, axis=0), np.sort(two, axis=0)
    if np.array_equal(one, two, equal_nan="f" in one.dtype.kind + two.dtype.kind):
        kinds = {one.dtype.kind, two.dtype.kind}
        # Whole numbers become floating-point ones where they are held against such.
        exact = "f" not in kinds or not kinds & {*"iu"} or one.astype(object) == two.astype(object)
        return 0 if np.all(exact) else 1
    if one.dtype.kind not in "fc" and two.dtype.kind not in "fc":
        return 2
    with np.errstate(all="ignore"):
        size = np.abs(np.nan_to_num(one.astype(np.float64))).max(initial=0)
        close = np.allclose(one.astype(np.float64), two.astype(np.float64), rtol=ALMOST,
                            atol=ALMOST * size, equal_nan=True)
    return 1 if close else 2


def _by_type(mesh: Any, values: Any) -> dict[str, NDArray[Any]]:
    """Cell data of the blocks of each type, one after another; point data as they are."""
    if not isinstance(values, list):
        return {"": np.asarray(values)}
    kinds = sorted({block.type for block in mesh.cells})
    return {kind: np.concatenate([np.asarray(part) for block, part in
                                  zip(mesh.cells, values, strict=True) if block.type == kind])
            for kind in kinds}


def _same(
    one: dict[str, NDArray[Any]], two: dict[str, NDArray[Any]], *, ordered: bool
) -> set[str]:
    """Types of cells with the same values, in any order if need be."""
    return {kind for kind in set(one) & set(two) if one[kind].size == two[kind].size
            and not _difference(one[kind], two[kind], ordered=ordered)}


def _renumbered(one: dict[str, NDArray[Any]], two: dict[str, NDArray[Any]]) -> bool:
    """Whether whole numbers tell cells of each type apart as others do, into several parts."""
    found = 0
    for kind in set(one) & set(two):
        both = one[kind], two[kind]
        if any(part.dtype.kind not in "biuf" or not are_whole(part) or part.size != len(both[0])
               for part in both):
            return False
        old, new = (np.unique(part.ravel(), return_inverse=True)[1] for part in both)
        pairs = np.unique(np.stack([old, new]), axis=1)
        if not len(pairs[0]) == len(np.unique(pairs[0])) == len(np.unique(pairs[1])):
            return False
        found = max(found, len(pairs[0]))
    return found > 1


def other_types(mesh: Any, back: Any) -> list[str]:
    """Name the arrays that came back with values of another type."""
    other = []
    for kind in ("point_data", "cell_data"):
        old, new = getattr(mesh, kind), getattr(back, kind)
        for name in sorted(set(old) & set(new)):
            was, now = _one_array(old[name]).dtype, _one_array(new[name]).dtype
            if now.newbyteorder("=") != was.newbyteorder("=") and was.kind not in "US":
                what = kind.replace("_", " ")
                other.append(f"the type of {what} {name!r} ({was}, there {now})")
    return other


def _one_array(values: Any) -> NDArray[Any]:
    """Point data, or the cell data of all blocks one after another."""
    return np.concatenate(values) if isinstance(values, list) and values else np.asarray(values)
