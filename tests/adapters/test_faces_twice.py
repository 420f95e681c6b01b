"""Triangles that are there twice, on both sides of an interface or with two loads: both follow."""

from __future__ import annotations

import re
import warnings

import meshio
import numpy as np
import pytest
import pyvista
from boxes import FACES, box

from odt_plugins import remesh
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.errors import DataNotKeptWarning


def halves(n=4):
    """A box, which of its cells have x < 1/2, and cell and face of all sides between the halves."""
    points, cells = box(3, n, plane=0.5)
    left = points[cells].mean(axis=1)[:, 0] < 0.5
    cells = np.concatenate([cells[left], cells[~left]])
    sides = [(c, f) for c, cell in enumerate(cells) for f, face in enumerate(FACES)
             if (abs(points[cell[face], 0] - 0.5) < 1e-12).all()]
    return points, cells, int(left.sum()), sides


def normals(points, rows):
    x = points[rows]
    return np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) / 2


def written(source, target, scale):
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*last digits", category=DataNotKeptWarning)
        write_file(target, remesh(read_file(source), scale=scale, free=("periodic",)))


@pytest.mark.parametrize("scale", [0.6, 1.6])
def test_triangles_with_two_labels_keep_both(scale):
    points, cells, count, sides = halves()
    rows = np.array([cells[c][FACES[f]] for c, f in sides if c < count])
    mesh = meshio.Mesh(points, [("tetra", cells), ("triangle", np.concatenate([rows, rows]))],
                       cell_data={"load": [np.zeros(len(cells), int),
                                           np.repeat([1, 2], len(rows))]})
    out = remesh(mesh, scale=scale, free=("periodic",), regions=np.arange(len(cells)) < count)
    assert len(out.cells[1].data) != 2 * len(rows)
    for load in (1, 2):
        own = out.cells[1].data[out.cell_data["load"][1] == load]
        size = np.linalg.norm(normals(out.points, own), axis=1).sum()
        assert size == pytest.approx(np.linalg.norm(normals(points, rows), axis=1).sum())


@pytest.mark.parametrize("scale", [0.6, 1.6])
def test_triangles_of_vtk_with_two_labels_keep_both(scale):
    """Cells of all types stand in any order there."""
    points, cells, count, sides = halves()
    rows = np.array([cells[c][FACES[f]] for c, f in sides if c < count])
    flat = [np.insert(part, 0, part.shape[1], axis=1).ravel() for part in (
        rows[:5], cells, rows[5:], rows)]
    types = np.repeat([5, 10, 5], [5, len(cells), 2 * len(rows) - 5])
    mesh = pyvista.UnstructuredGrid(np.concatenate(flat), types, points)
    mesh.cell_data["load"] = np.repeat([1, 0, 1, 2], [5, len(cells), len(rows) - 5, len(rows)])
    out = remesh(mesh, scale=scale, free=("periodic",), regions=np.arange(len(cells)) < count)
    assert (out.celltypes == 5).sum() != 2 * len(rows)
    areas = [np.linalg.norm(normals(one.points, one.cells_dict[5][
        one["load"][one.celltypes == 5] == load]), axis=1).sum()
        for one in (mesh, out) for load in (1, 2)]
    assert areas == pytest.approx(4 * areas[:1])


@pytest.mark.parametrize("scale", [0.6, 1.6])
def test_lines_of_polydata_with_two_labels_keep_both(scale):
    points, cells = box(2, 8, plane=0.5)
    middle = np.flatnonzero(np.abs(points[:, 0] - 0.5) < 1e-12)
    chain = middle[np.argsort(points[middle, 1])]
    rows = np.column_stack([chain[:-1], chain[1:]])
    lines = np.insert(np.concatenate([rows, rows[:3]]), 0, 2, axis=1)
    mesh = pyvista.PolyData(np.column_stack([points, 0 * points[:, 0]]),
                            np.insert(cells, 0, 3, axis=1).ravel(), lines=lines.ravel())
    side = (points[cells][:, :, 0].mean(axis=1) < 0.5) + 3
    mesh.cell_data["material"] = np.concatenate([np.repeat([1, 2], [len(rows), 3]), side])
    out = remesh(mesh, scale=scale)
    assert out.n_lines != mesh.n_lines
    for label, length in ((1, 1.0), (2, 3 / 8)):
        ends = out.points[out.lines.reshape(-1, 3)[:, 1:]][out["material"][: out.n_lines] == label]
        assert np.abs(ends[:, 1, 1] - ends[:, 0, 1]).sum() == pytest.approx(length)


