"""Meshes in pieces on disk, written and read by meshio alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import meshio
import numpy as np


def write_pieces(
    folder: Path, points: Any, cells: Any, label: Any, ids: Any = None, **data: Any
) -> Path:
    """Write the cells of every label as a file, and the .pvtu file that names them."""
    folder.mkdir()
    names = []
    for k in np.unique(label):
        members = np.flatnonzero(label == k)
        used, number = np.unique(cells[members], return_inverse=True)
        names.append(f"piece-{k}.vtu")
        meshio.Mesh(points[used], [("tetra", number.reshape(-1, 4))],
                    point_data={"was": used} | (
                        {} if ids is None else {"GlobalPointIds": ids[used]}),
                    cell_data={name: [values[members]] for name, values in data.items()},
                    ).write(folder / names[-1])
    named = "".join(f'<Piece Source="{folder.name}/{name}"/>' for name in names)
    index = folder.with_suffix(".pvtu")
    index.write_text('<VTKFile type="PUnstructuredGrid"><PUnstructuredGrid GhostLevel="0">'
                     f"{named}</PUnstructuredGrid></VTKFile>")
    return index


def glued(index: Path, n: int) -> tuple[Any, Any, Any, Any]:
    """The whole mesh again, by the point array that names the vertices of the input."""
    points = np.full((n, 3), np.nan)
    cells, regions, ids = [], [], np.full(n, -1)
    for piece in ElementTree.parse(index).getroot().iter("Piece"):
        mesh = meshio.read(index.parent / piece.get("Source"))
        was = mesh.point_data["was"]
        known = ~np.isnan(points[was, 0])
        assert np.array_equal(points[was[known]], mesh.points[known])
        assert np.array_equal(ids[was[known]], mesh.point_data["GlobalPointIds"][known])
        points[was], ids[was] = mesh.points, mesh.point_data["GlobalPointIds"]
        cells.append(was[mesh.cells[0].data])
        regions.append(mesh.cell_data.get("marker", [np.zeros(len(cells[-1]), np.int64)])[0])
    assert len(np.unique(ids)) == n
    return points, np.concatenate(cells), np.concatenate(regions), ids
