"""Labels out of sets of cells, and those that a tool takes, for formats that hold no sets."""

from __future__ import annotations

from itertools import chain, compress, count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.decks import indices
from odt_plugins.adapters.formats.gmsh_tables import BOOKKEEPING
from odt_plugins.adapters.gmsh_files import same_names
from odt_plugins.adapters.host import POINT_LABELS, classes_of
from odt_plugins.adapters.regions import REGION_ARRAYS, are_whole, is_known

SIDES = "exodus:side_set"
"""Labels of cells at a boundary beside those of blocks, which are 0 there."""

SETS, MED = ("abaqus", "cgns", "flac3d"), "med"
"""Formats that hold sets of cells, and no numbers of theirs; one of these with real numbers."""

PARTED = "cgns"
"""One of these whose sets have no cells in common."""

GROUPS = ("gmsh:physical", "netgen:index")
"""Labels that have names, of groups."""

LABELS = (*GROUPS, *REGION_ARRAYS, "exodus:block", "su2:tag")
"""Arrays of labels that become sets, before others whose name tells that they are labels."""

OF_SETS = "abaqus:elset"
"""One of these that a reader makes of the sets, which tell it."""

KINDS = ("Point", "Line", "Surface", "Volume")
"""What sets of labels are called, by dimension, as Gmsh calls its entities in such files."""

FEW, TWICE = 100, 2
"""Up to FEW labels become sets where there are TWICE as many cells, more where there are FEW times
as many."""

MOST = 2**31 - 1
"""Largest number of 32 bits, in groups of Gmsh and labels of Nastran."""

EXACT = 2**53
"""Largest number up to which floating-point numbers hold all whole ones."""

RANGES = {
    "nastran": (1, MOST), "netgen": (1, 99_999),
    **dict.fromkeys(("avsucd", "exodus", "gmsh", "gmsh22", "medit", "tetgen", "ugrid"),
                    (-MOST, MOST)),
}
"""Least and largest label that the tools of a format take.

Netgen has names and tables for all numbers up to the largest.
"""


def of_sets(
    mesh: Any, labels: list[NDArray[Any]] | None, *, families: bool = False
) -> list[NDArray[Any]] | None:
    """Labels whose cells without any in a dimension have those of side sets, or of their sets.

    A set whose cells are all those of one label gives the label its name, as a group.

    Parameters
    ----------
    mesh : meshio.Mesh      with one block a type; its field data get the names
    labels : list of (m,)   of the blocks; None of none
    families : bool         whether labels are those of MED, of which a set may have several: where
                            the sets part the cells of a dimension each is one label

    Returns
    -------
    labels : list of (m,)   of a cell in several sets that of the smallest; None of none
    """
    sizes = [len(block.data) for block in mesh.cells]
    out = [np.array(part, dtype=np.int64) for part in labels or map(np.zeros, sizes)]
    sides = mesh.cell_data.get(SIDES, [np.zeros(size, dtype=np.int64) for size in sizes])
    found = labels is not None
    for dim in sorted({block.dim for block in mesh.cells}, reverse=True):
        own = [i for i, block in enumerate(mesh.cells) if block.dim == dim]
        label = np.concatenate([out[i] for i in own])
        sets = {name: np.concatenate([mask_of(members[i], sizes[i]) for i in own])
                for name, members in mesh.cell_sets.items()}
        several = any(len(np.unique(label[inside])) > 1 for inside in sets.values())
        if families and several and np.array_equal(sum(sets.values()), label != 0):
            label[:] = 0
        if not label.any():
            label = np.concatenate([np.asarray(sides[i]) for i in own])
        if not label.any():
            highest = max((int(part.max(initial=0)) for part in out), default=0)
            masks = [inside for inside in sets.values() if inside.any()]
            for k in sorted(range(len(masks)), key=lambda k: (-masks[k].sum(), -k)):
                label[masks[k]] = highest + 1 + k
        found = found or bool(label.any())
        for name, inside in sets.items():
            numbers = np.unique(label[inside])
            if len(numbers) == 1 and numbers[0] and np.array_equal(label == numbers[0], inside):
                mesh.field_data.setdefault(name, np.array([numbers[0], dim]))
        for i, part in zip(own, np.split(label, np.cumsum([sizes[i] for i in own])[:-1]),
                           strict=True):
            out[i] = part
    return out if found else None


