"""Sets of points where vertices come: those of curved surfaces and of volumes have no holes, and
indices have a type that holds them.
"""

from __future__ import annotations

import warnings

import boxes
import meshio
import numpy as np
import pytest
import pyvista

from odt_plugins import optimize, remesh, remesh_with_report, untangle
from odt_plugins.errors import DataNotKeptWarning, InvalidMeshError, InvalidOptionError
from odt_plugins.generate import uniform_refine


def walls(cells):
    """Facets of one cell alone."""
    rows = np.sort(np.concatenate([np.delete(cells, i, axis=1)
                                   for i in range(cells.shape[1])]), axis=1)
    rows, count = np.unique(rows, axis=0, return_counts=True)
    return rows[count == 1]


def ball(dim, n):
    """A ball or disk of two regions, the inner one of half the radius."""
    points, cells = boxes.box(dim, n)
    points = 2 * points - 1
    inner = np.abs(points[cells].mean(axis=1)).max(axis=1) < 0.5
    far, norm = np.abs(points).max(axis=1), np.linalg.norm(points, axis=1)
    points = points * (far / np.maximum(norm, 1e-300))[:, None]
    points, cells = untangle((points, cells))
    return points, cells, inner


def named(cells, inner):
    """What each of the sets is to have."""
    return {"inner": np.unique(cells[inner]), "outer": np.unique(cells[~inner]),
            "skin": np.unique(walls(cells)),
            "interface": np.intersect1d(cells[inner], cells[~inner])}


@pytest.mark.parametrize(("dim", "n"), [(2, 12), (3, 8)])
def test_sets_of_curved_surfaces_and_of_volumes_have_the_new_vertices(dim, n):
    points, cells, inner = ball(dim, n)
    before = named(cells, inner)
    mesh = meshio.Mesh(points, [("triangle" if dim == 2 else "tetra", cells)],
                       cell_data={"material": [inner.astype(int)]}, point_sets=before)
    after = remesh(mesh, scale=0.6)
    wanted = named(after.cells[0].data, after.cell_data["material"][0] == 1)
    for name, members in wanted.items():
        assert len(members) > len(before[name])
        np.testing.assert_array_equal(np.sort(after.point_sets[name]), members, err_msg=name)


def test_a_set_of_the_boundary_has_no_new_vertices_inside_an_interface_that_ends_there():
    points, cells = boxes.box(3, 6)
    right = points[cells].mean(axis=1)[:, 0] > 0.5
    between = np.intersect1d(cells[right], cells[~right])
    skin = np.unique(walls(cells))
    mesh = meshio.Mesh(points, [("tetra", cells)], cell_data={"material": [right.astype(int)]},
                       point_sets={"skin": skin, "both": np.union1d(skin, between)})
    after = remesh(mesh, scale=0.7)
    new, right = after.cells[0].data, after.cell_data["material"][0] == 1
    skin = np.unique(walls(new))
    np.testing.assert_array_equal(np.sort(after.point_sets["skin"]), skin)
    both = np.union1d(skin, np.intersect1d(new[right], new[~right]))
    np.testing.assert_array_equal(np.sort(after.point_sets["both"]), both)


@pytest.mark.parametrize(("n", "scale"), [(3, 0.35), (4, 0.35), (3, 0.7)])
def test_sets_of_curved_sides_have_the_new_nodes_of_their_rims(n, scale):
    cube, rows = boxes.quadratic(*boxes.box(3, n))
    radius, angle = 0.5 + cube[:, 0], 0.5 * np.pi * cube[:, 1]
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), cube[:, 2]], axis=1)

    def sides(x):
        radius = np.hypot(x[:, 0], x[:, 1])
        return {"bore": radius < 0.515, "skin": radius > 1.485, "ring": x[:, 2] < 1e-9}

    sets = {name: np.flatnonzero(inside) for name, inside in sides(points).items()}
    after = remesh(meshio.Mesh(points, [("tetra10", rows)], point_sets=sets), scale=scale)
    for name, inside in sides(after.points).items():
        np.testing.assert_array_equal(np.sort(after.point_sets[name]), np.flatnonzero(inside),
                                      err_msg=name)


