"""Feet of the vertices of a surface from which all of its pieces between feature lines are reached.

Walks over the ground do not cross feature lines. A piece all of whose vertices are on lines, as a
cap that CAD has cut into ears, is reached from those alone whose foot is on it.
"""

from __future__ import annotations

import numpy as np

from odt_plugins.mesh.arrays import IntArray


def reaching(triangles: IntArray, foot: IntArray, patch: IntArray) -> IntArray:
    """Change feet so that every triangle has a corner whose foot lies on the piece of the triangle.

    Parameters
    ----------
    triangles : (m, 3) int32
    foot : (n,) int32           triangle of the star of every vertex
    patch : (m,) int32          number of the piece that every triangle is on

    Returns
    -------
    (n,) int32                  feet; the vertex is taken whose foot most such triangles miss and
                                fewest others need
    """
    missing = (patch[foot[triangles]] != patch[:, None]).all(axis=1)
    if not missing.any():
        return foot
    foot = foot.copy()
    order = np.argsort(triangles, axis=None, kind="stable")
    start = np.searchsorted(triangles.ravel()[order], np.arange(len(foot) + 1))
    for t in np.flatnonzero(missing).tolist():
        corners = triangles[t]
        if (patch[foot[corners]] == patch[t]).any():
            continue
        best, chosen = -np.inf, -1
        for v in corners.tolist():
            star = order[start[v]: start[v + 1]] // 3
            there = patch[foot[triangles[star]]] == patch[star][:, None]
            count = there.sum(axis=1)
            own = patch[star] == patch[foot[v]]
            gain = float((count[patch[star] == patch[t]] == 0).sum() - (count[own] == 1).sum())
            if gain > best:
                best, chosen = gain, v
        foot[chosen] = t
    return foot