def as_sets(mesh: Any, name: str, *, masks: bool = True) -> tuple[Any, list[str]]:
    """A mesh with sets of its labels, such as Volume7, for a format that holds sets alone.

    Arrays of 0 and 1, as sets are in formats without them, are sets again. Cells of a dimension
    with sets have those, or with arrays that tell the labels. Groups with a name are sets already.

    Parameters
    ----------
    mesh : meshio.Mesh    not changed
    name : str            of the format
    masks : bool          whether arrays of 0 and 1 are sets

    Returns
    -------
    mesh : meshio.Mesh
    renamed : list of str    the labels that are sets, all of them, and the arrays
    """
    titles = mesh.cell_sets.keys() - {*BOOKKEEPING}
    before = mesh
    mesh, became = with_masks(mesh, name) if masks else (mesh, [])
    if name not in SETS:
        return mesh, became
    found = {key: numbers for key, values in mesh.cell_data.items()
             if (numbers := numbers_of(key, values)) and are_few(numbers)}
    if OF_SETS in found and titles and _tell([np.concatenate([
            mask_of(rows, len(block.data))
            for rows, block in zip(mesh.cell_sets[title], mesh.cells, strict=True)])
            for title in titles], np.concatenate(found[OF_SETS])):
        mesh = mesh.copy()
        del mesh.cell_data[OF_SETS], found[OF_SETS]
    others = sorted(filter(is_known, found), key=lambda key: are_one(found[key]))
    label = next((key for key in (*LABELS, *others) if key in found), None)
    if label is None:
        return mesh, became
    groups = {(int(value[1]), int(value[0])) for value in mesh.field_data.values()
              if np.shape(value) == (2,)} if label in GROUPS else set()
    parts = [np.asarray(part) for part in found[label]]
    physical = label == GROUPS[0]
    given = {title: [mask_of(rows, len(part)) for rows, part in zip(members, parts, strict=True)]
             for title, members in mesh.cell_sets.items() if title not in BOOKKEEPING}
    sets: dict[str, list[NDArray[np.int64]]] = {}
    whole = True
    for dim in {block.dim for block in mesh.cells}:
        own = [block.dim == dim for block in mesh.cells]
        here = np.concatenate([*compress(parts, own)])
        there = np.unique(here)
        inner = {title: joined for title, inside in given.items()
                 if (joined := np.concatenate([*compress(inside, own)])).any()}
        known = [given[title] for title in inner]
        if not there.any():
            continue
        told = titles & inner.keys() or _tell([*inner.values()], here)
        if known and name == PARTED and not told:
            return as_sets(before, name, masks=False)
        if known and told and not physical and not groups:
            whole = False
            continue
        for number in there.tolist():
            rows = [(part == number) & inside for part, inside in zip(parts, own, strict=True)]
            if (dim, abs(number)) not in groups and (number or not physical) and not any(
                    all(map(np.array_equal, rows, same)) for same in known):
                sets[_free(f"{KINDS[dim]}{number}", mesh)] = list(map(np.flatnonzero, rows))
    out = mesh.copy()
    out.cell_sets = sets | out.cell_sets
    if groups or not sets or not whole:
        return out if sets else mesh, became
    own_names = (label, "gmsh:geometrical") if physical else (label,)
    out.cell_data = {key: values for key, values in out.cell_data.items() if key not in own_names}
    return out, [*became, f"the name of cell data {label!r} (sets there)"]