@pytest.mark.parametrize("fields", ["interpolate", "keep"])
def test_sets_of_volumes_have_the_nodes_of_edges_that_flips_make(fields):
    points, rows = boxes.quadratic(*boxes.box(3, 5, plane=0.6))
    label = (points[rows[:, :4]].mean(axis=1)[:, 0] > 0.6).astype(int)
    sets = {"all": np.arange(len(points)),
            **{str(k): np.unique(rows[label == k]) for k in range(2)}}
    some = np.unique(rows[:, 4:])[::30]
    mesh = meshio.Mesh(points, [("tetra10", rows)], cell_data={"material": [label]},
                       point_sets={**sets, "some": some})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        out = optimize(mesh, fields=fields)
    now, own = out.cells[0].data, out.cell_data["material"][0]
    assert not {*map(tuple, np.sort(now[:, :4]).tolist())} <= {
        *map(tuple, np.sort(rows[:, :4]).tolist())}
    wanted = {"all": np.arange(len(out.points)),
              **{str(k): np.unique(now[own == k]) for k in range(2)}}
    for name, members in wanted.items():
        np.testing.assert_array_equal(np.sort(out.point_sets[name]), members, err_msg=name)
    np.testing.assert_array_equal(out.points[out.point_sets["some"]], points[some])


@pytest.mark.parametrize("quadratic", [False, True])
@pytest.mark.parametrize("scale", [0.6, 1.7])
def test_sets_of_sides_are_resized_and_have_the_nodes_of_their_sides(scale, quadratic):
    points, cells = boxes.box(3, 4 if quadratic else 6)
    if quadratic:
        points, cells = boxes.quadratic(points, cells)

    def sides(x):
        return {"left": x[:, 0] < 1e-9, "half": (x[:, 2] < 1e-9) & (x[:, 0] < 0.5 + 1e-9),
                "skin": ((x < 1e-9) | (x > 1 - 1e-9)).any(axis=1)}

    probes = np.array([1, 9, 30])
    sets = {name: np.flatnonzero(inside) for name, inside in sides(points).items()}
    mesh = meshio.Mesh(points, [("tetra10" if quadratic else "tetra", cells)],
                       point_sets={**sets, "probes": probes})
    after, report = remesh_with_report(mesh, scale=scale)
    for name, inside in sides(after.points).items():
        np.testing.assert_array_equal(np.sort(after.point_sets[name]), np.flatnonzero(inside),
                                      err_msg=name)
        assert (len(after.point_sets[name]) > len(sets[name])) == (scale < 1)
    assert np.array_equal(after.points[after.point_sets["probes"]], points[probes])
    assert [note for note in report.notes if "point set" in note] == [
        "3 vertices of point set 'probes' stay where they are"]
    fixed = remesh(mesh, scale=scale, boundary="fixed")
    there = {row.tobytes() for row in fixed.points}
    assert all(row.tobytes() in there for row in points[sets["skin"]])


@pytest.mark.parametrize("kind", ["i1", "u1"])
def test_blocks_and_sets_of_narrow_indices_hold_more_vertices(kind):
    points, cells = boxes.box(3, 3)
    floor = walls(cells)
    floor = floor[(points[floor][:, :, 2] == 0).all(axis=1)]
    mesh = meshio.Mesh(
        points, [("tetra", cells.astype(kind)), ("triangle", floor.astype(kind))],
        point_sets={"all": np.arange(len(points)).astype(kind)},
        cell_sets={"every": [np.arange(len(cells)).astype("u1"), None]})
    out = remesh(mesh, scale=0.5, free="periodic")
    n, rows = len(out.points), out.cells[0].data
    assert n > 256
    np.testing.assert_array_equal(np.unique(rows), np.arange(n))
    x = out.points[rows]
    assert np.abs(np.linalg.det(x[:, 1:] - x[:, :1])).sum() == pytest.approx(6)
    assert (out.points[out.cells[1].data][:, :, 2] < 1e-6).all()
    np.testing.assert_array_equal(np.sort(out.point_sets["all"]), np.arange(n))
    np.testing.assert_array_equal(out.cell_sets["every"][0], np.arange(len(rows)))


