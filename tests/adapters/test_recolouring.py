"""Colours go from one format of surfaces into another, as other programs read them."""

from __future__ import annotations

import warnings

import meshio
import numpy as np
import pytest

from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.api import optimize_file
from odt_plugins.errors import DataNotKeptWarning

trimesh = pytest.importorskip("trimesh")

BALL = trimesh.creation.icosphere(subdivisions=2)
OF_VERTICES = (127.5 * (BALL.vertices + 1.0)).astype(np.uint8)
OF_FACES = np.column_stack([
    (127.5 * (BALL.vertices[BALL.faces].mean(axis=1) + 1.0)).astype(np.uint8),
    np.full(len(BALL.faces), 255, np.uint8)])


def made(kind, folder, of_faces=False):
    """A file with colours of one kind, by another program or word for word."""
    path = folder / f"in.{kind}"
    colours = {"face_colors": OF_FACES} if of_faces else {"vertex_colors": OF_VERTICES}
    if kind == "off":
        lines = [" ".join(map(str, [*place, *colour])) for place, colour in zip(
            BALL.vertices.tolist(), OF_VERTICES.tolist(), strict=True)]
        lines += [" ".join(map(str, [3, *face, *(colour if of_faces else ())])) for face, colour in
                  zip(BALL.faces.tolist(), OF_FACES.tolist(), strict=True)]
        lines = [line if not of_faces or i >= len(BALL.vertices) else " ".join(line.split()[:3])
                 for i, line in enumerate(lines)]
        head = ["OFF" if of_faces else "COFF", f"{len(BALL.vertices)} {len(BALL.faces)} 0"]
        path.write_text("\n".join([*head, *lines]) + "\n")
    elif kind == "vtu":
        data = {"cell_data": {"shade": [OF_FACES]}} if of_faces else {
            "point_data": {"shade": OF_VERTICES}}
        meshio.Mesh(BALL.vertices, [("triangle", BALL.faces)], **data).write(path)
    else:
        trimesh.Trimesh(BALL.vertices, BALL.faces, process=False, **colours).export(path)
    return path


def colours_in(path, of_faces=False):
    """Bytes (n, 3) of a file: by trimesh, or the last words of the lines of an OFF file."""
    if path.suffix != ".off":
        visual = trimesh.load(path, process=False).visual
        return np.asarray(visual.face_colors if of_faces else visual.vertex_colors)[:, :3]
    rows = [line.split() for line in path.read_text().splitlines()[2:]]
    n = len(BALL.vertices)
    words = [row[4:7] for row in rows[n:]] if of_faces else [row[3:6] for row in rows[:n]]
    return np.array(words, dtype=np.int64)


@pytest.mark.parametrize("target", ["ply", "obj", "off"])
@pytest.mark.parametrize("source", ["ply", "obj", "off", "vtu"])
def test_colours_of_vertices_go_into_other_formats(source, target, tmp_path):
    path = made(source, tmp_path)
    mesh = read_file(path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_file(tmp_path / f"out.{target}", mesh)
    found = colours_in(tmp_path / f"out.{target}")
    assert np.abs(found.astype(int) - OF_VERTICES).max() <= (1 if source == "obj" else 0)
    assert np.ptp(found, axis=0).min() > 200
    optimize_file(path, tmp_path / f"better.{target}", boundary="slide")
    better = colours_in(tmp_path / f"better.{target}")
    assert np.abs(better.astype(int) - OF_VERTICES).max() < 60


@pytest.mark.parametrize("target", ["ply", "off"])
@pytest.mark.parametrize("source", ["ply", "off", "vtu"])
def test_colours_of_faces_go_into_other_formats(source, target, tmp_path):
    mesh = read_file(made(source, tmp_path, of_faces=True))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_file(tmp_path / f"out.{target}", mesh)
    assert np.array_equal(colours_in(tmp_path / f"out.{target}", of_faces=True), OF_FACES[:, :3])


def test_what_shines_through_is_told_where_it_is_lost(tmp_path):
    """OBJ has no place for alpha, and none for colours of faces."""
    mesh = meshio.Mesh(BALL.vertices, [("triangle", BALL.faces)], point_data={
        "shade": np.column_stack([OF_VERTICES, np.full(len(OF_VERTICES), 128, np.uint8)])})
    with pytest.warns(DataNotKeptWarning, match="alpha"):
        write_file(tmp_path / "out.obj", mesh)
    assert np.array_equal(colours_in(tmp_path / "out.obj"), OF_VERTICES)
    with pytest.warns(DataNotKeptWarning, match="'shade'"):
        write_file(tmp_path / "out.obj", meshio.Mesh(
            BALL.vertices, [("triangle", BALL.faces)], cell_data={"shade": [OF_FACES]}))
