"""Netgen's own files, `.vol`, by Netgen: meshio knows the sections of its older files only."""

from __future__ import annotations

import os
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from odt_plugins.adapters.formats.vol import ORDERS


def installed() -> bool:
    """Say whether Netgen is there."""
    return find_spec("netgen") is not None


def read(path: Path) -> Any:
    """Read a file by Netgen.

    Returns
    -------
    meshio.Mesh    lines, triangles and tetrahedra of one order, with the cell data
                   ``netgen:index``: materials of tetrahedra, boundary conditions of triangles

    Raises
    ------
    Exception      anything at all, on a file that is broken
    """
    from meshio import Mesh
    from netgen.meshing import Mesh as NetgenMesh

    mesh = NetgenMesh()
    whole = str(path.resolve())
    # Netgen writes into the directory in which it runs.
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        mesh.Load(whole)
        os.chdir("/")
    points = np.array(mesh.Coordinates(), dtype=np.float64)
    condition = np.array([0] + [mesh.FaceDescriptor(i + 1).bc
                                for i in range(mesh.GetNFaceDescriptors())])
    cells: list[Any] = []
    labels = []
    for elements, corners, kind in ((mesh.Elements2D(), 3, "triangle"),
                                    (mesh.Elements3D(), 4, "tetra")):
        table = elements.NumPy()
        if not len(table):
            continue
        nodes = np.array([element.vertices for element in elements], dtype=object)
        if any(len(row) != corners for row in nodes):
            msg = f"it has elements other than {kind}"
            raise ValueError(msg)
        sizes = {len(element.points) for element in elements}
        size = max(sizes)
        if len(sizes) > 1 or size not in (corners, {3: 6, 4: 10}[corners]):
            msg = "it has elements of several orders, or of more than the second"
            raise ValueError(msg)
        name = kind if size == corners else f"{kind}{size}"
        order = np.argsort(ORDERS.get(name, range(size)))
        cells.append((name, (table["nodes"].astype(np.int64) - 1)[:, order]))
        index = table["index"].astype(np.int64)
        labels.append(condition[index] if corners == 3 else index)
    return Mesh(points, cells, None, {"netgen:index": labels})