@pytest.mark.parametrize("kind", ["i2", ">i2", "u2", "i4", "u8"])
def test_a_type_that_holds_all_indices_stays(kind):
    points, cells = boxes.box(3, 3)
    points, rows = remesh((points, cells.astype(kind)), scale=0.5, free="periodic")
    assert 256 < len(points) < 400
    assert rows.max() == len(points) - 1
    assert np.dtype(rows.dtype).itemsize == np.dtype(kind).itemsize
    assert rows.dtype.kind == np.dtype(kind).kind


def test_masks_of_points_are_sets_of_quadratic_and_of_refined_meshes():
    points, cells = boxes.box(3, 2)
    corner = points[:, 0] < 0.6
    mesh = meshio.Mesh(points, [("tetra", cells)], point_sets={"left": corner})
    fine = uniform_refine(mesh)
    np.testing.assert_array_equal(np.sort(fine.point_sets["left"]), np.sort(uniform_refine(
        meshio.Mesh(points, [("tetra", cells)], point_sets={"left": np.flatnonzero(corner)})
    ).point_sets["left"]))

    nodes, rows = boxes.quadratic(*boxes.box(3, 3))
    skin = ((nodes == 0) | (nodes == 1)).any(axis=1)
    out = optimize(meshio.Mesh(nodes, [("tetra10", rows)], point_sets={"skin": skin}))
    here = out.points[out.point_sets["skin"]]
    assert len(here) == skin.sum()
    assert ((here == 0) | (here == 1)).any(axis=1).all()


@pytest.mark.parametrize("run", [
    lambda mesh: remesh(mesh, scale=2), lambda mesh: remesh(mesh, scale=0.6),
    lambda mesh: optimize(mesh, insert=True), optimize])
def test_periodic_links_name_the_points_that_correspond(run):
    points, cells = boxes.box(3, 6)
    low, high = (np.flatnonzero(points[:, 0] == x) for x in (0, 1))
    pairs = np.stack([low, high], axis=1).astype(np.int32)
    mesh = meshio.Mesh(points, [("tetra", cells)],
                       gmsh_periodic=[[2, (2, 1), None, pairs]])
    mesh.identified = low
    out = run(mesh)
    (dim, tags, affine, now), = out.gmsh_periodic
    assert (dim, tags, affine) == (2, (2, 1), None)
    assert now.dtype == np.int32
    np.testing.assert_array_equal(out.points[now], points[pairs])
    np.testing.assert_array_equal(out.points[out.identified], points[low])
    np.testing.assert_array_equal(mesh.gmsh_periodic[0][3], pairs)


def test_links_whose_points_went_are_told():
    points, cells = boxes.box(3, 6)
    pairs = np.stack([np.flatnonzero(points[:, 0] == x) for x in (0, 1)], axis=1)
    mesh = meshio.Mesh(points, [("tetra", cells)], gmsh_periodic=[[2, (2, 1), None, pairs]])
    with pytest.warns(DataNotKeptWarning, match="1 periodic link whose points"):
        out = remesh(mesh, scale=2, free="periodic")
    assert out.gmsh_periodic is None


def test_blocks_of_several_types_are_of_whole_numbers_beside_sets():
    points, cells = boxes.box(3, 4)
    right = points[cells].mean(axis=1)[:, 0] > 0.5
    top = points[:, 2] == 1
    mesh = meshio.Mesh(
        points, [("tetra", cells[right].astype(np.uint64)), ("tetra", cells[~right]),
                 ("vertex", np.array([[0]], dtype=np.uint64))], point_sets={"top": top})
    out = remesh(mesh, scale=0.7, free="periodic")
    assert [block.data.dtype for block in out.cells] == [np.uint64, cells.dtype, np.uint64]
    np.testing.assert_array_equal(out.points[out.cells[2].data[0]], points[[0]])
    np.testing.assert_array_equal(np.sort(out.point_sets["top"]),
                                  np.flatnonzero(np.abs(out.points[:, 2] - 1) < 1e-3))


