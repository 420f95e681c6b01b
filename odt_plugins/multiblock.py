"""Optimise the parts of an object one by one: blocks, geometries of a scene, meshes of a model."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from numbers import Integral
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters import open3d_model, pyvista_blocks, trimesh_scene
from odt_plugins.adapters.fields import expect_arrays
from odt_plugins.adapters.regions import CHARTS, are_names
from odt_plugins.adapters.registry import find_adapter
from odt_plugins.errors import InvalidOptionError, ODTError, counted, reworded
from odt_plugins.mesh.numbers import vertex_mask
from odt_plugins.progress import part, telling

WHOLES: tuple[Any, ...] = (pyvista_blocks, trimesh_scene, open3d_model)
"""Adapters of objects of several meshes."""

GRID = 1e-9
"""Distance, as a part of the extent of all, below which vertices of two parts are at one place."""


class _Shown(NamedTuple):
    """A part where it is shown: its number, the places (n, 3) of its vertices, its cells."""

    number: int
    places: NDArray[np.float64]
    cells: NDArray[np.int64]


def has_parts(mesh: object) -> bool:
    """Say whether an object consists of several meshes."""
    return any(whole.matches(mesh) for whole in WHOLES)


def run_parts(
    mesh: Any, options: Mapping[str, Any], one: Callable[..., tuple[Any, Any]],
    *, slides: bool = False, totals: Mapping[str, Any] = {}, named: Mapping[str, Any] = {},
) -> tuple[Any, list[Any]]:
    """Optimise every part of an object by itself.

    Parameters
    ----------
    mesh : object      of which :func:`has_parts` is true
    options : dict
    one : callable     optimises a part with options: its result and report
    slides : bool      whether boundaries slide unless options say; then those of parts that touch
                       stay
    totals : dict      numbers of "cells" and "vertices" of all parts, of which each gets a share in
                       proportion to its own
    named : dict       names of arrays by "size" and "adapt", which every part must have, as that of
                       a metric in `options`

    Returns
    -------
    result : same type as `mesh`
    reports : list     of every part that was optimised

    Raises
    ------
    InvalidOptionError    boundaries shall slide where parts touch
    ODTError              what one part raises, with its name
    """
    whole = next(whole for whole in WHOLES if whole.matches(mesh))
    if options.get("reference") is not None:
        msg = (f"got reference= for an object of several {whole.PARTS}; expected one mesh, try its "
               f"{whole.PARTS} one by one")
        raise InvalidOptionError(msg)
    names = whole.chosen(mesh)
    parts = [whole.part_at(mesh, key) for key in names]
    regions = options.get("regions")
    labels = regions if are_names(regions) and regions != CHARTS else None
    shown, own = [], []
    for i, (key, name) in enumerate(names.items()):
        host = _named(whole.PART, name, find_adapter(parts[i]).read, parts[i], labels)
        _named(whole.PART, name, expect_arrays, host, metric=options.get("metric"), **named)
        own.append({"cells": len(host.cells), "vertices": len(np.unique(host.cells))})
        shown += [_Shown(i, places, np.asarray(host.cells, dtype=np.int64))
                  for places in whole.placed(mesh, key, np.asarray(host.points, np.float64))]
    touch, rims = _shared(shown)
    if options.get("boundary") == "slide" and touch:
        msg = (f"got boundary='slide' for {whole.PARTS} that touch, which would come apart; "
               f"expected boundary='fixed', try {whole.TOGETHER}")
        raise InvalidOptionError(msg)
    results, reports = [], []
    with telling(options.get("progress"), "preparing") as progress:
        for i, name in enumerate(names.values()):
            stays = slides and i in touch and "boundary" not in options
            told: dict[str, Any] = {"boundary": "fixed"} if stays else {}
            told |= {name: _share(total, own[i][name], sum(count[name] for count in own))
                     for name, total in totals.items()}
            if options.get("progress"):
                told["progress"] = part(progress, i / len(parts), (i + 1) / len(parts))
            held = rims.get(i)
            if held is not None:
                told["fixed"] = held | _named(whole.PART, name, vertex_mask, options.get("fixed"),
                                              len(held), "fixed", "vertices")
            result, report = _named(whole.PART, name, one, parts[i], **{**options, **told})
            if stays:
                note = (f"the boundary stays, since this {whole.PART} touches another one; try "
                        f"{whole.TOGETHER}")
                report = replace(report, notes=(*report.notes, note))
            if held is not None:
                rim = f"at the rim of another {whole.PART}"
                stay = counted(int(held.sum()), f"vertex {rim} stays", f"vertices {rim} stay")
                note = f"{stay}, so that it stays there"
                report = replace(report, notes=(*report.notes, note))
            results.append(result)
            reports.append(replace(report, name=name))
    return whole.replaced(mesh, dict(zip(names, results, strict=True))), reports


def _share(total: Any, count: int, of: int) -> Any:
    """The share, at least 1, that a part with a count of all has in a total, if it is a number."""
    good = isinstance(total, Integral) and not isinstance(total, bool) and int(total) >= 1
    return max(1, round(int(total) * count / max(of, 1))) if good else total


def _named(kind: str, name: str, call: Callable[..., Any], *given: Any, **options: Any) -> Any:
    """What a call returns; errors of this package name the part that raised them."""
    try:
        return call(*given, **options)
    except ODTError as exc:
        msg = f"{kind} {name!r}: {exc}"
        raise reworded(exc, msg, type(exc)) from exc


def _shared(shown: Sequence[_Shown]) -> tuple[set[int], dict[int, NDArray[np.bool_]]]:
    """Find the places that several parts share.

    Parameters
    ----------
    shown : list of _Shown    parts may be there several times

    Returns
    -------
    touch : set of int        numbers of the parts with such places
    rims : dict of (n,) bool  by the number of the part its vertices at such places where the
                              surface of another part ends and its own does not, if it has any
    """
    if len(shown) < 2:
        return set(), {}
    places = np.concatenate([some.places for some in shown])
    low, high = places.min(axis=0), places.max(axis=0)
    size = math.sqrt(float(((high - low) ** 2).sum()))
    if not np.isfinite(size) or size == 0.0:
        return set(), {}
    rows = np.rint((places - low) / (GRID * size)).astype(np.int64)
    at = np.unique(rows, axis=0, return_inverse=True)[1].ravel()
    ends = np.cumsum([len(some.places) for some in shown])
    own = [np.asarray(piece) for piece in np.split(at, ends[:-1])]
    seen = np.bincount(np.concatenate([np.unique(piece) for piece in own]), minlength=len(at))
    rims = []
    for some, piece in zip(shown, own, strict=True):
        rim = np.zeros(len(seen), dtype=np.bool_)
        cells = some.cells
        if cells.shape[1] == 3 and cells.size and 0 <= cells.min() <= cells.max() < len(piece):
            corners = piece[cells]
            edges = np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
            edge, times = np.unique(edges, axis=0, return_counts=True)
            rim[edge[times == 1]] = True
        rims.append(rim)
    ends_there = np.logical_or.reduce(rims) & (seen > 1)
    held: dict[int, NDArray[np.bool_]] = {}
    for some, piece, rim in zip(shown, own, rims, strict=True):
        mask = (ends_there & ~rim)[piece] | held.get(some.number, np.zeros(len(piece), np.bool_))
        if mask.any():
            held[some.number] = mask
    touch = {some.number for some, piece in zip(shown, own, strict=True) if (seen[piece] > 1).any()}
    return touch, held
