"""A tree of boxes around labelled triangles: the closest of one label, in compiled code."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.closest import closest_on_triangle
from odt_plugins.engine.topology.order import morton_keys
from odt_plugins.mesh.arrays import FloatArray, IntArray, LongArray

LEAF = 4
"""Triangles of a leaf."""


class Boxes(NamedTuple):
    """A complete binary tree: the children of node i are 2 i and 2 i + 1, the root is 1.

    Attributes
    ----------
    points : (n, 3) float64, triangles : (m, 3) int32    a segment is a triangle with its end twice
    label : (m,) int32
    order : (m,) int32          triangles by label and then along a curve; LEAF a leaf
    box : (2 q, 6) float64      least and largest coordinates
    labels : (2 q, 2) int32     least and largest label
    stack : (64,) int64         work array of a query
    """

    points: FloatArray
    triangles: IntArray
    label: IntArray
    order: IntArray
    box: FloatArray
    labels: IntArray
    stack: LongArray


def make_boxes(points: FloatArray, triangles: IntArray, label: IntArray) -> Boxes:
    """Build the tree; there may be no triangle."""
    m = len(triangles)
    corners = points[triangles]
    order = np.zeros(0, dtype=np.intp)
    if m:
        along = morton_keys(np.ascontiguousarray(corners.mean(axis=1)))
        order = np.lexsort((along, label))
    leaves = 1 << max(0, math.ceil(math.log2(max(1, -(-m // LEAF)))))
    box = np.empty((2 * leaves, 6))
    box[:, :3], box[:, 3:] = np.inf, -np.inf
    labels = np.empty((2 * leaves, 2), dtype=np.int32)
    labels[:, 0], labels[:, 1] = np.iinfo(np.int32).max, -1
    leaf = leaves + np.arange(m) // LEAF
    np.minimum.at(box[:, :3], leaf, corners[order].min(axis=1))
    np.maximum.at(box[:, 3:], leaf, corners[order].max(axis=1))
    np.minimum.at(labels[:, 0], leaf, label[order])
    np.maximum.at(labels[:, 1], leaf, label[order])
    first = leaves // 2
    while first >= 1:
        own, below = slice(first, 2 * first), slice(2 * first, 4 * first)
        for array, at, choose in ((box, slice(0, 3), np.minimum), (box, slice(3, 6), np.maximum),
                                  (labels, slice(0, 1), np.minimum),
                                  (labels, slice(1, 2), np.maximum)):
            pairs = array[below, at]
            array[own, at] = choose(pairs[::2], pairs[1::2])
        first //= 2
    return Boxes(
        np.ascontiguousarray(points), np.ascontiguousarray(triangles, dtype=np.int32),
        np.ascontiguousarray(label, dtype=np.int32), order.astype(np.int32), box, labels,
        np.empty(64, dtype=np.int64),
    )


@kernel
def _gap(box: FloatArray, node: int, x: float, y: float, z: float) -> float:
    """Squared distance of a point from the box of a node."""
    dx = max(box[node, 0] - x, 0.0, x - box[node, 3])
    dy = max(box[node, 1] - y, 0.0, y - box[node, 4])
    dz = max(box[node, 2] - z, 0.0, z - box[node, 5])
    return dx * dx + dy * dy + dz * dz


@kernel
def closest_of(
    boxes: Boxes, label: int, x: float, y: float, z: float, limit: float
) -> tuple[float, int, float, float, float]:
    """Closest point of the triangles of a label within a squared distance.

    Returns
    -------
    squared distance : float
    triangle : int             -1 where none is as close
    x, y, z : float
    """
    stack, box, labels = boxes.stack, boxes.box, boxes.labels
    leaves = box.shape[0] // 2
    best, found, fx, fy, fz = limit, -1, x, y, z
    stack[0] = 1
    top = 1
    for _ in range(2 * box.shape[0]):
        if top == 0:
            break
        top -= 1
        node = stack[top]
        if labels[node, 0] > label or labels[node, 1] < label or _gap(box, node, x, y, z) > best:
            continue
        if node < leaves:
            left, right = 2 * node, 2 * node + 1
            if _gap(box, left, x, y, z) < _gap(box, right, x, y, z):
                left, right = right, left
            stack[top] = left
            stack[top + 1] = right
            top += 2
            continue
        first = (node - leaves) * LEAF
        for i in range(first, min(first + LEAF, boxes.order.shape[0])):
            t = boxes.order[i]
            if boxes.label[t] != label:
                continue
            tri = boxes.triangles
            d, _, cx, cy, cz = closest_on_triangle(
                x, y, z, boxes.points, tri[t, 0], tri[t, 1], tri[t, 2])
            if d < best or (found < 0 and d <= best):
                best, found, fx, fy, fz = d, t, cx, cy, cz
    return best, found, fx, fy, fz
