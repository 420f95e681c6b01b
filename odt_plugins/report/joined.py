"""Reports that are no engine's: of figures that are known, and of objects of several meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.figures import CellFigures, QualitySummary, cell_figures, summarize
from odt_plugins.mesh.seen import as_seen
from odt_plugins.options import Options
from odt_plugins.report.report import Report, described, versions


def bare_report(
    before: QualitySummary, after: QualitySummary,
    histograms: Sequence[tuple[int, ...]], options: Options, **told: Any,
) -> Report:
    """Make a report of figures that are known, without those of an engine.

    Parameters
    ----------
    before, after : QualitySummary
    histograms : two tuples of int     of the radius ratio, before and after
    options : Options
    **told                             other fields of the report
    """
    rest: dict[str, Any] = {"energy": (), "times": {}, "stop_reason": "", "fallback": None,
                            "counts": {}, "n_used": 0, "n_movable": 0, "binding": ()}
    return Report(
        dim=before.dim, before=before, after=after, histogram_before=histograms[0],
        histogram_after=histograms[1],
        **rest | {"options": described(options), "versions": versions()} | told)


def report_of_parts(parts: Sequence[Report]) -> Report:
    """Make one report of those of the parts of an object."""
    (before, start), (after, end) = (_whole(parts, when) for when in (0, 1))
    told: dict[str, Any] = {
        name: {key: sum(getattr(part, name).get(key, 0) for part in parts)
               for part in parts for key in getattr(part, name)} for name in ("times", "counts")}
    told |= {name: sum(getattr(part, name) for part in parts)
             for name in ("n_used", "n_movable", "layers")}
    told |= {name: tuple(dict.fromkeys(one for part in parts for one in getattr(part, name)))
             for name in ("regions_from", "interpolated")}
    fallbacks = [part.fallback for part in parts if part.fallback]
    histograms = [tuple(map(sum, zip(*(getattr(part, name) for part in parts), strict=True)))
                  for name in ("histogram_before", "histogram_after")]
    return replace(
        parts[0], name="", before=before, after=after, histogram_before=histograms[0],
        histogram_after=histograms[1], energy=(),
        stop_reason="", fallback="; ".join(fallbacks) or None, binding=(), slid=None, surface=None,
        cell_origin=None, notes=(), untangled=None, curved=None, integrals={},
        point_integrals={}, vetoed=None, carrying=None, plane=None,
        meshes=(start, end), metrics=(), parts=tuple(parts), **told)


def _whole(
    parts: Sequence[Report], when: int
) -> tuple[QualitySummary, tuple[NDArray[Any], NDArray[Any]]]:
    """Figures, and points and cells, of all parts together, before (0) or after (1)."""
    meshes = [part.meshes[when] for part in parts]
    own = [(part.before, part.after)[when] for part in parts]
    # Parts in a plane have two coordinates beside those in space.
    wide = max(points.shape[1] for part in parts for points, _ in part.meshes)
    points = np.concatenate([np.pad(x, [(0, 0), (0, wide - x.shape[1])]) for x, _ in meshes])
    first = np.cumsum([0, *(len(x) for x, _ in meshes)])
    cells = np.concatenate([rows + at for (_, rows), at in zip(meshes, first, strict=False)])
    figures = [cell_figures(*as_seen(*mesh, part.metrics[when]))
               for mesh, part in zip(meshes, parts, strict=True)]
    found = summarize(points, cells, CellFigures(*map(np.concatenate, zip(*figures, strict=True))))
    return replace(found, n_points=sum(one.n_points for one in own),
                   volume=sum(one.volume for one in own),
                   turned=sum(one.turned for one in own)), (points, cells)
