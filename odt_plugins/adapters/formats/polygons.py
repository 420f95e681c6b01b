"""Faces of a surface as blocks of cells: those of as many corners together."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import MeshFileError

KINDS = {1: "vertex", 2: "line", 3: "triangle", 4: "quad"}
"""Types of cells by their number of corners; those of more are polygons."""


def as_mesh(
    points: NDArray[Any], faces: list[list[int]] | NDArray[np.integer]
) -> tuple[Any, list[NDArray[np.int64]]]:
    """Make a mesh of faces.

    Parameters
    ----------
    points : (n, 3)
    faces : list of lists of int, or (m, k) int    corners of every face

    Returns
    -------
    mesh : meshio.Mesh      triangles first, then the others by their number of corners
    order : list of (q,)    faces of every block

    Raises
    ------
    MeshFileError           a face refers to a vertex that is not there
    """
    from meshio import Mesh

    sizes = np.array([len(face) for face in faces], dtype=np.int64)
    kinds = sorted(set(sizes.tolist()), key=lambda size: (size != 3, size))
    order = [np.flatnonzero(sizes == size) for size in kinds]
    blocks: Any = []
    for size, rows in zip(kinds, order, strict=True):
        cells = np.array([faces[i] for i in rows.tolist()], dtype=np.int64).reshape(-1, size)
        bad = cells[(cells < 0) | (cells >= len(points))]
        if bad.size:
            msg = f"a face refers to vertex {bad[0]} of {len(points)}"
            raise MeshFileError(msg)
        blocks.append((KINDS.get(size, "polygon"), cells))
    return Mesh(points, blocks), order
