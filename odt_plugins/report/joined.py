"""Reports that are no engine's: of figures that are known, and of objects of several meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from odt_plugins.figures import QualitySummary, summarize
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
    meshes = []
    for when in (0, 1):
        points, cells, first = [], [], 0
        for part in parts:
            x, rows = part.meshes[when]
            # Parts in a plane have two coordinates beside those in space.
            points.append(np.pad(x, [(0, 0), (0, 3 - x.shape[1])]))
            cells.append(rows + first)
            first += len(x)
        meshes.append((np.concatenate(points), np.concatenate(cells)))
    before, after = (summarize(*mesh) for mesh in meshes)
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
        parts[0], before=replace(before, turned=sum(part.before.turned for part in parts)),
        after=after, histogram_before=histograms[0], histogram_after=histograms[1], energy=(),
        stop_reason="", fallback="; ".join(fallbacks) or None, binding=(), slid=None, surface=None,
        cell_origin=None, notes=(), untangled=None, curved=None, integrals={},
        point_integrals={}, vetoed=None, carrying=None, plane=None, meshes=tuple(meshes),
        parts=tuple(parts), **told)
