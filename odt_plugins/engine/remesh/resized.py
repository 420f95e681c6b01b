"""The mesh of an attempt with edges as long as they should be, before it is optimised."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from odt_plugins.engine.compiled.threads import thread_pool, worth
from odt_plugins.engine.odt.density import NodalDensity, make_density
from odt_plugins.engine.odt.rounds import Log
from odt_plugins.engine.record.figures import figures
from odt_plugins.engine.record.memory import State
from odt_plugins.engine.remesh.finish import Resized
from odt_plugins.engine.remesh.lay_out import lay_out
from odt_plugins.engine.remesh.places import allowed_figures
from odt_plugins.engine.remesh.remedies import Attempt, crowded, most_given_way
from odt_plugins.engine.remesh.sizes import local_sizes
from odt_plugins.engine.remesh.volume import Resizing, arrays_of, resize
from odt_plugins.engine.remesh.whole import holds
from odt_plugins.engine.run.judge import envelope_length
from odt_plugins.engine.run.work import extremes, make_start
from odt_plugins.mesh.arrays import FloatArray
from odt_plugins.mesh.faces import Faces, joined, renumbered, without
from odt_plugins.mesh.numbering import new_numbers
from odt_plugins.options import Options

LONGER = 1.11
"""Sizes are worked with so many times as long, so that edges have them on average."""

Made = tuple[Resized, Log]
"""What edges of other lengths make of a mesh, and counts."""


def with_sizes(attempt: Attempt, asked: FloatArray, options: Options, tick: Any) -> Made:
    """Split and collapse edges until they have the sizes of an attempt.

    Parameters
    ----------
    attempt : Attempt
    asked : (n,) float64    sizes that were asked for, with which those of the attempt are compared
    options : Options
    tick : callable         takes the part of this that is done
    """
    mesh, sizes, share = attempt.mesh, attempt.sizes, attempt.share
    start = make_start(mesh)
    frame = start.frame
    # lengths in a metric have no unit
    unit = 1.0 if len(mesh.metric) else frame.scale
    values = LONGER * sizes.values[frame.vertices] * unit
    threads = worth(options.threads, max(len(mesh.cells), int(sizes.cells)))
    with thread_pool(threads) as pool:
        field = make_density(NodalDensity(values, 1.0), None, start.seen, start.cells, None)
        length = share * (envelope_length(mesh, options) - mesh.sag) * frame.scale
        for coarse in (False, True):
            body, guard, scratch, names = lay_out(
                start, holds(mesh)[frame.vertices], length * attempt.parts[frame.vertices],
                options.feature_angle,
                extremes(allowed_figures(mesh, options), tuple(options.keep)).cells)
            were = [frame.vertices[s.rows[s.live()]] for s in (body.segments, body.triangles)]
            log = Log()
            work = Resizing(body, guard, scratch, field, field.walk_start(len(start.points)), log,
                            LONGER * local_sizes(mesh)[frame.vertices] * unit, sizes.growth,
                            attempt.stuck, most_given_way(mesh, sizes), crowded(mesh, sizes))
            if resize(work, share > 0.0, pool, tick, threads, coarse=coarse):
                break
        whole = make_density(NodalDensity(LONGER * asked[frame.vertices] * unit, 1.0), None,
                             start.points, start.cells, None)
        size = work.body.size[: len(work.walk)]
        multiple = whole.at(np.ascontiguousarray(work.body.points[: len(size)]), pool,
                            work.walk.copy()) / size
    points, cells, tags = arrays_of(work.body)
    regions = np.unique(start.regions)[tags].astype(np.int32)
    state = State(points, cells, regions, figures(points, cells), "resized")
    outcome = start.placed(state)
    if outcome.origin is None:
        outcome = replace(outcome, origin=np.arange(len(outcome.points)))
    n = len(frame.vertices)
    new = n + np.flatnonzero(np.bincount(cells.ravel(), minlength=len(points))[n:])
    origin: Any = outcome.origin

    def outside(values: FloatArray, elsewhere: FloatArray) -> FloatArray:
        """Values at the vertices of the outcome, of those ``elsewhere`` (n,) that are not here."""
        old = elsewhere.copy()
        old[frame.vertices] = values[:n]
        return np.concatenate([old[origin[origin >= 0]], values[new]])

    lengths = outside(size / unit, LONGER * sizes.values)
    number = np.empty(len(points), dtype=np.int32)
    number[:n] = new_numbers(origin, len(mesh.points))[frame.vertices]
    number[new] = len(origin) - len(new) + np.arange(len(new), dtype=np.int32)
    faces = []
    for old, rows, label, s in zip(
            mesh.faces, were, names, (work.body.segments, work.body.triangles), strict=True):
        live = s.live()
        live = live[label[s.tag[live]] >= 0]
        faces.append(joined(
            renumbered(without(old, rows), new_numbers(origin, len(mesh.points))),
            Faces(number[s.rows[live]], label[s.tag[live]])))
    outcome = replace(outcome, faces=(faces[0], faces[1]))
    lines = number[work.body.segments.rows[work.body.segments.live()]].reshape(-1, 2)
    multiple = outside(multiple, asked / sizes.values)
    return Resized(outcome, lengths, multiple, lines, work.firm), log
