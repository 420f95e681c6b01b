"""The nearest of some places, looked for in the boxes of a grid around a point."""

from __future__ import annotations

import math

import numpy as np

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.compiled.threads import pieces
from odt_plugins.engine.topology.star import Stars, vertex_stars
from odt_plugins.mesh.arrays import FloatArray, IntArray

IN_A_BOX = 2.0
"""Places in a box in the mean."""

GROWTH = 1.25
"""Factor by which boxes are widened until there are few enough."""

SLACK = 1e-6
"""Part of the width of a box that covers the rounding of where it ends."""


@kernel
def _boxes(
    places: FloatArray, low: FloatArray, width: float, shape: IntArray, box: IntArray
) -> None:
    """Box (m, 1) of every place."""
    for p in range(places.shape[0]):
        row = 0
        for axis in range(shape.shape[0]):
            step = int((places[p, axis] - low[axis]) / width)
            row = row * shape[axis] + max(0, min(step, shape[axis] - 1))
        box[p, 0] = row


@kernel
def _search(
    x: FloatArray, places: FloatArray, stars: Stars, low: FloatArray, width: float,
    shape: IntArray, found: IntArray,
) -> None:
    """Look for the nearest place, ring by ring, until no nearer one can lie further out."""
    for v in range(x.shape[0]):
        a = max(0, min(int((x[v, 0] - low[0]) / width), shape[0] - 1))
        b = max(0, min(int((x[v, 1] - low[1]) / width), shape[1] - 1))
        c = max(0, min(int((x[v, 2] - low[2]) / width), shape[2] - 1))
        best = math.inf
        for ring in range(max(shape[0], shape[1], shape[2])):
            # Every place of the rings so far is known up to this distance.
            known = math.inf
            for axis in range(3):
                own = a if axis == 0 else b if axis == 1 else c
                if own - ring >= 0:
                    known = min(known, x[v, axis] - low[axis] - (own - ring + 1) * width)
                if own + ring < shape[axis]:
                    known = min(known, (own + ring) * width - (x[v, axis] - low[axis]))
            known -= SLACK * width
            if known > 0.0 and best <= known * known:
                break
            for i in range(max(a - ring, 0), min(a + ring + 1, shape[0])):
                for j in range(max(b - ring, 0), min(b + ring + 1, shape[1])):
                    inner = abs(i - a) < ring and abs(j - b) < ring
                    step = 2 * ring if inner else 1
                    for k in range(c - ring, c + ring + 1, step):
                        if k < 0 or k >= shape[2]:
                            continue
                        row = (i * shape[1] + j) * shape[2] + k
                        for s in range(stars.indptr[row], stars.indptr[row + 1]):
                            p = stars.indices[s]
                            far = 0.0
                            for axis in range(3):
                                far += (x[v, axis] - places[p, axis]) ** 2
                            if far < best or (far == best and p < found[v]):
                                best = far
                                found[v] = p


def nearest(places: FloatArray, x: FloatArray) -> IntArray:
    """Say which of some places is the nearest of every point, the first of several.

    Parameters
    ----------
    places : (m, d) float64    m at least 1, d = 2 or 3
    x : (k, d) float64

    Returns
    -------
    (k,) int32
    """
    places, x = (np.pad(rows, [(0, 0), (0, 3 - rows.shape[1])]) for rows in (places, x))
    low, size = places.min(axis=0), np.ptp(places, axis=0)
    boxes = len(places) / IN_A_BOX
    longest = float(size.max())
    # As many cubes as there are boxes fill the space; the flatter that is, the fewer of them.
    width = longest / boxes if longest > 0.0 else 1.0
    while np.prod(np.floor(size / width) + 1.0) > boxes + 1.0:
        width *= GROWTH
    shape = (np.floor(size / width) + 1.0).astype(np.int32)
    box = np.empty((len(places), 1), dtype=np.int32)
    _boxes(places, low, width, shape, box)
    stars = vertex_stars(box, int(np.prod(shape)))
    found = np.empty(len(x), dtype=np.int32)
    for first, last in pieces(0, len(x)):
        _search(x[first:last], places, stars, low, width, shape, found[first:last])
    return found
