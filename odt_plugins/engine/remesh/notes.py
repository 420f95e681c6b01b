"""What is said of a mesh that was given other sizes: of its edges, and of figures that fell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from odt_plugins.engine.remesh.lay_out import surface_of
from odt_plugins.engine.remesh.sizes import FINER, lengths_of, unique_edges
from odt_plugins.engine.run.outcome import Outcome
from odt_plugins.engine.surface.in_plane import in_space
from odt_plugins.engine.surface.judge import values_on
from odt_plugins.errors import counted, place_within
from odt_plugins.mesh.arrays import FloatArray
from odt_plugins.mesh.facets import row_keys
from odt_plugins.mesh.numbering import new_numbers
from odt_plugins.mesh.simplex import SimplexMesh, diagonal, vertices_of
from odt_plugins.options import OPTIONS, Options
from odt_plugins.promise.good import fallen_since

IN = (0.5**0.5, 2.0**0.5)
"""Edges whose length is within these multiples of their size have it."""

OF_TETRAHEDRA = ("method", "smoothing", "finish", "objective")
"""Options that say how vertices of tetrahedra move once these have their sizes."""


def told_of_edges(outcome: Outcome, unit: float, multiple: FloatArray) -> tuple[str, ...]:
    """How many edges are as long as they should be, and where those are that are not.

    ``multiple`` (n,) are the sizes that were asked for, as parts of those that were worked with.
    """
    if outcome.sizes is None:
        return ()
    edges = unique_edges(outcome.cells)
    asked = unit * outcome.sizes * multiple
    ratio = lengths_of(outcome.points, edges, outcome.metric) / (0.5 * asked[edges].sum(axis=1))
    short, long = ratio < IN[0], ratio > IN[1]
    surface = np.zeros(len(outcome.points), dtype=np.bool_)
    surface[surface_of(outcome.cells, outcome.regions, outcome.faces[1])[0]] = True
    there = surface[edges].all(axis=1)
    notes: tuple[str, ...] = (
        f"{(~short & ~long).mean():.1%} of the edges are {IN[0]:.2f} to {IN[1]:.2f} times as "
        f"long as asked for, {ratio.mean():.2f} on average; {short.mean():.1%} are shorter, "
        f"{(short & there).mean():.1%} between vertices of the surface, and {long.mean():.1%} "
        f"longer",)
    used = vertices_of(outcome.cells)
    finer = used[multiple[used] > FINER]
    if len(finer):
        most = finer[np.argmax(multiple[finer])]
        place = place_within(diagonal(outcome.points[used]), outcome.points[most])
        inside = (", and those inside grow from there by growth=, more of which makes fewer, "
                  "poorer cells")
        notes += (
            f"sizes are smaller than asked for at {counted(len(finer), 'vertex', 'vertices')}, "
            f"{np.median(multiple[finer]):.2g} times in the middle and {multiple[most]:.2g} times "
            f"at most, near ({place}): the envelope, features or thin parts allow no longer edges"
            + ("" if surface[finer].all() else inside),)
    return notes


def told_of_triangles(
    mesh: SimplexMesh, base: SimplexMesh, asked: FloatArray, outcome: Outcome
) -> tuple[str, ...]:
    """How many edges of triangles are as long as asked for, and where they are furthest from it.

    Edges of cells of the mesh that are frozen do not count. ``asked`` (n,) are the lengths at the
    vertices of the base.
    """
    edges = unique_edges(outcome.cells)
    every = len(edges)
    if outcome.origin is not None and mesh.frozen.any():
        still = new_numbers(outcome.origin, len(mesh.points))[mesh.cells[mesh.frozen]]
        both = np.concatenate([edges, unique_edges(still)])
        key = row_keys(both, int(both.max()) + 1)
        edges = edges[~np.isin(key[:every], key[every:])]
    if not len(edges):
        return ()
    changing = " that may change" if len(edges) < every else ""
    size = values_on(in_space(base.points), base.cells, asked, in_space(outcome.points))
    ratio = lengths_of(outcome.points, edges, outcome.metric) / (0.5 * size[edges].sum(axis=1))
    short, long = ratio < IN[0], ratio > IN[1]
    note = (f"{(~short & ~long).mean():.1%} of the edges{changing} are {IN[0]:.2f} to {IN[1]:.2f} "
            f"times as long as asked for, {ratio.mean():.2f} on average; {short.mean():.1%} are "
            f"shorter and {long.mean():.1%} longer")
    if (short | long).any():
        inverse = np.divide(1.0, ratio, out=np.full(len(ratio), np.inf), where=ratio > 0.0)
        far = edges[np.argmax(np.maximum(ratio, inverse))]
        place = place_within(diagonal(outcome.points), outcome.points[far].mean(axis=0))
        note += f", most of all near ({place})"
    return (note,)


def told_of_unused(options: Options) -> tuple[str, ...]:
    """Which options were given that have a part in the moves of tetrahedra alone."""
    given = [f"{name}=" for name in OF_TETRAHEDRA
             if getattr(options, name) != OPTIONS[name].default]
    if not given:
        return ()
    one = "has" if len(given) == 1 else "have"
    return (f"{' and '.join(given)} {one} no part in other sizes of triangles, which are improved "
            f"by their radius ratios",)


def told_of_fallen(mesh: SimplexMesh, found: Outcome, options: Options) -> Outcome:
    """An outcome that says which figures fell as good cells became fewer."""
    fallen = fallen_since(mesh, found.points, found.cells, found.metric, tuple(options.keep))
    kind = "triangles" if mesh.dim == 2 else "cells"
    note = f"poor {kind} are no more than in the input, and good ones fewer: {'; '.join(fallen)}"
    return replace(found, notes=(note, *found.notes) if fallen else found.notes)


def told_of_frozen(
    mesh: SimplexMesh, held: SimplexMesh, outcome: Outcome, why: str, *, boundary: bool
) -> Outcome:
    """An outcome that says how many more cells are frozen, whether the boundary is, and why."""
    count = int((held.frozen & ~mesh.frozen).sum())
    if count:
        stay = counted(count, "cell of the input stays as it is",
                       "cells of the input stay as they are")
        note = f"{stay}, since {why}"
        outcome = replace(outcome, notes=(*outcome.notes, note))
    if boundary:
        outcome = replace(outcome, fallback=f"the boundary is left as it is, since {why}")
    return outcome
