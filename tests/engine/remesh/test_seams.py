"""Surfaces with vertices of their own on both sides of seams get other sizes, and no cracks."""

from __future__ import annotations

from dataclasses import replace

import meshio
import numpy as np
import planar_meshes
import pytest
import surface_meshes
import tet_meshes
import trimesh
from attack import judge

import odt_plugins
from odt_plugins.engine.remesh.seams import sewn
from odt_plugins.mesh.faces import Faces
from odt_plugins.mesh.soup import twins
from odt_plugins.mesh.surface import surface_mesh


def ball(n=48, m=24):
    """A sphere without caps, cut along a meridian and around the equator: points, cells, halves."""
    i, j = np.meshgrid(np.arange(n + 1), np.arange(m + 1), indexing="ij")
    turn, height = 2 * np.pi * (i % n) / n, np.pi * (0.1 + 0.8 * j / m)
    points = np.stack([np.sin(height) * np.cos(turn), np.sin(height) * np.sin(turn),
                       np.cos(height)], axis=-1).reshape(-1, 3)
    at = np.arange(i.size).reshape(i.shape)
    a, b, c, d = (at[p, q].ravel() for p, q in (
        (slice(-1), slice(-1)), (slice(1, None), slice(-1)), (slice(1, None), slice(1, None)),
        (slice(-1), slice(1, None))))
    half = np.tile(np.arange(m) >= m // 2, n)
    cells = np.concatenate([np.stack([a, c, b], axis=1), np.stack([a, d, c], axis=1)])
    half = np.concatenate([half, half])
    used, cells[half] = np.unique(cells[half], return_inverse=True)[0], (
        len(points) + np.unique(cells[half], return_inverse=True)[1].reshape(-1, 3))
    return np.concatenate([points, points[used]]), cells, half


def rims(points, cells):
    """Open edges as pairs of places, once for every triangle that has one."""
    place = np.unique(points, axis=0, return_inverse=True)[1].ravel()
    edges = np.sort(cells[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    rows, count = np.unique(edges, axis=0, return_counts=True)
    assert count.max() <= 2
    return np.unique(np.sort(place[rows[count == 1]], axis=1), axis=0, return_counts=True)[1]


@pytest.mark.parametrize("scale", [0.7, 2.0])
def test_both_sides_of_a_seam_get_the_same_other_sizes(scale):
    points, cells, _half = ball()
    (out, now), report = odt_plugins.remesh_with_report((points, cells), scale=scale, envelope=0.01)
    before, after = rims(points, cells), rims(out, now)
    assert {*after.tolist()} == {1, 2}
    share = (after == 2).sum() / (before == 2).sum()
    assert share < 0.7 if scale > 1 else share > 1.3
    assert report.after.mean_quality > 0.9
    assert any("on seams" in note for note in report.notes)


def test_seams_that_are_fixed_do_not_crack():
    points, cells, _half = ball()
    fixed = twins(points, cells)
    out, now = odt_plugins.remesh((points, cells), scale=0.6, fixed=fixed, envelope=0.01)
    assert len(now) > 1.5 * len(cells)
    assert {*rims(out, now).tolist()} == {1, 2}
    assert {*map(tuple, points[fixed])} <= {*map(tuple, out)}


@pytest.mark.parametrize("scale", [0.8, 1.6])
def test_patches_keep_their_vertices_and_fields(scale):
    """A vertex that is left is that of its side, also where a patch meets itself."""
    points, cells, half = ball()
    own = np.zeros(len(points))
    own[cells[half]] = 1.0
    mesh = meshio.Mesh(points, [("triangle", cells)], point_data={"half": own},
                       cell_data={"of": [half.astype(float)]})
    result = odt_plugins.remesh(mesh, scale=scale, envelope=0.01)
    corners = result.point_data["half"][result.cells[0].data]
    assert np.ptp(corners, axis=1).max() == 0.0
    np.testing.assert_array_equal(corners[:, 0], result.cell_data["of"][0])


def test_seams_whose_sides_disagree_about_the_outside_do_not_crack():
    points, cells, half = ball(24, 12)
    cells[half] = cells[half][:, ::-1]
    out, now = odt_plugins.remesh((points, cells), scale=0.5, envelope=0.01)
    assert len(now) > 2 * len(cells)
    rows, count = np.unique(np.sort(now[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1),
                            axis=0, return_counts=True)
    level = np.abs(out[rows[count == 1], 2]).max(axis=1)
    assert (level < 1e-9).sum() == 2 * 24
    assert {*rims(out, now).tolist()} == {1, 2}


def torn(points, cells, part):
    """A mesh of which a part of the cells has vertices of its own."""
    used, own = np.unique(cells[part], return_inverse=True)
    cells = cells.copy()
    cells[part] = len(points) + own.reshape(-1, cells.shape[1])
    return np.concatenate([points, points[used]]), cells


def doubled(points, cells):
    """Facets of one cell whose place another one has, too, as sorted coordinates."""
    k = cells.shape[1]
    rows = np.sort(np.concatenate([np.delete(cells, i, axis=1) for i in range(k)]), axis=1)
    rows, count = np.unique(rows, axis=0, return_counts=True)
    place = np.unique(points, axis=0, return_inverse=True)[1].ravel()
    rows = rows[count == 1]
    _, which, count = np.unique(np.sort(place[rows], axis=1), axis=0, return_inverse=True,
                                return_counts=True)
    return {tuple(sorted(map(tuple, points[row]))) for row in rows[count[which.ravel()] == 2]}


@pytest.mark.parametrize("scale", [0.6, 1.5])
@pytest.mark.parametrize("dim", [2, 3])
def test_interfaces_of_parts_that_share_no_vertices_stay_as_they_are(dim, scale):
    if dim == 3:
        points, cells = tet_meshes.grid(5, 1)
    else:
        points, cells = planar_meshes.grid(1)
    middle = points[cells].mean(axis=1)
    points, cells = torn(points, cells, middle[:, 0] > points[:, 0].mean())
    before = doubled(points, cells)
    out, now = odt_plugins.remesh((points, cells), scale=scale, envelope=0.01)
    assert len(now) != len(cells)
    assert len(before) > 5
    assert doubled(out, now) == before


@pytest.mark.parametrize("scale", [0.6, 2.0])
def test_patches_that_meet_at_vertices_still_do(scale):
    """Fans of one patch have one vertex where they had one, and two where they had two."""
    points, cells = surface_meshes.torus(24, 16, 0.0, 3)
    part = np.random.default_rng(4).random(len(cells)) < 0.3
    torn_points, rows = torn(points, cells, part)
    out, now = odt_plugins.remesh((torn_points, rows), scale=scale, envelope=0.02)
    assert len(now) != len(rows)
    assert judge.euler(now) == judge.euler(rows) != judge.euler(cells)
    assert judge.euler(judge.places(out)[now]) == judge.euler(cells) == 0


def test_lines_and_named_vertices_of_soups_are_where_they_were():
    box = trimesh.creation.box().subdivide().subdivide()
    rows = np.arange(box.faces.size).reshape(-1, 3)
    points = box.triangles.reshape(-1, 3)
    ends = np.sort(rows[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    line = ends[(np.abs(points[ends][:, :, :2] - 0.5).max(axis=(1, 2)) < 1e-9)]
    mesh = meshio.Mesh(points, [("triangle", rows), ("line", line)],
                       point_sets={"corner": np.array([rows[-1, 2]])})
    out = odt_plugins.remesh(mesh, scale=1.5, envelope=0.01)
    assert len(out.points) < len(points)
    np.testing.assert_array_equal(out.points[out.cells[1].data], points[line])
    np.testing.assert_array_equal(out.points[out.point_sets["corner"]], points[rows[-1, 2:]])


def cracked(n=4):
    """Tetrahedra with a slit inside, whose rim both sides have in common."""
    points, cells = tet_meshes.grid(n, 1)
    step = np.linspace(0, 1, n + 1)
    place = np.stack(np.meshgrid(step, step, step, indexing="ij"), axis=-1).reshape(-1, 3)
    middle = place[:, 0] == step[n // 2]
    points[middle, 0] = points[middle, 0].mean()
    inside = middle & ((place[:, 1:] > 0) & (place[:, 1:] < 1)).all(axis=1)
    right = points[cells].mean(axis=1)[:, 0] > points[middle, 0].mean()
    number = np.arange(len(points))
    number[inside] = len(points) + np.arange(inside.sum())
    cells[right] = number[cells[right]]
    return np.concatenate([points, points[inside]]), cells


@pytest.mark.parametrize("scale", [0.6, 1.5])
def test_both_sides_of_a_slit_stay_on_each_other_up_to_its_rim(scale):
    points, cells = cracked()
    before = doubled(points, cells)
    out, now = odt_plugins.remesh((points, cells), scale=scale, envelope=0.01)
    assert len(now) != len(cells)
    assert len(before) > 20
    assert doubled(out, now) == before


def shared(points, cells):
    """Triangles whose place another one has, too, as sorted coordinates."""
    place = np.unique(points, axis=0, return_inverse=True)[1].ravel()
    _, which, count = np.unique(np.sort(place[cells], axis=1), axis=0, return_inverse=True,
                                return_counts=True)
    return {tuple(sorted(map(tuple, points[row]))) for row in cells[count[which.ravel()] == 2]}


@pytest.mark.parametrize("scale", [None, 0.25, 1.5])
def test_sides_that_bodies_have_in_common_stay_as_they_are(scale):
    points, cells = surface_meshes.cube(6, noise=0.3)
    side = points[:, 0].max()
    other = np.where(points[:, :1] == side, points, points + np.array([0.0, 0.02, 0.01]))
    other[:, 0] = side + 2.0 * (side - other[:, 0])
    points, cells = np.concatenate([points, other]), np.concatenate(
        [cells, len(points) + cells[:, ::-1]])
    before = shared(points, cells)
    out, now = (odt_plugins.optimize((points, cells)) if scale is None else
                odt_plugins.remesh((points, cells), scale=scale))
    assert not np.array_equal(now, cells)
    assert len(before) == 72
    assert shared(out, now) == before


def test_what_may_not_be_sewn_up_stays():
    points, cells, half = ball(12, 6)
    mesh = surface_mesh(points, cells)
    found = sewn(mesh)
    assert found is not None
    assert len(found.mesh.lines)
    assert "of them stay" not in found.note
    assert len(np.unique(found.mesh.cells)) == 12 * 7
    assert sewn(found.mesh) is None
    copy = np.flatnonzero(found.same != np.arange(len(points)))
    line = Faces(np.array([[found.same[copy[0]], copy[0]]], dtype=np.int32),
                 np.zeros(1, dtype=np.int32))
    stays = sewn(replace(mesh, faces=(line, mesh.faces[1])))
    assert stays is not None
    assert "stay" in stays.note
    assert stays.mesh.fixed[copy].all()
    assert sewn(stays.mesh) is None
    turned = cells.copy()
    turned[half] = turned[half][:, ::-1]
    part = sewn(surface_mesh(points, turned))
    assert part is not None
    assert len(np.unique(part.mesh.cells)) > 12 * 7
    assert f"; {2 * 13} of them stay" in part.note
    assert sewn(surface_mesh(*_one_sheet())) is None


def _one_sheet():
    return np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), np.array(
        [[0, 1, 2], [0, 2, 3]])


def test_three_sheets_at_an_edge_stay_there():
    points = np.array([[0.0, 0, 0], [0, 0, 1], [1, 0, 0.5], [-1, 0.5, 0.5], [-1, -0.5, 0.5]])
    rows = [[0, 1, 2], [1, 0, 3], [0, 1, 4]]
    soup = points[np.array(rows).ravel()]
    mesh = surface_mesh(soup, np.arange(9).reshape(-1, 3))
    found = sewn(mesh)
    assert found is not None
    assert "stay" in found.note
    assert found.mesh.fixed[[0, 1, 3, 4, 6, 7]].all()
