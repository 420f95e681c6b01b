"""Whole numbers of points that tell the boundary: vertices that come inside have none."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
import pyvista
from boxes import box, quadratic

from odt_plugins import refine, remesh


def on_rim(points):
    return (np.isclose(points, 0.0) | np.isclose(points, 1.0)).any(axis=1)


@pytest.mark.parametrize("kind", ["grid", "linear", "quadratic", "plane"])
def test_new_vertices_inside_have_no_marker_of_the_boundary(kind):
    dim = 2 if kind == "plane" else 3
    points, cells = box(dim, 6 if dim == 2 else 4)
    name = {4: "tetra", 3: "triangle", 10: "tetra10"}
    if kind == "quadratic":
        points, cells = quadratic(points, cells)
    marks = {"bc": on_rim(points) * 7, "where": np.where(on_rim(points), "rim", "inside")}
    if kind == "grid":
        mesh = pyvista.UnstructuredGrid({10: cells}, points)
        mesh.point_data.update(marks)
    else:
        mesh = meshio.Mesh(points, [(name[cells.shape[1]], cells)], point_data=marks)
    made = remesh(mesh, scale=0.6)
    assert len(made.points) > 1.3 * len(points)
    rim = on_rim(np.asarray(made.points))
    assert np.array_equal(made.point_data["bc"], rim * 7)
    assert np.array_equal(made.point_data["where"], np.where(rim, "rim", "inside"))


@pytest.mark.parametrize("kind", ["linear", "quadratic", "plane"])
@pytest.mark.parametrize("beside", [[], [("line", np.array([[0, 9]]))]])
def test_markers_of_vertices_beside_the_cells_do_not_count(kind, beside):
    points, cells = box(2 if kind == "plane" else 3, 5)
    if kind == "quadratic":
        points, cells = quadratic(points, cells)
    name = {4: "tetra", 3: "triangle", 10: "tetra10"}[cells.shape[1]]
    far = np.concatenate([points[:1] + 5.0, points])
    mesh = meshio.Mesh(far, [(name, cells + 1), *beside],
                       point_data={"bc": np.append(9, on_rim(points) * 7)})
    made = remesh(mesh, scale=0.6)
    there = (made.points <= 1.0 + 1e-9).all(axis=1)
    assert there.sum() > 1.3 * len(points)
    assert np.array_equal(made.point_data["bc"], np.where(there, on_rim(made.points) * 7, 9))


def test_without_vertices_inside_only_markers_of_formats_are_none():
    points, cells = box(3, 1)
    marks = {"tetgen:ref": np.full(len(points), 3), "other": np.full(len(points), 3)}
    made = remesh(meshio.Mesh(points, [("tetra", cells)], point_data=marks), scale=0.4)
    rim = on_rim(made.points)
    assert not rim.all()
    assert np.array_equal(made.point_data["tetgen:ref"], rim * 3)
    assert set(made.point_data["other"]) == {3}


@pytest.mark.parametrize("kind", ["linear", "quadratic", "plane"])
def test_new_vertices_beside_a_side_have_no_marker_of_that_side(kind):
    dim = 2 if kind == "plane" else 3
    points, cells = box(dim, 5)
    name = {4: "tetra", 3: "triangle", 10: "tetra10"}
    if kind == "quadratic":
        points, cells = quadratic(points, cells)
    marks = {"left": points[:, 0] == 0}
    made = remesh(meshio.Mesh(points, [(name[cells.shape[1]], cells)], point_data=marks), scale=0.6)
    assert len(made.points) > 1.3 * len(points)
    assert np.array_equal(made.point_data["left"], np.isclose(made.points[:, 0], 0.0, atol=1e-3))


@pytest.mark.parametrize("n", [4, 6])
def test_new_vertices_of_other_sides_near_a_corner_have_no_marker_of_a_side(n):
    points, cells = box(3, n)
    right = points[cells].mean(axis=1)[:, 0] > 0.5
    mesh = meshio.Mesh(points, [("tetra", cells)], cell_data={"material": [right.astype(int)]},
                       point_data={"bc": np.where(points[:, 0] == 0.0, 7, 0)})
    made = remesh(mesh, scale=0.5)
    left = np.isclose(made.points[:, 0], 0.0, atol=1e-9)
    assert np.array_equal(made.point_data["bc"], np.where(left, 7, 0))


@pytest.mark.parametrize("optimize", [False, True])
def test_mid_points_have_markers_of_their_own_sides_alone(optimize):
    points, cells = box(3, 4)
    side = points[:, 0] == 0.0
    mesh = pyvista.UnstructuredGrid({10: cells}, points)
    mesh.point_data.update({"bc": on_rim(points) * 7, "side": side})
    made = refine(mesh, optimize=optimize)
    places = np.asarray(made.points)
    assert np.array_equal(made.point_data["bc"], on_rim(places) * 7)
    assert np.array_equal(made.point_data["side"], places[:, 0] == 0.0)