def with_masks(mesh: Any, name: str) -> tuple[Any, list[str]]:
    """A mesh whose arrays of 0 and 1 are sets, for a format that has these and drops such arrays.

    Arrays that tell labels by their names, and those of VTK's own, stay arrays.

    Parameters
    ----------
    mesh : meshio.Mesh    not changed
    name : str            of the format

    Returns
    -------
    mesh : meshio.Mesh
    renamed : list of str    the arrays that are sets
    """
    cells = {key: [indices(np.asarray(part).ravel().astype(np.bool_)) for part in values]
             for key, values in mesh.cell_data.items()
             if name in (*SETS, MED) and _are_mask(key, values) and key not in mesh.cell_sets}
    points = {key: indices(np.asarray(values).ravel().astype(np.bool_))
              for key, values in mesh.point_data.items()
              if name in (SETS[0], MED) and _are_mask(key, [values]) and key not in mesh.point_sets}
    if not cells and not points:
        return mesh, []
    out = mesh.copy()
    for kind, sets in (("cell", cells), ("point", points)):
        arrays = getattr(out, f"{kind}_data")
        setattr(out, f"{kind}_data", {key: arrays[key] for key in arrays if key not in sets})
        setattr(out, f"{kind}_sets", getattr(out, f"{kind}_sets") | sets)
    return out, [f"{kind} data {', '.join(map(repr, sets))} (sets there)"
                 for kind, sets in (("point", points), ("cell", cells)) if sets]


def _are_mask(name: str, values: list[Any]) -> bool:
    """Whether an array is of 0 and 1, in bytes if it is 1 alone, no labels, and not VTK's own."""
    parts = [np.asarray(part) for part in values]
    labels = name in (*LABELS, *POINT_LABELS, SIDES) or is_known(name)
    if labels or name.startswith("vtk") or any(
            part.dtype.kind not in "biu" or part.size != len(part) for part in parts):
        return False
    there = {int(number) for part in parts for number in np.unique(part)}
    return 1 in there and there <= {0, 1} and (
        0 in there or all(part.dtype.itemsize == 1 for part in parts))


def _tell(sets: list[NDArray[np.bool_]], labels: NDArray[Any]) -> bool:
    """Whether cells that are in the same sets have the same label."""
    alike = classes_of(sets, len(labels))[1]
    both = classes_of([alike, labels], len(labels))[1]
    return len(np.unique(alike)) == len(np.unique(both))


def number_turned(mesh: Any) -> None:
    """Give cells of entities that are turned in a named group of Gmsh, which have its number below
    0, the number itself.
    """
    groups = mesh.cell_data.get(GROUPS[0], [])
    for i, (block, part) in enumerate(zip(mesh.cells, groups, strict=False)):
        named = [-value[0] for value in mesh.field_data.values()
                 if np.shape(value) == (2,) and value[1] == block.dim]
        if np.asarray(part).dtype.kind == "i":
            groups[i] = np.where(np.isin(part, named), np.abs(part), part)


def _free(name: str, mesh: Any) -> str:
    """The name, or that with a number, which no set of cells has."""
    names = chain([name], (f"{name}_{k}" for k in count(2)))
    return next(free for free in names if free not in mesh.cell_sets)


def join_sets(mesh: Any, named: dict[str, list[Any]]) -> None:
    """Give the set of a named group the cells of those whose name is the same in their file."""
    for title, *others in same_names(mesh.field_data) if named else ():
        given = [mesh.cell_sets.pop(other) for other in others if other in mesh.cell_sets]
        if given:
            parts = [named[title], mesh.cell_sets.get(title, named[title]), *given]
            mesh.cell_sets[title] = [np.unique(np.concatenate([*map(indices, rows)]))
                                     for rows in zip(*parts, strict=True)]