def test_indices_out_of_range_are_named_beside_sets():
    points, cells = boxes.box(3, 3)
    cells[5, 2] = len(points)
    mesh = meshio.Mesh(points, [("tetra", cells)], point_sets={"low": np.arange(5)})
    with pytest.raises(InvalidMeshError, match="first: cell 5"):
        optimize(mesh)


@pytest.mark.parametrize("kind", ["meshio", "pyvista"])
@pytest.mark.parametrize("run", [
    optimize, lambda mesh: optimize(mesh, boundary="slide", free="periodic"),
    lambda mesh: remesh(mesh, scale=0.7), lambda mesh: remesh(mesh, scale=1.4)])
def test_vertices_that_are_cells_stay_where_they_are(run, kind):
    points, cells = boxes.box(3, 6)
    near = [np.linalg.norm(points - place, axis=1).argmin()
            for place in ([0.5, 0.5, 0.4], [0.5, 0.3, 1])]
    mesh = meshio.Mesh(points, [("tetra", cells), ("vertex", np.array(near)[:, None])])
    after = run(mesh if kind == "meshio" else pyvista.from_meshio(mesh))
    last = after.cells[1].data.ravel() if kind == "meshio" else [
        after.get_cell(i).point_ids[0] for i in np.flatnonzero(after.celltypes == 1)]
    np.testing.assert_array_equal(np.asarray(after.points)[last], points[near])


def test_vertices_of_cells_move_where_all_have_such_a_cell():
    points, cells = boxes.box(3, 4)
    mesh = meshio.Mesh(points, [("tetra", cells), ("vertex", np.arange(len(points))[:, None])])
    after = optimize(mesh)
    assert (after.points != points).any()
    np.testing.assert_array_equal(after.cells[1].data, mesh.cells[1].data)


@pytest.mark.parametrize("order", [1, 2])
def test_labels_in_a_column_beside_sets(order):
    """XDMF files of FEniCS have arrays of one column."""
    points, cells = boxes.box(3, 4)
    label = (points[cells].mean(axis=1)[:, :1] > 0.5).astype(np.int32)
    if order == 2:
        points, cells = boxes.quadratic(points, cells)
    mesh = meshio.Mesh(points, [("tetra" if order == 1 else "tetra10", cells)],
                       cell_data={"material": [label]},
                       point_sets={"low": np.flatnonzero(points[:, 2] == 0)})
    out = remesh(mesh, scale=0.7)
    assert out.cell_data["material"][0].shape == (len(out.cells[0].data), 1)
    assert np.array_equal(np.sort(out.point_sets["low"]),
                          np.flatnonzero(np.abs(out.points[:, 2]) < 1e-3))


@pytest.mark.parametrize("run", [optimize, untangle])
def test_vectors_named_as_labels_beside_sets_are_refused(run):
    points, cells = boxes.box(3, 3)
    mesh = meshio.Mesh(points, [("tetra", cells)], cell_data={"flow": [points[cells[:, 0]]]},
                       point_sets={"low": np.flatnonzero(points[:, 2] == 0)})
    with pytest.raises(InvalidOptionError, match=r"regions have shape .* one label per cell"):
        run(mesh, regions="flow")


@pytest.mark.parametrize("run", [optimize, lambda mesh: remesh(mesh, scale=0.8), uniform_refine])
def test_sets_given_as_empty_lists_remain_indices(run):
    points, cells = boxes.box(3, 3)
    mesh = meshio.Mesh(points, [("tetra", cells), ("triangle", walls(cells))],
                       cell_sets={"wall": [[], [0, 1]]}, point_sets={"none": []})
    out = run(mesh)
    for block, rows in zip(out.cells, out.cell_sets["wall"], strict=True):
        assert block.data[rows].shape[1] == block.data.shape[1]
    assert len(out.points[out.point_sets["none"]]) == 0
