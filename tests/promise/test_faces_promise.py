"""The promise of lines and triangles with labels where their mesh was resized."""

from dataclasses import replace

import boxes
import numpy as np
import pytest

from odt_plugins.mesh.faces import Faces, no_faces
from odt_plugins.mesh.simplex import simplex_mesh
from odt_plugins.promise.faces import broken_lines
from odt_plugins.promise.locked_facets import locked_facets
from odt_plugins.promise.remeshed import broken_by_remeshing

ROWS = np.array([[0, 1], [1, 2], [2, 3], [3, 4]], dtype=np.int32)
CELLS = np.array([[0, 1, 9], [1, 2, 9], [2, 3, 9], [3, 4, 9], [0, 2, 8]], dtype=np.int32)
LABELS = np.array([0, 0, 1, 1], dtype=np.int32)


@pytest.mark.parametrize(("rows", "labels", "word"), [
    (ROWS, LABELS, None),
    ([[0, 2], [2, 3], [3, 4]], [0, 1, 1], None),
    ([[0, 2], [2, 4]], [0, 1], "no edge of a cell"),
    (ROWS[:3], LABELS[:3], None),
    (ROWS[[0, 2, 3]], LABELS[[0, 2, 3]], None),
    (ROWS[2:], LABELS[2:], "label 0"),
    (ROWS[[0, 1, 3]], [0, 0, 0], "label 1"),
    (np.concatenate([ROWS, [[0, 9]]]), [0, 0, 1, 1, 2], "label 2"),
    (np.concatenate([ROWS, [[1, 9]]]), [0, 0, 1, 1, 0], "label 0"),
])
def test_lines_hang_together_as_before(rows, labels, word):
    broken = broken_lines(Faces(ROWS, LABELS), Faces(
        np.array(rows, dtype=np.int32), np.array(labels, dtype=np.int32)), CELLS)
    assert not broken if word is None else any(word in text for text in broken)


def test_a_label_that_spreads_over_the_surface_is_seen():
    points, cells = boxes.box(3, 2)
    mesh, _ = simplex_mesh(np.asarray(points, float), cells)
    skin = locked_facets(mesh.cells, mesh.regions, len(mesh.points)).facets
    top = np.isclose(mesh.points[skin][:, :, 2], mesh.points[:, 2].max()).all(axis=1)
    faces = no_faces()[0], Faces(skin[top], np.zeros(int(top.sum()), dtype=np.int32))
    mesh = replace(mesh, faces=faces)

    def broken(after):
        return broken_by_remeshing(
            mesh, mesh.points, mesh.cells, mesh.regions, np.arange(len(mesh.points)), (),
            np.zeros((0, 0)), (faces[0], after), slides=True)

    assert broken(faces[1]) == []
    for rows in (skin, skin[:0]):
        words = broken(Faces(rows, np.zeros(len(rows), dtype=np.int32)))
        assert words
        assert all("surface of" in text for text in words)
