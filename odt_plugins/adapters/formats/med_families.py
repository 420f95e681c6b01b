"""Families of MED files out of sets: every cell and node is in one, which is in several groups."""

from __future__ import annotations

from collections.abc import Container, Sequence
from itertools import chain, count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.decks import alike
from odt_plugins.adapters.formats.med import CELL_TAGS, LONGEST, POINT_TAGS, TURNED

MOST = 2**31 - 1
"""Largest number of a family."""


def with_families(mesh: Any) -> None:
    """Give a mesh for meshio's writer families of its sets, and cells in the order of the format.

    Families of cells have negative numbers, those of nodes positive ones. Cells of a label without
    a set are in a group of the number of the label.

    Parameters
    ----------
    mesh : meshio.Mesh    changed; its sets go
    """
    sizes = [len(block.data) for block in mesh.cells]
    labels = mesh.cell_data.get(CELL_TAGS, [np.zeros(size, dtype=np.int64) for size in sizes])
    known = {name: np.concatenate([_mask(rows, size) for rows, size in
                                   zip(members, sizes, strict=True)])
             for name, members in mesh.cell_sets.items()} if sizes else {}
    label = np.concatenate([np.asarray(part).astype(np.int64) for part in labels])
    tags, mesh.cell_tags = _families(label, known)
    if mesh.cell_tags:
        mesh.cell_data[CELL_TAGS] = np.split(-tags, np.cumsum(sizes)[:-1])
        mesh.cell_tags = {-number: names for number, names in mesh.cell_tags.items()}
    else:
        mesh.cell_data.pop(CELL_TAGS, None)
    sets = {name: _mask(nodes, len(mesh.points)) for name, nodes in mesh.point_sets.items()}
    tags, mesh.point_tags = _families(np.zeros(len(mesh.points), dtype=np.int64), sets)
    mesh.point_data.pop(POINT_TAGS, None)
    if mesh.point_tags:
        mesh.point_data[POINT_TAGS] = tags
    mesh.cell_sets, mesh.point_sets = {}, {}
    turned = _mostly_positive(mesh)
    for block in mesh.cells:
        if block.type in TURNED and turned:
            block.data = np.asarray(block.data)[:, TURNED[block.type]]


def _mostly_positive(mesh: Any) -> bool:
    """Whether most tetrahedra have positive volume; true where there are none."""
    corners = [np.asarray(block.data)[:, :4] for block in mesh.cells
               if block.type in ("tetra", "tetra10")]
    if not corners or mesh.points.shape[1] != 3:
        return True
    tets = np.concatenate(corners)
    sides = np.asarray(mesh.points, dtype=np.float64)[tets[:, 1:]] - mesh.points[tets[:, :1]]
    volumes = (np.cross(sides[:, 0], sides[:, 1]) * sides[:, 2]).sum(axis=1)
    return bool(2 * (volumes > 0).sum() > len(tets))


def _mask(members: Any, size: int) -> NDArray[np.bool_]:
    given = np.asarray([] if members is None else members)
    inside = np.zeros(size, dtype=np.bool_)
    inside[given if given.dtype == np.bool_ else given.astype(np.int64).ravel()] = True
    return inside


def _families(
    label: NDArray[np.int64], sets: dict[str, NDArray[np.bool_]]
) -> tuple[NDArray[np.int64], dict[int, list[str]]]:
    """Number (n,) of the family of everything, 0 of what is in none, and groups of every family."""
    first, inverse = alike([label, *sets.values()])
    choices = np.stack([label[first], *(inside[first] for inside in sets.values())], axis=1)
    cut: list[str] = []
    for name in sets:
        cut.append(_free(name, cut, sets))
    names = [[name for name, inside in zip(cut, row[1:], strict=True) if inside]
             or [_free(str(row[0]), cut, sets)] * bool(row[0]) for row in choices.tolist()]
    whole = np.abs(choices[:, 0])
    same = (len(np.unique(whole)) == len(whole) and whole.max(initial=0) <= MOST
            and (whole[[bool(own) for own in names]] > 0).all())
    numbers, fresh = np.zeros(len(choices), dtype=np.int64), 0
    for i, own in enumerate(names):
        if own:
            fresh += 1
            numbers[i] = whole[i] if same else fresh
    groups = {int(number): own for number, own in zip(numbers, names, strict=True) if own}
    return numbers[inverse], groups


def _free(name: str, taken: Sequence[str], names: Container[str]) -> str:
    """A name that is not taken and short enough; one that is made is none of ``names``."""
    numbered = chain([""], (f"_{k}" for k in count(2)))
    titles = (name.encode()[: LONGEST - len(end)].decode(errors="ignore") + end for end in numbered)
    return next(title for title in titles
                if title not in taken and (title == name or title not in names))