@pytest.mark.parametrize("kind", ["meshio", "pyvista"])
def test_the_ends_of_numbered_lines_that_are_there_twice_stay(kind):
    """Lines with a number each become no others, and nor do their ends."""
    points, cells = box(3, 4, plane=0.5)
    at = {tuple(place): i for i, place in enumerate(points.tolist())}
    line = [at[0.0, 0.0, 0.0], at[0.25, 0.0, 0.0]]
    mesh = meshio.Mesh(points, [("tetra", cells), ("line", np.array([line, line]))],
                       cell_data={"number": [np.arange(len(cells)), np.array([1, 2])],
                                  "group": [np.zeros(len(cells), int), np.array([7, 7])]})
    out = remesh(mesh if kind == "meshio" else pyvista.from_meshio(mesh), scale=1.5)
    rows = out.cells[1].data if kind == "meshio" else out.cells_dict[3]
    assert np.array_equal(out.points[rows], points[[line, line]])


@pytest.mark.parametrize("scale", [0.6, 1.6])
def test_a_surface_of_abaqus_on_both_sides_of_an_interface_has_both(scale, tmp_path):
    points, cells, count, sides = halves()
    text = "*NODE\n" + "".join(f"{i}, {a!r}, {b!r}, {c!r}\n" for i, (a, b, c) in enumerate(
        points.tolist(), 1))
    for name, start, stop in (("A", 0, count), ("B", count, len(cells))):
        text += f"*ELEMENT, TYPE=C3D4, ELSET={name}\n" + "".join(
            ", ".join(map(str, [i + 1, *(cells[i] + 1)])) + "\n" for i in range(start, stop))
        text += f"*SOLID SECTION, ELSET={name}, MATERIAL=M\n"
    sides = [sides[k] for k in np.random.default_rng(1).permutation(len(sides))]
    text += "*SURFACE, NAME=S\n" + "".join(f"{c + 1}, S{f + 1}\n" for c, f in sides)
    source, target = tmp_path / "a.inp", tmp_path / "b.inp"
    source.write_text(text)
    written(source, target, scale)
    text = target.read_text()
    nodes = {int(row[0]): [float(w) for w in row[1:]] for line in
             text.partition("*ELEMENT")[0].splitlines()[1:] for row in [line.split(",")]}
    found = {int(row[0]): [nodes[int(w)] for w in row[1:]] for line in text.splitlines()
             for row in [line.split(",")] if re.fullmatch(r"(\d+, ){4}\d+", line)}
    area = {True: 0.0, False: 0.0}
    assert len(re.findall(r"(?m)^(\d+), S(\d)", text)) != len(sides)
    for i, f in re.findall(r"(?m)^(\d+), S(\d)", text):
        x = np.array(found[int(i)])
        out = -normals(x, np.array([FACES[int(f) - 1]]))[0, 0]
        area[bool(x[:, 0].mean() < 0.5)] += abs(out)
    assert area == pytest.approx({True: 1.0, False: 1.0})


@pytest.mark.parametrize("scale", [0.6, 1.6])
def test_faces_of_nastran_with_two_values_of_a_load_have_both(scale, tmp_path):
    points, cells, count, _ = halves()
    lines = ["BEGIN BULK", *(f"GRID,{i},,{a:.6f},{b:.6f},{c:.6f}" for i, (a, b, c) in enumerate(
        points.tolist(), 1))]
    lines += ["CTETRA," + ",".join(map(str, [i + 1, 1 + (i >= count), *(cells[i] + 1)]))
              for i in range(len(cells))]
    for c, cell in enumerate(cells):
        for face in FACES:
            if (points[cell[face], 2] == 1).all():
                away = next(v for v in cell if v not in cell[face])
                lines += [f"PLOAD4,3,{c + 1},{p},,,,{cell[face[0]] + 1},{away + 1}"
                          for p in ("1.5", "2.5")]
    source, target = tmp_path / "a.bdf", tmp_path / "b.bdf"
    source.write_text("\n".join([*lines, "ENDDATA", ""]))
    written(source, target, scale)
    mesh = read_file(target)
    found = mesh.cell_data["nastran:ref"][1]
    size = np.linalg.norm(normals(mesh.points, mesh.cells[1].data), axis=1)
    values = re.findall(r"PLOAD4,3,\d+,(\d.5)", target.read_text())
    assert len(values) == len(found) != 64
    for value in ("1.5", "2.5"):
        assert size[np.array(values) == value].sum() == pytest.approx(1, abs=1e-4)
