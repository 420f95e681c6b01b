"""Triangles that are there twice, on both sides of an interface or with two loads: both follow."""

from __future__ import annotations

import re
import warnings

import meshio
import numpy as np
import pytest
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
