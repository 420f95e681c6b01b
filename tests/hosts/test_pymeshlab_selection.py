"""Filters inside pymeshlab on selected faces, and filters that fail: what is left in the set."""

from __future__ import annotations

import numpy as np
import pytest
import surface_meshes as sm

import odt_plugins
from odt_plugins.adapters import pymeshlab_faces

pymeshlab = pytest.importorskip("pymeshlab")
odt_plugins.register("pymeshlab")


def bowl_set():
    """A set of one bowl with scalars of the faces, and a few faces selected."""
    points, faces = sm.bowl(9, noise=0.35)
    meshes = pymeshlab.MeshSet()
    scalars = points[faces].mean(axis=1)[:, 1]
    meshes.add_mesh(pymeshlab.Mesh(points, faces, f_scalar_array=scalars), "bowl")
    meshes.compute_selection_by_condition_per_face(condselect="x0 > 0")
    return meshes


def arrays(meshes):
    mesh = meshes.current_mesh()
    return [np.array(part) for part in (
        mesh.vertex_matrix(), mesh.face_matrix(), mesh.face_selection_array(),
        mesh.vertex_selection_array(), mesh.face_scalar_array())]


def area(points, faces):
    x = points[faces]
    return 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1).sum()


@pytest.mark.parametrize("held", [False, True])
def test_selected_faces_are_optimised_and_stay_selected(held):
    meshes = bowl_set()
    mesh = meshes.current_mesh() if held else None
    points, faces, selected, _, _ = arrays(meshes)
    assert 0 < selected.sum() < len(faces)
    result = meshes.meshing_odt_optimization(selected=True)
    new_points, new_faces, now, _, scalars = arrays(meshes)
    assert result["new_faces"] > 0
    assert new_points.shape == points.shape
    assert new_faces.shape == faces.shape
    rest = np.unique(faces[~selected])
    assert np.array_equal(new_points[rest], points[rest])
    rows = {frozenset(row) for row in faces[~selected].tolist()}
    assert {frozenset(row) for row in new_faces[~now].tolist()} == rows
    assert now.sum() == selected.sum()
    assert np.isclose(area(new_points, new_faces[now]), area(points, faces[selected]), rtol=0.05)
    assert np.abs(scalars - new_points[new_faces].mean(axis=1)[:, 1]).max() < 0.3
    assert meshes.mesh_number() == 1
    if held:
        assert mesh.face_number() == len(faces)


def test_a_filter_that_fails_leaves_the_set_as_it_was(monkeypatch):
    meshes = bowl_set()
    mesh = meshes.current_mesh()
    before = arrays(meshes)
    real = pymeshlab_faces._keep_middles

    def fails(found):
        real(found)
        found.apply_filter("meshing_decimation_quadric_edge_collapse", targetfacenum=-5, wrong=1)

    monkeypatch.setattr(pymeshlab_faces, "_keep_middles", fails)
    with pytest.warns(odt_plugins.ODTWarning, match="in use as a Mesh object and stays"):
        meshes.meshing_odt_optimization(selected=True)
    old = meshes.mesh(0)
    assert np.array_equal(old.vertex_matrix(), before[0])
    assert np.array_equal(old.face_matrix(), before[1])
    assert mesh.face_number() == meshes.current_mesh().face_number() == len(before[1])

    def breaks(found):
        real(found)
        raise MemoryError

    monkeypatch.setattr(pymeshlab_faces, "_keep_middles", breaks)
    meshes = bowl_set()
    before = arrays(meshes)
    with pytest.raises(MemoryError):
        meshes.meshing_odt_optimization(selected=True)
    for one, other in zip(arrays(meshes), before, strict=True):
        assert np.array_equal(one, other)
    assert meshes.mesh_number() == 1
