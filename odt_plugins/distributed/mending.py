"""Pieces with inverted or flat cells: untangled one by one, then with those around them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from odt_plugins.carrying.untangling import Wanted, untangle_mesh
from odt_plugins.distributed.apply import Apply
from odt_plugins.distributed.piecework import Numbers, Taken, expect_apart, measured, numbered
from odt_plugins.distributed.store import join, load
from odt_plugins.errors import TangledMeshError, counted
from odt_plugins.mesh.arrays import FloatArray
from odt_plugins.mesh.simplex import SimplexMesh, cell_signs, compact_labels
from odt_plugins.options import Options

GROWTH = 3
"""How often the pieces around are taken as well."""

Mending = tuple[list[Taken], list[Numbers], list[str]]
"""Pieces, their numbers in the whole, and where they are kept when they are untangled."""


def mend(item: Mending, options: Options) -> list[Taken]:
    """Untangle some pieces as one mesh, whose boundary stays; none where it cannot be."""
    taken, numbers, paths = item
    parts = [numbered(part.path, number) for part, number in zip(taken, numbers, strict=True)]
    whole = parts[0] if len(parts) == 1 else join(parts)[0]
    m = len(whole.cells)
    mesh = SimplexMesh(whole.points, whole.cells, compact_labels(whole.regions, m),
                       np.zeros(len(whole.points), dtype=np.bool_))
    expect_apart(mesh)
    try:
        new, tangle = untangle_mesh(mesh, options, np.copy, Wanted())
    except TangledMeshError:
        return []
    source = tangle.source
    owner = np.repeat(np.arange(len(parts)), [len(part.cells) for part in parts])[source]
    whole = replace(
        whole, points=new.points, cells=new.cells, regions=whole.regions[source],
        cell_data={name: values[source] for name, values in whole.cell_data.items()})
    return [
        part._replace(**measured(whole.part(np.flatnonzero(owner == k)), path,
                                 numbered=part.ids is not None))
        for k, (part, path) in enumerate(zip(taken, paths, strict=True))
    ]


def mended(
    taken: Sequence[Taken], names: Sequence[str], folder: Path, options: Options,
    number: Callable[[Sequence[Taken]], Sequence[Numbers]], apply: Apply,
) -> list[Taken]:
    """Untangle the pieces that need it.

    Parameters
    ----------
    taken : sequence of Taken
    names : sequence of str      of their files
    folder : Path                where they are kept
    options : Options
    number : callable            numbers of the vertices of all pieces in the whole
    apply : callable

    Raises
    ------
    TangledMeshError             cells stay inverted or flat, also with the pieces around them
    """
    out = list(taken)
    work = partial(mend, options=options)

    def job(members: Sequence[int], turn: str) -> Mending:
        return ([out[k] for k in members], [numbers[k] for k in members],
                [str(folder / f"{turn}-{k}.npz") for k in members])

    numbers = number(out)
    alone = [k for k, part in enumerate(out) if part.inverted]
    for k, parts in zip(alone, apply(work, [job([k], "alone") for k in alone]), strict=True):
        out[k : k + 1] = parts or [out[k]]
    for k in alone:
        members = [k]
        for turn in range(GROWTH):
            if not any(out[j].inverted for j in members):
                break
            places = np.concatenate([out[j].around for j in members])
            grown = [j for j, part in enumerate(out)
                     if j in members or _has_some(part.points, places)]
            if grown == members:
                break
            members, numbers = grown, number(out)
            (parts,) = apply(work, [job(members, f"around-{k}-{turn}")])
            for j, part in zip(members, parts or [out[j] for j in members], strict=True):
                out[j] = part
    left = [k for k, part in enumerate(out) if part.inverted]
    if left:
        raise _stays(out, left, names)
    return out


def _has_some(points: FloatArray, places: FloatArray) -> bool:
    """Whether some points are at some places, bit for bit."""
    a, b = (np.ascontiguousarray(x + 0.0).view("V24").ravel() for x in (points, places))
    return bool(np.isin(a, b).any())


def _stays(taken: Sequence[Taken], left: list[int], names: Sequence[str]) -> TangledMeshError:
    """The error that names the pieces and the place of the first cell that stays inverted."""
    first = taken[left[0]]
    piece = load(first.path)
    cell = piece.cells[np.flatnonzero(cell_signs(piece.points, piece.cells)[0] <= 0)[0]]
    place = ", ".join(f"{x:.6g}" for x in piece.points[cell].mean(axis=0))
    count = sum(taken[k].inverted for k in left)
    msg = (f"got {counted(count, 'inverted or flat cell')} (first: around ({place}) in "
           f"{Path(names[left[0]]).name}, in {counted(len(left), 'piece')} altogether) for which "
           "neither other places of their vertices nor flips were found, also with the pieces "
           "around them; expected a boundary and interfaces that leave every cell room, try "
           "moving what holds them")
    return TangledMeshError(msg, [])
