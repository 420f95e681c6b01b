"""The table of what each format of files keeps, found by writing a mesh of everything."""

from __future__ import annotations

import warnings
from pathlib import Path

import contract
import meshio
import numpy as np

from odt_plugins.adapters import files

SUFFIXES = (".vtu", ".vtk", ".msh", ".xdmf", ".med", ".inp", ".vol", ".mesh", ".meshb", ".avs",
            ".bdf", ".su2", ".b8.ugrid", ".ele", ".e", ".h5m", ".cgns", ".xml", ".dat", ".f3grid",
            ".hmf", ".mdpa", ".dato")


def mesh_of_everything():
    """Two volumes and two surfaces, as they are read from a file of Gmsh's, with arrays."""
    points, cells, labels = contract.grid(3, 2)
    rim = sorted(contract.facets(cells, labels))
    inner = np.array([[points[v][0] == 0.5 for v in face] for face in rim]).all(axis=1)
    points = points / 3
    skin = np.array(rim)
    blocks = [("triangle", skin[inner]), ("triangle", skin[~inner]),
              ("tetra", cells[labels == 7]), ("tetra", cells[labels != 7])]
    groups = (3, 4, 7, 9)
    size = [len(rows) for _, rows in blocks]
    tags = np.zeros((len(points), 2), dtype=int)
    for (kind, rows), tag in sorted(zip(blocks, (1, 2, 1, 2), strict=True),
                                    key=lambda pair: pair[0][0]):
        tags[rows.ravel()] = (2 if kind == "triangle" else 3), tag
    names = dict(zip(("inside", "outside", "steel", "rubber"), groups, strict=True))
    return meshio.Mesh(
        points, blocks,
        point_data={"height": points[:, 2], "gmsh:dim_tags": tags},
        cell_data={"gmsh:physical": [np.full(n, g) for n, g in zip(size, groups, strict=True)],
                   "gmsh:geometrical": [np.full(n, t) for n, t in
                                        zip(size, (1, 2, 1, 2), strict=True)],
                   "stress": [np.arange(n) / 8 for n in size]},
        field_data={name: np.array([g, 2 if g < 5 else 3]) for name, g in names.items()},
        cell_sets={name: [np.arange(n if g == groups[i] else 0) for i, n in enumerate(size)]
                   for name, g in names.items()})


def table(folder: Path) -> str:
    """Rows in Markdown, one a format."""
    lines = ["| suffix | triangles beside tetrahedra | labels of cells | names of groups | "
             "arrays of points | arrays of cells | coordinates |",
             "|---|---|---|---|---|---|---|"]
    for suffix in SUFFIXES:
        mesh = mesh_of_everything()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            files.write_file(folder / f"out{suffix}", mesh)
            back = files.read_file(folder / f"out{suffix}")
        lines.append(f"| `{suffix}` | " + " | ".join(_row(mesh, back)) + " |")
    return "\n".join(lines)


def _row(mesh, back):
    kinds = {block.type for block in back.cells}
    groups = {7, 9, 3, 4} if "triangle" in kinds else {7, 9}
    label, where = "-", set()
    for name, values in back.cell_data.items():
        held = {block.type for block, part in zip(back.cells, values, strict=True)
                if np.ravel(part).dtype.kind in "iu"
                and set(np.unique(part).tolist()) == groups & ({3, 4} if block.type == "triangle"
                                                              else {7, 9})}
        blocks = {block.type for block, part in zip(back.cells, values, strict=True)
                  if set(np.unique(part).tolist()) <= groups and np.ravel(part).dtype.kind in "iu"}
        held |= blocks if len(back.cells) > 2 else set()
        if len(held) > len(where):
            label, where = f"`{name}`", held
    if where and where != kinds:
        label += f" of {' and '.join(sorted(where))}"
    names = set(mesh.field_data)
    sets = names <= set(back.cell_sets)
    beside = {"inside", "outside"} <= set(back.cell_sets)
    if label == "-" and beside:
        label = "as sets" + " of triangle" * (not sets)
    named = sets or names <= set(back.field_data) or names <= {
        name for family in getattr(back, "cell_tags", {}).values() for name in family}
    yes = {True: "yes", False: "no"}
    exact = np.array_equal(np.unique(mesh.points, axis=0), np.unique(back.points, axis=0))
    called = "of triangle" if beside and not named else yes[named]
    return (yes["triangle" in kinds], label, called, yes["height" in back.point_data],
            yes["stress" in back.cell_data], "exact" if exact else "rounded")
