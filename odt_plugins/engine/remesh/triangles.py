"""Other sizes for triangles, tried until a result keeps the promise and is coarse enough."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from odt_plugins.engine.remesh.notes import told_of_fallen
from odt_plugins.engine.remesh.remedies import (
    ATTEMPTS,
    HARDLY_COARSER,
    MOST_HELD,
    crowded,
    nearer,
)
from odt_plugins.engine.remesh.sizes import Sizes
from odt_plugins.engine.retile.run import Made, retile
from odt_plugins.engine.run.outcome import Leaving, Outcome, unchanged
from odt_plugins.mesh.numbering import new_numbers
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.options import Options
from odt_plugins.promise.good import good_enough


def resized_triangles(
    mesh: SimplexMesh, base: SimplexMesh, sizes: Sizes, options: Options, leaving: Leaving
) -> Outcome:
    """Resize triangles, with more vertices where sizes need them if the promise holds so; where
    much of the input stays for its sake, also to sizes nearer to those of the input, as long as
    these break something else: the coarsest result. If much stays even then good triangles may
    become fewer, as poor ones do not.
    """
    wanted: Sizes | None = sizes
    best, why = unchanged(mesh, "no other sizes kept the promise"), None
    done: dict[bytes, Made] = {}
    if base is not mesh:
        outcome = retile(mesh, sizes.values, options, leaving, crowded(mesh, sizes), base)
        if outcome.origin is not None:
            return outcome
        sizes = sizes.first(len(mesh.points))
        wanted = sizes
    for _ in range(ATTEMPTS):
        if wanted is None:
            break
        outcome = retile(
            mesh, wanted.values, options, leaving, crowded(mesh, wanted), done=done)
        if why is None and outcome.fallback is None:
            return outcome
        if why is None or (outcome.origin is not None and (
                best.origin is None or len(outcome.points) < len(best.points))):
            note = ("sizes are nearer to those of the input than asked for, since "
                    + (why or "").partition("since ")[2])
            best = outcome if why is None else replace(outcome, notes=(note, *outcome.notes))
        elif outcome.origin is not None or outcome.fallback == why:
            break
        why = why or outcome.fallback
        if outcome.fallback is None or _stays(mesh, outcome) <= MOST_HELD:
            break
        wanted = nearer(mesh, wanted, np.zeros(len(mesh.cells), dtype=np.bool_))
    if sizes.cells < len(mesh.cells) and (
            _stays(mesh, best) > MOST_HELD
            or len(best.points) > HARDLY_COARSER * len(mesh.points)):
        found = _where_good_ones_go(mesh, sizes, options, leaving, done)
        if found is not None and len(found.points) < len(best.points):
            return found
    return best


def _where_good_ones_go(
    mesh: SimplexMesh, sizes: Sizes, options: Options, leaving: Leaving, done: dict[bytes, Made],
) -> Outcome | None:
    """Resize triangles so that poor ones are no more, though a larger part; None if that fails.

    ``done`` is what was made of the mesh so far.
    """
    if not good_enough(tuple(options.keep), 3):
        return None
    found = retile(mesh, sizes.values, options, leaving, crowded(mesh, sizes), mesh,
                   len(mesh.cells), done)
    return None if found.origin is None else told_of_fallen(mesh, found, options)


def _stays(mesh: SimplexMesh, outcome: Outcome) -> float:
    """Part of the triangles of a mesh that an outcome has."""
    if outcome.origin is None:
        return 1.0
    number = new_numbers(outcome.origin, len(mesh.points))
    both = np.concatenate([number[mesh.cells], outcome.cells])
    _, which = np.unique(np.sort(both, axis=1), axis=0, return_inverse=True)
    m = len(mesh.cells)
    return float(np.isin(which[:m], which[m:]).mean())
