"""Slow, obvious distances between points and triangles, by another route than the kernels."""

from __future__ import annotations

import numpy as np


def to_segment(x, a, b):
    """Distances of points (k, 3) to one segment, (k,)."""
    d = b - a
    length = d @ d
    w = np.clip((x - a) @ d / length, 0.0, 1.0) if length > 0.0 else np.zeros(len(x))
    return np.linalg.norm(x - a - w[:, None] * d, axis=1)


def to_triangle(x, a, b, c):
    """Distances of points (k, 3) to one triangle, (k,): to its plane, or to its edges."""
    best = np.minimum(np.minimum(to_segment(x, a, b), to_segment(x, b, c)), to_segment(x, c, a))
    n = np.cross(b - a, c - a)
    length = np.linalg.norm(n)
    if length > 0.0:
        n = n / length
        height = (x - a) @ n
        q = x - height[:, None] * n
        inside = np.ones(len(x), dtype=bool)
        for i, j in ((a, b), (b, c), (c, a)):
            inside &= np.cross(j - i, q - i) @ n >= 0.0
        best[inside] = np.minimum(best[inside], np.abs(height[inside]))
    return best


def to_surface(x, points, triangles):
    """Distances of points (k, 3) to a surface, (k,)."""
    return np.min([to_triangle(x, *points[t]) for t in triangles], axis=0)


def samples(points, triangles, k):
    """Points on every triangle, (m, (k + 1) (k + 2) / 2, 3): corners, edges and inside alike."""
    i, j = np.meshgrid(np.arange(k + 1), np.arange(k + 1), indexing="ij")
    keep = i + j <= k
    w = np.stack([i[keep], j[keep], k - i[keep] - j[keep]], axis=1) / k
    return np.einsum("qi,mij->mqj", w, points[triangles])
