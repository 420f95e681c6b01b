"""Sizes by a name, by the curvature, and those that mean nothing, for every kind of mesh."""

from __future__ import annotations

import boxes
import meshio
import numpy as np
import pytest
from scipy.spatial import Delaunay
from surface_meshes import bowl, cube, sphere, torus

import odt_plugins
from odt_plugins.adapters.fields import named_array
from odt_plugins.adapters.host import HostMesh
from odt_plugins.engine.remesh.chords import LONGEST, PART, curvature_sizes
from odt_plugins.errors import InvalidOptionError
from odt_plugins.mesh.simplex import diagonal, simplex_mesh
from odt_plugins.mesh.surface import surface_mesh


def plane():
    points, cells = bowl(13, 0.2)
    return points[:, :2].copy(), cells


KINDS = {"tets": boxes.box(3, 3), "plane": plane(), "surface": sphere(2, 0.1)}


@pytest.fixture(params=KINDS, scope="module")
def mesh(request):
    return KINDS[request.param]


def chord(envelope, curvature):
    return np.sqrt(8 * PART * envelope / curvature)


def test_on_a_sphere_and_a_torus_as_long_as_chords_of_a_height():
    points, cells = sphere(4)
    found = curvature_sizes(surface_mesh(points, cells), 0.02, 40.0)
    assert found == pytest.approx(np.full(len(points), chord(0.02, 2**0.5)), rel=0.05)
    points, cells = torus(160, 64)
    away = np.hypot(points[:, 0], points[:, 1])
    small = np.sqrt((away - (away.max() + away.min()) / 2) ** 2 + points[:, 2] ** 2)
    large = (away.max() + away.min()) / 2
    cosine = (away - large) / small
    curvature = np.hypot(1 / small, cosine / away)
    envelope = 0.05 * small.mean()
    found = curvature_sizes(surface_mesh(points, cells), envelope, 40.0)
    assert found == pytest.approx(chord(envelope, curvature), rel=0.05)


def test_rims_in_the_plane_count_as_curved():
    rings = [[[0.0, 0.0]]]
    for k in range(1, 13):
        angle = np.linspace(0, 2 * np.pi, 6 * k, endpoint=False)
        rings.append(k / 12 * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    points = np.concatenate(rings)
    disk, _ = simplex_mesh(points, Delaunay(points).simplices)
    found = curvature_sizes(disk, 0.01, 40.0)
    assert np.median(found[-72:]) == pytest.approx(chord(0.01, 1.0), rel=0.05)
    assert found[0] == LONGEST * diagonal(points)


def test_flat_parts_have_a_share_of_the_diagonal_and_none_is_finer_than_the_input():
    points, cells = cube(24)
    flat = curvature_sizes(surface_mesh(points, cells), 0.01, 40.0)
    assert (flat == LONGEST * diagonal(points)).all()
    points, cells = sphere(1)
    edges = np.linalg.norm(points[cells] - points[np.roll(cells, 1, axis=1)], axis=2)
    assert curvature_sizes(surface_mesh(points, cells), 1e-5, 40.0).min() >= edges.min()


def test_where_neighbours_disagree_about_the_outside_the_rest_has_its_sizes():
    points, cells = sphere(4)
    turned = cells.copy()
    turned[7] = turned[7, ::-1]
    found = curvature_sizes(surface_mesh(points, turned), 0.02, 40.0)
    away = np.linalg.norm(points - points[cells[7]].mean(axis=0), axis=1) > 0.5
    assert found[away] == pytest.approx(
        curvature_sizes(surface_mesh(points, cells), 0.02, 40.0)[away], rel=1e-2)


def test_needles_of_a_cylinder_become_good_triangles_by_the_curvature():
    around = 2 * np.pi * np.arange(64) / 64
    ring = np.c_[np.cos(around), np.sin(around)]
    points = np.concatenate([np.c_[ring, np.zeros(64)], np.c_[ring, np.full(64, 3.0)]])
    i, j = np.arange(64), np.roll(np.arange(64), -1)
    cells = np.concatenate([np.c_[i, j, 64 + j], np.c_[i, 64 + j, 64 + i]])
    (points, cells), report = odt_plugins.remesh_with_report(
        (points, cells), "curvature", envelope=1e-3)
    assert report.before.mean_quality < 0.1
    assert report.after.min_quality > 0.7
    assert report.after.mean_quality > 0.9
    edges = np.linalg.norm(points[cells] - points[np.roll(cells, 1, axis=1)], axis=2)
    bound = 1e-3 * np.sqrt(4 + 4 + 9)
    assert chord(bound, 1) < np.median(edges) < 2 * 2 * np.sin(np.pi / 64)


def test_edges_by_the_curvature_are_as_long_as_asked_for():
    points, cells = odt_plugins.remesh(sphere(4), "curvature", envelope=0.01)
    ends = points[np.unique(np.sort(cells[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)), axis=0)]
    ratio = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) / chord(0.01 * 12**0.5, 2**0.5)
    assert ((ratio > 0.7) & (ratio < 1.42)).mean() > 0.97


