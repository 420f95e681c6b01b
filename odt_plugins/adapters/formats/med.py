"""MED files of Salome and Code_Aster, by h5py: groups of cells and of nodes are sets."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import MeshFileError

TYPES = {"PO1": "vertex", "SE2": "line", "SE3": "line3", "TR3": "triangle", "TR6": "triangle6",
         "TR7": "triangle7", "QU4": "quad", "QU8": "quad8", "QU9": "quad9", "TE4": "tetra",
         "T10": "tetra10", "HE8": "hexahedron", "H20": "hexahedron20", "PY5": "pyramid",
         "P13": "pyramid13", "PE6": "wedge", "P15": "wedge15"}
"""Types of cells by their names in files."""

TURNED = {
    "tetra": [0, 2, 1, 3], "tetra10": [0, 2, 1, 3, 6, 5, 4, 7, 9, 8],
    "pyramid": [0, 3, 2, 1, 4], "pyramid13": [0, 3, 2, 1, 4, 8, 7, 6, 5, 9, 12, 11, 10],
    "wedge": [0, 2, 1, 3, 5, 4],
    "wedge15": [0, 2, 1, 3, 5, 4, 8, 7, 6, 11, 10, 9, 12, 14, 13],
    "hexahedron": [0, 3, 2, 1, 4, 7, 6, 5],
    "hexahedron20": [0, 3, 2, 1, 4, 7, 6, 5, 11, 10, 9, 8, 15, 14, 13, 12, 16, 19, 18, 17],
}
"""Places in files of the nodes of cells in space, which are the other way round there."""

CELL_TAGS, POINT_TAGS = "cell_tags", "point_tags"
"""Arrays of the numbers of the families of cells and of points."""

LONGEST = 80
"""Letters of the name of a group."""

WHOLE = b"MED_NO_PROFILE_INTERNAL"
"""Name of the profile of all cells or points."""


class Cells(NamedTuple):
    """Cells of a type: its name in the file, its type, rows of nodes, and whether these turn."""

    word: str
    kind: str
    rows: NDArray[np.int64]
    turned: bool


def read(path: Path) -> Any:
    """Read the one mesh of a file with its groups and the fields at all of their times.

    Returns
    -------
    meshio.Mesh      a block a type; groups of cells and nodes are cell and point sets, and
                     ``cell_tags`` and ``point_tags``, arrays and attributes, tell of families

    Raises
    ------
    MeshFileError    it has several meshes or steps of one, or cells of an unknown type
    """
    import h5py
    from meshio import Mesh

    with h5py.File(path, "r") as file:
        name, step = step_of(file)
        points = points_of(file, name, step)
        blocks = cells_of(step, points)
        for block in blocks:
            bad = block.rows[(block.rows < 0) | (block.rows >= len(points))]
            if bad.size:
                msg = f"a {block.kind} refers to node {bad[0] + 1} of {len(points)}"
                raise MeshFileError(msg)
        families = file[f"FAS/{name}"] if f"FAS/{name}" in file else {}
        of_cells = names_of(families["ELEME"]) if "ELEME" in families else {}
        of_points = names_of(families["NOEUD"]) if "NOEUD" in families else {}
        point_data: dict[str, Any] = {}
        cell_data: dict[str, Any] = {}
        if "FAM" in step["NOE"]:
            point_data[POINT_TAGS] = step["NOE"]["FAM"][()]
        if any("FAM" in step["MAI"][block.word] for block in blocks):
            cell_data[CELL_TAGS] = [
                step["MAI"][block.word]["FAM"][()] if "FAM" in step["MAI"][block.word]
                else np.zeros(len(block.rows), dtype=np.int64) for block in blocks]
        for found in fields_of(file, name):
            _add_field(file, found, blocks, len(points), point_data, cell_data)
        mesh = Mesh(points, [(block.kind, block.rows) for block in blocks], point_data, cell_data)
        tags = cell_data.get(CELL_TAGS, [])
        for number, names in of_cells.items():
            for group in names:
                rows = mesh.cell_sets.setdefault(group, [np.zeros(0, np.int64) for _ in blocks])
                for i, values in enumerate(tags):
                    rows[i] = np.union1d(rows[i], np.flatnonzero(values == number))
        for number, names in of_points.items():
            for group in names:
                nodes = np.flatnonzero(point_data.get(POINT_TAGS, np.zeros(0)) == number)
                mesh.point_sets[group] = np.union1d(
                    mesh.point_sets.get(group, nodes), nodes).astype(np.int64)
    setattr(mesh, CELL_TAGS, of_cells)
    setattr(mesh, POINT_TAGS, of_points)
    return mesh


def write(path: Path, mesh: Any, binary: bool | None) -> list[str]:
    """Write a mesh with families by meshio, and names that the MED library reads.

    meshio names families by all of their groups, which may be longer than MED allows or have
    slashes, and writes letters of groups that are not of ASCII as others.
    """
    import h5py
    import meshio

    kinds = {"ELEME": getattr(mesh, "cell_tags", {}), "NOEUD": getattr(mesh, "point_tags", {})}
    mesh.cell_tags, mesh.point_tags = (
        {number: [str(i) for i in range(len(names))] for number, names in families.items()}
        for families in kinds.values())
    meshio.write(path, mesh, file_format="med")
    mesh.cell_tags, mesh.point_tags = kinds.values()
    with h5py.File(path, "r+") as file:
        for home in file["FAS"].values():
            for kind in [word for word in kinds if word in home]:
                for word, family in list(home[kind].items()):
                    number = int(family.attrs["NUM"])
                    letters = [name.encode().ljust(LONGEST, b"\0") for name in kinds[kind][number]]
                    family["GRO"]["NOM"][...] = np.frombuffer(
                        b"".join(letters), dtype=np.int8).reshape(-1, LONGEST)
                    home[kind].move(word, f"FAM_{number}")
    return []


def step_of(file: Any) -> tuple[str, Any]:
    """Name of the mesh, and where its nodes and cells are.

    Raises
    ------
    MeshFileError    there are several, or none
    """
    meshes = list(file["ENS_MAA"])
    if len(meshes) != 1:
        msg = f"it has {len(meshes)} meshes ({', '.join(meshes)[:60]}), expected one"
        raise MeshFileError(msg)
    mesh = file["ENS_MAA"][meshes[0]]
    if "NOE" in mesh:
        return meshes[0], mesh
    steps = list(mesh)
    if len(steps) != 1:
        msg = f"its mesh has {len(steps)} steps, expected one"
        raise MeshFileError(msg)
    return meshes[0], mesh[steps[0]]


def points_of(file: Any, name: str, step: Any) -> NDArray[np.float64]:
    """Places (n, dimension)."""
    table = step["NOE"]["COO"]
    count = int(table.attrs["NBR"])
    return np.asarray(table[()], dtype=np.float64).reshape(
        (count, int(file["ENS_MAA"][name].attrs["ESP"])), order="F")


def cells_of(step: Any, points: NDArray[Any]) -> list[Cells]:
    """Cells by type, with positive tetrahedra where most of the file are the other way round.

    Raises
    ------
    MeshFileError    their type is unknown
    """
    blocks = []
    for word, group in step["MAI"].items():
        if word not in TYPES:
            msg = f"it has cells of type {word}"
            raise MeshFileError(msg)
        table = group["NOD"]
        rows = np.asarray(table[()], dtype=np.int64).reshape(
            (int(table.attrs["NBR"]), -1), order="F") - 1
        blocks.append(Cells(word, TYPES[word], rows, False))
    corners = [block.rows[:, :4] for block in blocks if block.kind in ("tetra", "tetra10")]
    if not corners or points.shape[1] != 3:
        return blocks
    tets = np.concatenate(corners)
    tets = tets[((tets >= 0) & (tets < len(points))).all(axis=1)]
    sides = points[tets[:, 1:]] - points[tets[:, :1]]
    volumes = (np.cross(sides[:, 0], sides[:, 1]) * sides[:, 2]).sum(axis=1)
    if 2 * (volumes < 0).sum() <= len(tets):
        return blocks
    return [block if block.kind not in TURNED else
            block._replace(rows=block.rows[:, TURNED[block.kind]], turned=True)
            for block in blocks]


def names_of(families: Any) -> dict[int, list[str]]:
    """Names of the groups of every family, whatever type the letters have."""
    return {int(family.attrs["NUM"]): [
        word.split(b"\0")[0].decode("utf-8", "replace").strip() for word in words_of(family)]
        for family in families.values()}


def words_of(family: Any) -> list[bytes]:
    """Letters of the names of the groups of a family."""
    groups = family.get("GRO")
    count = int(groups.attrs["NBR"]) if groups is not None else 0
    letters = np.ascontiguousarray(groups["NOM"][()]).tobytes() if count else b""
    width = len(letters) // max(count, 1)
    return [letters[k * width: (k + 1) * width] for k in range(count)]


class Field(NamedTuple):
    """One time step of a field: its title, its group in the file, and its supports.

    Attributes
    ----------
    title : str
    group : h5py group          of that time
    supports : list of str      "NOE" of points, "MAI.TE4" of cells, "NOE.TE4" of corners of cells
    """

    title: str
    group: Any
    supports: list[str]


def fields_of(file: Any, mesh: str) -> list[Field]:
    """Fields on a mesh, each at all its times; several have their number and the time behind."""
    out = []
    for name, field in (file["CHA"].items() if "CHA" in file else ()):
        on = field.attrs.get("MAI", mesh)
        if (on.decode() if isinstance(on, bytes) else str(on)).strip("\0 ") not in ("", mesh):
            continue
        times = sorted(field)
        for i, key in enumerate(times):
            group = field[key]
            title = name if len(times) == 1 else f"{name}[{i}] - {float(group.attrs['PDT']):g}"
            out.append(Field(title, group, list(group)))
    return out


def values_of(file: Any, support: Any, count: int) -> Any:
    """Values (count, points of Gauss, components), not a number where a profile leaves one out.

    Returns
    -------
    None    where there are several profiles, or they do not fit
    """
    profiles = list(support)
    if len(profiles) != 1:
        return None
    table = support[profiles[0]]
    rows = None
    if profiles[0].encode() != WHOLE:
        rows = file["PROFILS"][profiles[0]]["PFL"][()] - 1
    size = count if rows is None else len(rows)
    gauss = int(table.attrs.get("NGA", 1)) or 1
    data = np.asarray(table["CO"][()])
    if not size or data.size % (size * gauss):
        return None
    values = data.reshape((size, gauss, -1), order="F")
    if rows is None:
        return values
    out = np.full((count, *values.shape[1:]), np.nan)
    out[rows] = values
    return out


def _add_field(
    file: Any, found: Field, blocks: list[Cells], count: int, point_data: Any, cell_data: Any
) -> None:
    """Add a field to the arrays of points or of cells."""
    words = [block.word for block in blocks]
    for support in found.supports:
        if support == "NOE":
            values = values_of(file, found.group[support], count)
            if values is not None:
                point_data[found.title] = as_array(values)
            continue
        word = support.partition(".")[2]
        if word not in words:
            continue
        k = words.index(word)
        values = values_of(file, found.group[support], len(blocks[k].rows))
        if values is None:
            continue
        own = as_array(values)
        parts = cell_data.setdefault(found.title, [
            np.full((len(block.rows), *own.shape[1:]), np.nan) for block in blocks])
        if parts[k].shape == own.shape:
            parts[k] = own


def as_array(values: NDArray[Any]) -> NDArray[Any]:
    """Values (n, points of Gauss, components) without what is of length one."""
    if values.shape[1] > 1:
        return values
    return values[:, 0, 0] if values.shape[2] == 1 else values[:, 0]
