"""MED files written into themselves: a copy in which points and cells that changed are others."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.change import Change, NotRewritable
from odt_plugins.adapters.formats.decks import indices
from odt_plugins.adapters.formats.med import (
    LONGEST,
    TURNED,
    WHOLE,
    Cells,
    as_array,
    cells_of,
    fields_of,
    names_of,
    points_of,
    step_of,
    values_of,
    words_of,
)


def rewrite(source: Path, target: Path, change: Change) -> list[str]:
    """Copy a file, and replace places, cells, their families, numbers and values of fields."""
    import h5py

    shutil.copyfile(source, target)
    with h5py.File(target, "r+") as file:
        name, step = step_of(file)
        points = points_of(file, name, step)
        blocks = cells_of(step, points)
        changed = [_other(change, i, len(block.rows)) for i, block in enumerate(blocks)]
        _expect_known(file, name, change, [b.word for b, other in zip(blocks, changed, strict=True)
                                           if other])
        of_points = f"FAS/{name}/NOEUD"
        _write_points(step["NOE"], change, names_of(file[of_points]) if of_points in file else {})
        for i, block in enumerate(blocks):
            if changed[i] or change.renumbered:
                _write_cells(step["MAI"][block.word], block, change, i)
        _write_fields(file, name, blocks, change)
        for home in ("ELEME", "NOEUD"):
            for family in (file[f"FAS/{name}/{home}"].values()
                           if f"FAS/{name}/{home}" in file else ()):
                _mend_names(family)
    return []


def _mend_names(family: Any) -> None:
    """Store names of groups as the MED library reads them, where they are stored otherwise."""
    words = words_of(family)
    if not words or family["GRO"]["NOM"].id.get_type().get_size() == LONGEST:
        return
    table = np.zeros((len(words), LONGEST), dtype=np.int8)
    for row, word in zip(table, words, strict=True):
        letters = np.frombuffer(word[:LONGEST], dtype=np.int8)
        row[: len(letters)] = letters
    del family["GRO"]["NOM"]
    family["GRO"].create_dataset("NOM", (len(words),), dtype=f"{LONGEST}int8")[...] = table


def _other(change: Change, i: int, count: int) -> bool:
    """Whether the cells of a block are other ones, or in another order."""
    rows = change.cells[i]
    return not np.array_equal(rows, np.arange(count)) or bool(change.exchanged(i).any())


def _expect_known(file: Any, name: str, change: Change, words: list[str]) -> None:
    """See whether all that refers to cells or points is known.

    Raises
    ------
    NotRewritable    fields on some of the cells, or equivalences and joints of what changed
    """
    for field in fields_of(file, name):
        for support in field.supports:
            word = support.partition(".")[2]
            if word not in words and not change.renumbered:
                continue
            strange = [p for p in field.group[support] if p.encode() != WHOLE]
            if strange or len(field.group[support]) != 1:
                msg = f"the field {field.title!r} is one of some of the cells that were exchanged"
                raise NotRewritable(msg)
    for what in ("EQS", "JNT"):
        own = file[what][name] if what in file and name in file[what] else {}
        found: list[str] = []
        if hasattr(own, "visit"):
            own.visit(lambda path, found=found: found.append(path.rpartition("/")[2]))
        touched = [key for key in found if set(key.split(".")) & set(words)]
        if touched or (found and change.renumbered):
            msg = f"it has {what}, which refer to what was exchanged"
            raise NotRewritable(msg)


def _put(group: Any, name: str, values: NDArray[Any]) -> None:
    """Write new values into a table, also of another length; its attributes stay."""
    table = group[name]
    if table.shape == values.shape:
        table[...] = values
        return
    attributes, dtype = dict(table.attrs), table.dtype
    del group[name]
    made = group.create_dataset(name, data=values.astype(dtype))
    for key, value in attributes.items():
        made.attrs.create(key, value, dtype=np.asarray(value).dtype)


def _counted(table: Any, count: int) -> None:
    """Say how many rows there are, in the type in which it was said."""
    if "NBR" in table.attrs:
        table.attrs.modify("NBR", np.asarray(count, dtype=np.asarray(table.attrs["NBR"]).dtype))


def _rows(group: Any, name: str, rows: NDArray[np.int64], last: int = 0) -> None:
    """Take rows of a table; letters of names come in one piece a row, new numbers after `last`."""
    data = np.asarray(group[name][()])
    count = int(group[name].attrs.get("NBR", len(data)))
    values = data.reshape((count, -1))[rows]
    if name == "NUM":
        fresh = np.ones(len(rows), dtype=np.bool_)
        fresh[np.unique(rows, return_index=True)[1]] = False
        fresh |= rows < 0
        values[fresh, 0] = data.max(initial=last) + 1 + np.arange(fresh.sum())
    _put(group, name, values.reshape((-1, *data.shape[1:])))
    _counted(group[name], len(rows))


def _write_points(group: Any, change: Change, families: dict[int, list[str]]) -> None:
    """Write places, families, numbers and names; new points are in families of their groups."""
    points = np.asarray(change.after.points)
    _put(group, "COO", points.ravel(order="F"))
    _counted(group["COO"], len(points))
    if not change.renumbered:
        return
    if "FAM" in group:
        _rows(group, "FAM", change.points)
        numbers = group["FAM"][()]
        fresh = np.flatnonzero(change.points < 0)
        numbers[fresh] = _families_of(fresh, change, families)
        group["FAM"][...] = numbers
    for name in ("NUM", "NOM"):
        if name in group:
            _rows(group, name, change.points)


def _families_of(
    points: NDArray[np.int64], change: Change, families: dict[int, list[str]]
) -> NDArray[np.int64]:
    """Number of the family with most of the groups in which each point is, and with no others."""
    inside = {name: np.isin(points, indices(members))
              for name, members in change.after.point_sets.items()}
    out, most = np.zeros((2, len(points)), dtype=np.int64)
    for number, names in families.items():
        own = set(names) & inside.keys()
        if not own or len(own) < len(set(names)):
            continue
        better = np.all([inside[name] for name in own], axis=0) & (most < len(own))
        out[better], most[better] = number, len(own)
    return out


def _write_cells(group: Any, block: Cells, change: Change, i: int) -> None:
    """Write nodes, families, numbers and names of the cells of a type."""
    nodes = np.asarray(change.after.cells[i].data) + 1
    nodes = nodes[:, TURNED[block.kind]] if block.turned else nodes
    _put(group, "NOD", nodes.ravel(order="F"))
    _counted(group["NOD"], len(nodes))
    last = max(int(kind["NUM"][()].max(initial=0)) if "NUM" in kind else 0
               for kind in group.parent.values())
    for name in ("FAM", "NUM", "NOM"):
        if name in group:
            _rows(group, name, change.cells[i], last)


def _write_fields(file: Any, name: str, blocks: list[Cells], change: Change) -> None:
    """Write the values of fields, at all their times, that differ or have another length."""
    words = [block.word for block in blocks]
    before, after = change.before, change.after
    for field in fields_of(file, name):
        for support in field.supports:
            word = support.partition(".")[2]
            if support == "NOE":
                if field.title not in before.point_data or field.title not in after.point_data:
                    continue
                old, new = before.point_data[field.title], after.point_data[field.title]
                count, rows = len(before.points), change.points
            elif word in words and field.title in after.cell_data:
                k = words.index(word)
                old, new = before.cell_data[field.title][k], after.cell_data[field.title][k]
                count, rows = len(blocks[k].rows), change.cells[k]
            else:
                continue
            values = values_of(file, field.group[support], count)
            if values is None or np.array_equal(old, new, equal_nan=True):
                continue
            if as_array(values).shape[1:] != np.shape(new)[1:]:
                continue
            table = field.group[support][next(iter(field.group[support]))]
            if len(rows) == count and values.size != np.asarray(table["CO"][()]).size:
                # A profile leaves some out, whose values are not there.
                own = file["PROFILS"][next(iter(field.group[support]))]["PFL"][()] - 1
                new = np.asarray(new)[own]
            flat = np.asarray(new).reshape((-1, *values.shape[1:]))
            _put(table, "CO", flat.ravel(order="F"))
            _counted(table, len(flat))
