"""Labels out of sets of cells, and those that a tool takes, for formats that hold no sets."""

from __future__ import annotations

from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.decks import indices

SIDES = "exodus:side_set"
"""Labels of cells at a boundary beside those of blocks, which are 0 there."""

LARGEST = {"nastran": 2**31 - 1, "netgen": 99_999}
"""Formats whose tools take no labels but those from 1 on, and up to which these are.

Netgen has names and tables for all numbers up to the largest.
"""


def of_sets(mesh: Any, labels: list[NDArray[Any]] | None) -> list[NDArray[Any]] | None:
    """Labels whose cells without any in a dimension have those of side sets, or of their sets.

    A set whose cells are all those of one label gives the label its name, as a group.

    Parameters
    ----------
    mesh : meshio.Mesh      with one block a type; its field data get the names
    labels : list of (m,)   of the blocks; None of none

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
        sets = {name: np.concatenate([_mask(members[i], sizes[i]) for i in own])
                for name, members in mesh.cell_sets.items()}
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


def within(mesh: Any, labels: list[NDArray[Any]] | None, largest: int) -> list[NDArray[Any]]:
    """Labels from 1 to the largest; free numbers stand in place of others: k of -k if k is free.

    Parameters
    ----------
    mesh : meshio.Mesh      its field data get the numbers
    labels : list of (m,)   of the blocks; None of none
    largest : int
    """
    out = [np.array(part, dtype=np.int64) for part in
           labels or [np.zeros(len(block.data)) for block in mesh.cells]]
    for dim in {block.dim for block in mesh.cells}:
        own = [i for i, block in enumerate(mesh.cells) if block.dim == dim]
        there = np.unique(np.concatenate([out[i] for i in own]))
        good = (there > 0) & (there <= largest)
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


def _mask(members: Any, size: int) -> NDArray[np.bool_]:
    """Which of the cells of a block are members."""
    inside = np.zeros(size, dtype=np.bool_)
    inside[indices(members)] = True
    return inside
