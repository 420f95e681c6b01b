"""Contestants that are no part of the package: functions of the caller's, and mesh files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from odt_plugins.adapters import files
from odt_plugins.adapters.regions import AUTO
from odt_plugins.compare.contestants import KINDS, OWN, Contestant
from odt_plugins.compare.runner import Run
from odt_plugins.compare.start import Kind, StartMesh, plain_name
from odt_plugins.errors import writing
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.plane import plane_frame
from odt_plugins.mesh.simplex import compact_labels, mesh_arrays


def of_file(path: Path, start: StartMesh) -> tuple[Contestant, Run]:
    """Take a mesh file as what somebody made of a start mesh.

    Parameters
    ----------
    path : Path          any format of meshio
    start : StartMesh

    Returns
    -------
    contestant, run      "unsupported" where the file holds another kind of mesh

    Raises
    ------
    MeshFileError, InvalidMeshError, UnsupportedMeshError
    """
    contestant = Contestant(path.name, OWN, (start.kind,), "",
                            remark="a mesh file; what made it, and in which time, is not known")
    host = files.read(path, AUTO)
    points, cells = mesh_arrays(host.points, host.cells)
    flat = points.shape[1] == 2 or (cells.shape[1] == 3 and plane_frame(points, cells) is not None)
    kind: Kind = "tets" if cells.shape[1] == 4 else "planar" if flat else "surface"
    if kind != start.kind:
        return contestant, Run("unsupported", f"{path} holds {KINDS[kind]}")
    if start.kind == "planar" and points.shape[1] == 3:
        points = points[:, :2] if start.frame is None else start.frame.to_plane(points)
    labels = None if host.regions is None else compact_labels(host.regions, len(cells))
    return contestant, Run("ok", meshes=[(np.ascontiguousarray(points), cells, labels)])


def keep_mesh(
    folder: Path, start: StartMesh, name: str, points: FloatArray, cells: IntArray,
    regions: IntArray | None,
) -> Path:
    """Write the start, or what a contestant made of it, as a file in a folder, which is made.

    Raises
    ------
    MeshFileError    it cannot be written
    """
    words = plain_name(f"{start.name}-{name}")
    with writing(f"into {folder}", "another --keep"):
        folder.mkdir(parents=True, exist_ok=True)
    space = points if start.frame is None else start.frame.to_space(points)
    files.write_arrays(folder / f"{words}.vtu", space, cells, regions)
    return folder / f"{words}.vtu"