def numbers_of(name: str, values: list[Any]) -> list[Any] | None:
    """Arrays of whole numbers, also where the name of others tells that these are labels.

    Those have few values, which are whole or truth values.
    """
    parts = [np.asarray(part) for part in values]
    if any(part.ndim > 2 or part.size != len(part) for part in parts):
        return None
    if all(part.dtype.kind in "iu" for part in parts):
        return values if all(part.ndim == 1 for part in parts) else [p.ravel() for p in parts]
    if not is_known(name) or any(
            part.dtype.kind not in "biuf" or not are_whole(part)
            or (np.abs(part) > EXACT).any() for part in parts):
        return None
    whole = [part.ravel().astype(np.int64) for part in parts]
    return whole if are_few(whole) else None


def are_few(labels: list[Any]) -> bool:
    """Whether few of whole numbers are different."""
    if not labels:
        return False
    there, count = np.unique(np.concatenate(labels), return_counts=True)
    cells = count.sum()
    return bool(cells and cells >= len(there) * (TWICE if len(there) <= FEW else FEW))


def are_one(labels: list[Any]) -> bool:
    """Whether all numbers are the same."""
    parts = [np.asarray(part) for part in labels if len(part)]
    return len({int(end) for part in parts for end in (part.min(), part.max())}) < 2


def within(mesh: Any, labels: list[NDArray[Any]] | None, name: str) -> list[NDArray[Any]] | None:
    """Labels in the range of a format; free numbers stand in place of others: k of -k if k is free.

    Parameters
    ----------
    mesh : meshio.Mesh      its field data get the numbers
    labels : list of (m,)   of the blocks; None of none, which are 0 where the range begins with 1
    name : str              one of RANGES
    """
    least, largest = RANGES[name]
    if labels is None and least < 1:
        return None
    out = [np.array(part, dtype=np.int64) for part in
           labels or [np.zeros(len(block.data)) for block in mesh.cells]]
    if labels is not None and are_within(labels, name):
        return labels
    for dim in {block.dim for block in mesh.cells}:
        own = [i for i, block in enumerate(mesh.cells) if block.dim == dim]
        there = np.unique(np.concatenate([out[i] for i in own]))
        good = (there >= least) & (there <= largest)
        used, bad = {*there[good].tolist()}, there[~good].tolist()
        new = {old: -old for old in bad if 0 < -old <= largest and -old not in used}
        used.update(new.values())
        free = (k for k in count(1) if k not in used)
        new |= {old: next(free) for old in bad if old not in new}
        numbers = np.array([new.get(old, old) for old in there.tolist()], dtype=np.int64)
        for i in own:
            out[i] = numbers[np.searchsorted(there, out[i])]
        mesh.field_data = {
            name: np.array([new.get(int(tag), tag), dim]) if of == dim else np.array([tag, of])
            for name, (tag, of) in mesh.field_data.items()}
    return out


def are_within(labels: list[Any], name: str) -> bool:
    """Whether labels are in the range of a format."""
    least, largest = RANGES[name]
    return all(least <= int(part.min()) and int(part.max()) <= largest
               for part in map(np.asarray, labels) if len(part))


def are_tags(labels: list[Any]) -> bool:
    """Whether whole numbers are from 0 on, as Gmsh takes them for groups, and some not 0."""
    parts = [np.asarray(part) for part in labels]
    return (min((int(part.min()) for part in parts if len(part)), default=0) >= 0
            and 0 < max((int(part.max()) for part in parts if len(part)), default=0) <= MOST)


def are_groups(mesh: Any, labels: list[Any]) -> bool:
    """Whether whole numbers, few of them, are not 0 on any cell of the largest dimension.

    Gmsh drops cells without a group where others have one.
    """
    dim = max((block.dim for block in mesh.cells), default=0)
    return are_few(labels) and all(np.all(part) for block, part in zip(
        mesh.cells, labels, strict=True) if block.dim == dim)


def mask_of(members: Any, size: int) -> NDArray[np.bool_]:
    """Which of the cells of a block are members."""
    inside = np.zeros(size, dtype=np.bool_)
    inside[indices(members)] = True
    return inside
