"""What is told of vertices, lines and triangles beside the cells that stay where others do not."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from odt_plugins.adapters.host import CELL_VERTEX, NAMED_VERTEX, SET_VERTEX, HostMesh
from odt_plugins.errors import counted
from odt_plugins.mesh.simplex import SimplexMesh

WHY = {True: "most have a number of their own in an array; try to leave it out",
       False: "cells of another order and parts of poly-lines become no others"}
"""Why faces beside the cells stay, with a place of their own among all cells and without one."""


def note_kept(mesh: SimplexMesh, host: HostMesh, resized: bool) -> tuple[str, ...]:
    """Say which vertices stay, of those that sets, the file or cells name, and which faces do.

    Parameters
    ----------
    mesh : SimplexMesh    what stays of it is `fixed`, faces that may become others are `faces`
    host : HostMesh       that it comes from
    resized : bool        whether faces become others
    """
    notes = tuple(note for note, rows in held_vertices(host) if mesh.fixed[rows].all())
    return notes + _notes_on_faces(mesh, host) if resized else notes


def held_vertices(host: HostMesh) -> list[tuple[str, NDArray[Any]]]:
    """Say of vertices (q, 1) that sets, the file or cells name that they stay."""
    stay = {True: "stays where it is", False: "stay where they are"}
    return [(f"{counted(len(rows), kind, kind.replace('vertex', 'vertices'))} "
             f"{stay[len(rows) == 1]}", rows) for kind, rows, *_ in host.kept
            if kind.startswith((SET_VERTEX, NAMED_VERTEX, CELL_VERTEX))]


def _notes_on_faces(mesh: SimplexMesh, host: HostMesh) -> tuple[str, ...]:
    """Say which lines and triangles become no others, or hardly, as each has no other like it."""
    notes = []
    cells = "tetrahedra" if mesh.cells.shape[1] == 4 else "triangles"
    for what, size in (("line", 2), ("triangle", 3)):
        alone = [(len(rows), ids is not None) for _, rows, classes, labels, ids, _ in host.kept
                 if rows.shape[1] == size and classes is None and labels is not None]
        for own, why in WHY.items():
            count = sum(many for many, numbered in alone if numbered == own)
            if count:
                notes.append(f"{counted(count, what)} beside the {cells} stay{'s' * (count == 1)}, "
                             f"since {why}")
        labels = mesh.faces[size - 2].labels
        if 2 * len(set(labels.tolist())) > max(len(labels), 2):
            notes.append(f"most of the {counted(len(labels), what)} beside the {cells} have no "
                         f"other of the same block or entity, sets and numbers, and their ends "
                         f"stay; try to put those that belong together into one")
    return tuple(host.words(note) for note in notes)
