"""What a baseline hands to the worker: the call that is timed, and how to read its result."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.compare.start import StartMesh
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.simplex import reverse

Settings = Mapping[str, Any]
"""Settings of a contestant, as they stand in its row; plain numbers and strings."""


class Task(NamedTuple):
    """A start mesh in the tool's own form.

    Attributes
    ----------
    call : callable       the optimising call alone; its time is what the table shows
    collect : callable    takes what `call` returned and gives (points, cells), or (points, cells,
                          regions) where the tool respects the regions of the start
    details : callable    takes the same and gives seconds of its parts, by name
    """

    call: Callable[[], Any]
    collect: Callable[[Any], tuple[NDArray[Any] | None, ...]]
    details: Callable[[Any], dict[str, float]] | None = None


class NotPossibleError(Exception):
    """The tool cannot take this start mesh; the message says why."""


def flipped(cells: IntArray) -> IntArray:
    """All cells with the other orientation, for tools that want negative ones."""
    return reverse(cells, np.ones(len(cells), dtype=np.bool_))


def mean_edge(start: StartMesh) -> float:
    """Mean length of the edges of a start mesh."""
    return float(edge_lengths(start.points, start.cells).mean())


def edge_lengths(points: FloatArray, cells: IntArray) -> FloatArray:
    """Lengths (e,) of all edges, each once."""
    corners = combinations(range(cells.shape[1]), 2)
    pairs = np.concatenate([cells[:, pair] for pair in corners])
    ends = points[np.unique(np.sort(pairs, axis=1), axis=0)]
    return np.asarray(np.sqrt(((ends[:, 0] - ends[:, 1]) ** 2).sum(axis=1)))


def wanted_size(start: StartMesh, settings: Settings) -> float:
    """Length that edges are to have: the setting `size`, or their mean in the start."""
    return float(settings["size"]) if "size" in settings else mean_edge(start)


def in_space(points: FloatArray) -> FloatArray:
    """Points (n, 3) of planar points (n, 2), z = 0."""
    if points.shape[1] == 3:
        return points
    return np.column_stack([points, np.zeros(len(points))])