def test_an_array_by_its_name_gives_the_same_bits(mesh):
    points, cells = mesh
    kind = "tetra" if cells.shape[1] == 4 else "triangle"
    wide = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    length = 0.35 + 0.1 * points[:, 0]
    host = meshio.Mesh(wide, [(kind, cells)], {"h": length, "flow": wide, "wave": 1j * length},
                       {"k": [length[cells].mean(axis=1)]})
    for name, values in (("h", length), ("k", length[cells].mean(axis=1))):
        out = odt_plugins.remesh(host, name, envelope=0.01)
        same = odt_plugins.remesh(host, values, envelope=0.01)
        assert np.array_equal(out.points, same.points)
        assert np.array_equal(out.cells[0].data, same.cells[0].data)
    for name, said in (("g", r"size='g'.*it has h \(point\), k \(cell\)$"),
                       ("flow", "size='flow', an array of shape")):
        with pytest.raises(InvalidOptionError, match=said):
            odt_plugins.remesh(host, name)


def test_values_of_as_many_cells_as_vertices_are_those_of_cells():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    rows = np.array([[0, 1, 2], [2, 3, 0], [0, 1, 2], [2, 3, 0]])
    four = HostMesh(points, rows, densities={"k": np.array([1.0, 3.0, 1.0, 3.0])})
    assert named_array(four, "k") == pytest.approx([2, 1, 2, 3])


def at(index, value, count):
    values = np.full(count, 0.3)
    values[index] = value
    return values


@pytest.mark.parametrize(("size", "said"), [
    (lambda n, m: 0, r"size=0\.0; expected a number above 0"),
    (lambda n, m: -1.0, r"size=-1\.0"),
    (lambda n, m: np.nan, "size=nan"),
    (lambda n, m: True, "size=True; expected a length"),
    (lambda n, m: at(2, 0.0, n), r"size 0\.0 at index 2 \(1 of them\)"),
    (lambda n, m: at(2, -1.0, n), r"size -1\.0 at index 2"),
    (lambda n, m: at(4, np.nan, m), r"size nan at index 4"),
    (lambda n, m: np.ones(n - 1), r"sizes of shape .* one for each vertex, or .* each cell"),
    (lambda n, m: np.ones((n, 2)), "sizes of shape"),
    (lambda n, m: lambda x: np.ones(3), r"sizes of shape \(3,\)"),
    (lambda n, m: np.ones(n) * 1j, "no real numbers"),
    (lambda n, m: 1e-8, "below 1e-06 of the diagonal"),
    (lambda n, m: 1e-5, r"sizes for about \d\S* cells; expected at most most_cells=20000000"),
])
def test_sizes_that_mean_nothing_are_refused_with_a_sentence(mesh, size, said):
    points, cells = mesh
    with pytest.raises(InvalidOptionError, match=said):
        odt_plugins.remesh(mesh, size(len(points), len(cells)))


def test_a_small_part_far_from_another_one_is_no_reason_to_refuse_its_own_sizes(mesh):
    points, cells = mesh
    both = np.vstack([points, 1e3 + 1e-7 * points]), np.vstack([cells, len(points) + cells])
    with pytest.raises(InvalidOptionError, match=r"below 1e-06 of the diagonal.* scale=1 for"):
        odt_plugins.remesh(both, scale=0.9)
    (x, t), _ = odt_plugins.remesh_with_report(both, scale=1.0)
    small = x[t[:, 0], 0] > 500.0
    assert 0.3 * len(cells) < np.count_nonzero(small) < 2.0 * len(cells)
    assert odt_plugins.quality((x, t)).mean_quality > odt_plugins.quality(mesh).mean_quality - 0.05


def test_a_few_sizes_that_are_smaller_are_no_share_of_zero():
    points, cells = boxes.box(3, 9)
    lengths = np.where(points.sum(axis=1) == 0.0, 0.255, 0.3)
    _, report = odt_plugins.remesh_with_report((points, cells), lengths)
    [note] = [note for note in report.notes if "sizes grow" in note]
    assert "smaller at less than 1 % of the vertices" in note


def test_the_report_says_what_was_done_instead(mesh):
    points, _ = mesh
    steep = np.where(np.arange(len(points)) == 3, 0.05, 2.0)
    _, report = odt_plugins.remesh_with_report(mesh, steep, envelope=0.01)
    assert any("sizes grow by more than 1.3" in note for note in report.notes)
    (x, _), report = odt_plugins.remesh_with_report(mesh, 1e3, envelope=0.01)
    assert any("larger than the domain" in note for note in report.notes)
    assert len(x) <= len(points)


@pytest.mark.parametrize(("given", "named"), [
    ({"method": "cpt", "objective": "amips"}, "method= and objective= have no part"),
    ({"smoothing": {"rounds": 3}}, "smoothing= has no part"), ({"finish": False}, "finish= has no"),
    ({"method": "odt", "objective": "radius_ratio", "smoothing": {}}, "")])
def test_the_report_names_options_that_have_no_part_in_sizes_of_triangles(mesh, given, named):
    dim = mesh[1].shape[1] - 1
    notes = "; ".join(odt_plugins.remesh_with_report(mesh, scale=1.5, **given)[1].notes)
    assert ("no part in other sizes" in notes) == (dim == 2 and named != "")
    assert dim == 3 or named in notes
