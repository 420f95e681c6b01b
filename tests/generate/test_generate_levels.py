"""From coarse to large meshes: valid at every step, on the surface, with everything carried."""

from __future__ import annotations

import json
import warnings
from itertools import combinations

import meshio
import numpy as np
import pytest
import pyvista
import surface_meshes
import tet_meshes
from hypothesis import given, settings
from scipy.spatial import Delaunay
from strategies import SEEDS

import odt_plugins
from odt_plugins.cli import main as cli
from odt_plugins.engine.cells.geometry import boundary_facets
from odt_plugins.errors import (
    DataNotKeptWarning,
    InvalidMeshError,
    InvalidOptionError,
    ODTWarning,
)
from odt_plugins.generate import coarse, project, refine3d

DOUBLE = np.dtype(np.float64)


def volumes(points, cells):
    x = points[cells].astype(float)
    return np.linalg.det(x[:, 1:] - x[:, :1]) / 6


def boundary_of(cells):
    counts = {}
    for cell in np.sort(cells, axis=1).tolist():
        for facet in combinations(cell, 3):
            counts[facet] = counts.get(facet, 0) + 1
    assert max(counts.values()) <= 2
    return {facet for facet, count in counts.items() if count == 1}


def coarse_ball(seed=0, level=1):
    """Tetrahedra between the vertices of a coarse icosphere and points inside."""
    rng = np.random.default_rng(seed)
    shell, _ = surface_meshes.sphere(level)
    inside = rng.normal(size=(30, 3))
    inside *= 0.75 * rng.random((30, 1)) ** (1 / 3) / np.linalg.norm(inside, axis=1)[:, None]
    points = np.concatenate([shell, inside])
    return points, tet_meshes.oriented(points, Delaunay(points).simplices)


def box(points, cells, side=2.0):
    """A cube mesh [0, 1]^3 with labels of its six sides as triangles."""
    faces = np.array(sorted(boundary_of(cells)))
    label = np.zeros(len(faces), dtype=int)
    for axis in range(3):
        for end in (0.0, side):
            on = np.isclose(points[faces][:, :, axis], end, atol=0.1).all(axis=1)
            label[on] = 1 + 2 * axis + (end > 0)
    return meshio.Mesh(
        points, [("tetra", cells), ("triangle", faces)],
        cell_data={"side": [np.zeros(len(cells), dtype=int), label]},
    )


def test_a_coarse_ball_becomes_a_fine_one_on_the_sphere():
    points, cells = coarse_ball()
    sphere = surface_meshes.sphere(4)
    (new, parts), report = odt_plugins.refine_with_report(
        (points, cells), 2, surface=sphere, envelope=2e-2)
    assert (volumes(new, parts) > 0).all()
    faces = np.array(sorted(boundary_of(parts)))
    forward, backward = surface_meshes.two_sided(*sphere, new, faces, k=4)[::-1]
    assert max(forward, backward) <= report.envelope
    assert report.within
    assert report.envelope == pytest.approx(2e-2 * 12**0.5, rel=1e-2)
    assert report.forward >= min(forward, backward) * (1 - 1e-9)
    assert report.volume == pytest.approx(volumes(new, parts).sum(), rel=1e-12)
    assert report.surface_volume == pytest.approx(4.18, abs=0.02)
    assert abs(report.volume / report.surface_volume - 1) < 0.02
    assert volumes(points, cells).sum() < 0.9 * report.surface_volume
    radius = np.linalg.norm(new[np.unique(faces)], axis=1)
    assert abs(radius - 1).max() < 2e-3
    assert [at.level for at in report.levels] == [0, 1, 2]
    assert report.after.mean_quality > 0.86
    assert report.after.n_cells == len(parts)
    assert report.levels[2].asked > 300
    data = json.loads(report.to_json())
    assert data["levels"][1]["quality"]["n_cells"] == report.levels[1].quality.n_cells
    assert "within the envelope" in str(report)


def test_labelled_sides_and_sharp_edges_of_a_cube_stay():
    points, cells = tet_meshes.grid(2, 3)
    mesh = box(points, cells)
    out, report = odt_plugins.refine_with_report(mesh, 1)
    tets, faces = out.cells[0].data, out.cells[1].data
    assert {tuple(sorted(row)) for row in faces.tolist()} == boundary_of(tets)
    assert len(faces) == 4 * len(mesh.cells[1].data)
    label = out.cell_data["side"][1]
    for axis in range(3):
        for end in (0.0, 2.0):
            on = (out.points[faces][:, :, axis] == end).all(axis=1)
            assert np.array_equal(on, label == 1 + 2 * axis + (end > 0))
    assert volumes(out.points, tets).sum() == pytest.approx(8.0, rel=1e-12)
    assert (report.forward, report.backward) == pytest.approx((0.0, 0.0), abs=1e-5)


def test_vertices_of_sharp_edges_go_to_the_sharp_edges_of_the_surface():
    points, cells = tet_meshes.grid(4, 3)
    blunt = points.copy()
    on = ((points[:, :2] == 0.0) | (points[:, :2] == 4.0)).all(axis=1) & (points[:, 2] % 4 > 0)
    blunt[on, :2] += np.where(points[on, :2] == 0.0, 0.05, -0.05)
    corners, faces = surface_meshes.cube(1)
    low, high = corners.min(axis=0), corners.max(axis=0)
    corners = (corners - low) / (high - low) * 4
    target = project.make_target(corners, faces.astype(np.int32), 40.0)
    held = np.zeros(len(points), dtype=bool)
    new, asked, short = project.project(blunt, cells, held, target, 0.1, DOUBLE)
    assert (asked, short) == (int(on.sum()), 0)
    assert np.allclose(new, points)


def test_a_pass_that_moves_nothing_is_the_last():
    passes = []
    still = project._until_still(np.zeros(3), lambda x: passes.append(x) or np.minimum(x + 1, 2))
    assert np.array_equal(still, np.full(3, 2.0))
    assert len(passes) == 3 < project.PASSES


@given(SEEDS)
@settings(max_examples=15, deadline=None)
def test_no_move_tangles_or_spoils_a_cell(seed):
    rng = np.random.default_rng(seed)
    points, cells = coarse_ball(seed % 50)
    shell, faces = surface_meshes.sphere(2)
    stretch = np.exp(rng.uniform(-1, 1, 3))
    target = project.make_target(shell * stretch, faces.astype(np.int32), 40.0)
    held = rng.random(len(points)) < 0.1
    new, asked, short = project.project(points, cells, held, target, 1e-2, DOUBLE)
    assert (volumes(new, cells) > 0).all()
    before, after = (odt_plugins.figures.radius_ratio(p, cells) for p in (points, new))
    assert (after >= np.minimum(before, project.LEAST_QUALITY) - 1e-12).all()
    angle = [np.degrees(tet_angles(p, cells)) for p in (points, new)]
    assert (angle[1] >= np.minimum(angle[0], project.LEAST_ANGLE) - 1e-6).all()
    inside = np.setdiff1d(np.arange(len(points)), boundary_facets(cells))
    assert np.array_equal(new[inside], points[inside])
    assert np.array_equal(new[held], points[held])
    assert 0 <= short <= asked


def tet_angles(points, cells):
    """Smallest dihedral angle of every cell, from the normals of its faces."""
    least = np.full(len(cells), np.pi)
    for i, j in combinations(range(4), 2):
        k, m = (v for v in range(4) if v not in (i, j))
        a, b, c, d = (points[cells[:, v]] for v in (i, j, k, m))
        u, v = np.cross(b - a, c - a), np.cross(b - a, d - a)
        cosine = (u * v).sum(1) / np.linalg.norm(u, axis=1) / np.linalg.norm(v, axis=1)
        least = np.minimum(least, np.arccos(np.clip(cosine, -1, 1)))
    return least


def test_facets_within_the_envelope_stay_within():
    points, cells = coarse_ball(level=2)
    faces = boundary_facets(cells)
    shell, triangles = surface_meshes.sphere(4)
    rough = 1 + 0.02 * np.random.default_rng(1).standard_normal(len(shell))
    surface = shell * rough[:, None], triangles.astype(np.int32)
    target = project.make_target(*surface, 60.0)
    held = np.zeros(len(points), dtype=bool)
    new, asked, _ = project.project(points, cells, held, target, 0.04, DOUBLE, last=False)
    assert asked == len(np.unique(faces))
    before, after = (
        surface_meshes.distances(surface_meshes.samples(p, faces, 5), *surface).reshape(
            len(faces), -1).max(axis=1) for p in (points, new))
    inside = before < 0.035
    assert inside.sum() > 100
    assert after[inside].max() < 0.04


def test_a_peak_of_the_surface_gets_a_vertex():
    points, cells = tet_meshes.grid(4, 3)
    corners, faces = surface_meshes.cube(4)
    low, high = corners.min(axis=0), corners.max(axis=0)
    corners = (corners - low) / (high - low) * 4
    top = np.flatnonzero(np.isclose(corners, [2.0, 2.0, 4.0]).all(axis=1))
    assert len(top) == 1
    corners[top] += [0.25, 0.15, 0.3]
    target = project.make_target(corners, faces.astype(np.int32), 40.0)
    held = np.zeros(len(points), dtype=bool)
    bare, sharp = (
        project.project(points, cells, held, target, 0.05, DOUBLE, last=last).points
        for last in (False, True))
    peak = corners[top[0]]
    assert np.linalg.norm(bare - peak, axis=1).min() > 0.04
    assert np.linalg.norm(sharp - peak, axis=1).min() == 0.0
    assert (volumes(sharp, cells) > 0).all()


@pytest.mark.filterwarnings("ignore:the boundary is up to")
def test_fixed_vertices_and_frozen_cells_stay():
    points, cells = coarse_ball()
    sphere = surface_meshes.sphere(3)
    fixed = np.zeros(len(points), dtype=bool)
    fixed[:5] = fixed[-5:] = True
    selection = np.arange(len(cells)) >= 12
    (new, parts), _ = odt_plugins.refine_with_report(
        (points, cells), 1, surface=sphere, fixed=fixed, selection=selection)
    assert np.array_equal(new[:5], points[:5])
    assert np.array_equal(new[len(points) - 5 : len(points)], points[-5:])
    whole, halved = refine3d.red_refinement(points, cells[:12])[:2]
    there = {frozenset(map(tuple, cell)) for cell in new[parts].tolist()}
    assert all(frozenset(map(tuple, cell)) in there for cell in whole[halved].tolist())
    assert (volumes(new, parts) > 0).all()


def test_a_region_keeps_its_interface():
    points, cells = tet_meshes.grid(2, 3, jitter=0.0)
    regions = (points[cells].mean(axis=1)[:, 0] > 1).astype(np.uint8) + 3
    (new, parts, labels), _ = odt_plugins.refine_with_report((points, cells, regions), 1)
    assert labels.dtype == np.uint8
    for label in (3, 4):
        assert volumes(new, parts)[labels == label].sum() == pytest.approx(4.0, rel=1e-12)


@pytest.mark.filterwarnings("ignore:the boundary is up to")
def test_linear_fields_are_exact_on_every_level():
    points, cells = coarse_ball()
    slope = np.array([1.0, -2.0, 0.5])
    mesh = meshio.Mesh(points, [("tetra", cells)], point_data={"T": points @ slope})
    surface = surface_meshes.sphere(3)
    out, _ = odt_plugins.refine_with_report(mesh, 1, surface=surface)
    assert np.linalg.norm(out.points, axis=1).max() > np.linalg.norm(points, axis=1).max() - 1e-9
    assert np.abs(out.point_data["T"] - out.points @ slope).max() < 1e-12
    kept, _ = odt_plugins.refine_with_report(mesh, 1, surface=surface, fields="keep")
    assert np.array_equal(kept.points, out.points)
    assert np.abs(kept.point_data["T"] - out.points @ slope).max() > 1e-3


@pytest.mark.parametrize("name", ["CellEntityIds", "half"])
def test_regions_that_are_found_keep_their_interface(name):
    points, cells = tet_meshes.grid(2, 3, jitter=0.0)
    half = (points[cells].mean(axis=1)[:, 0] > 1).astype(np.int32)
    mesh = meshio.Mesh(points, [("tetra", cells)], cell_data={
        name: [half], "partition": [(points[cells].mean(axis=1)[:, 1] > 1).astype(np.int32)]})
    out, _ = odt_plugins.refine_with_report(mesh, 1)
    assert volumes(out.points, out.cells[0].data)[out.cell_data[name][0] == 1].sum() == (
        pytest.approx(4.0, rel=1e-12))


@pytest.mark.filterwarnings("ignore:the boundary is up to")
def test_single_precision_and_negative_cells_come_back_so():
    points, cells = coarse_ball()
    given_ = points.astype(np.float32), cells[:, [1, 0, 2, 3]].astype(np.int64)
    (new, parts), _ = odt_plugins.refine_with_report(given_, 1, surface=surface_meshes.sphere(3))
    assert (new.dtype, parts.dtype) == (np.float32, np.int64)
    assert (volumes(new, parts) < 0).all()


@pytest.mark.filterwarnings("ignore:the boundary is up to")
def test_the_same_input_gives_the_same_bits_with_any_threads(many_threads):
    mesh = coarse_ball()
    sphere = surface_meshes.sphere(3)
    one, two = (odt_plugins.refine_with_report(mesh, 1, surface=sphere, threads=n)[0]
                for n in (1, 2))
    assert all(np.array_equal(a, b) for a, b in zip(one, two, strict=True))


@pytest.fixture
def meshed(monkeypatch):
    """TetWild replaced by a coarse ball."""
    calls = []
    monkeypatch.setattr(
        coarse, "run_tetwild", lambda given, *_: calls.append(given) or coarse_ball())
    return calls


@pytest.mark.filterwarnings("ignore:the boundary is up to")
def test_surfaces_of_every_kind_are_meshed_coarsely_first(meshed, tmp_path):
    points, faces = surface_meshes.sphere(3)
    soup = meshio.Mesh(points[faces].reshape(-1, 3),
                       [("triangle", np.arange(3 * len(faces)).reshape(-1, 3))])
    meshio.write(tmp_path / "sphere.vtu", soup)
    seen = []
    shares = []
    for surface in ((points, faces), pyvista.PolyData.from_regular_faces(points, faces), soup,
                    tmp_path / "sphere.vtu"):
        out, report = odt_plugins.refine_with_report(
            surface, 1, edge_length=0.3, envelope=1e-2,
            progress=lambda stage, share: shares.append(share))
        seen.append(type(out))
        assert report.levels[-1].quality.n_cells > 8 * 100
        assert report.volume == pytest.approx(4.18, rel=0.05)
    assert seen == [tuple, pyvista.UnstructuredGrid, meshio.Mesh, meshio.Mesh]
    assert all(call["edge_length_fac"] == 0.3 and call["epsilon"] == 0.75e-2 for call in meshed)
    assert all(len(call["vertices"]) == len(points) for call in meshed)
    assert shares[: len(shares) // 4] == sorted(shares[: len(shares) // 4])
    assert max(shares) == 1.0


@pytest.mark.filterwarnings("ignore:the boundary is up to")
def test_data_of_a_surface_that_do_not_come_to_tetrahedra_are_named(meshed, tmp_path):
    points, faces = surface_meshes.sphere(3)
    side = np.where(points[faces].mean(axis=1)[:, 0] < 0, "left", "right")
    surface = pyvista.PolyData.from_regular_faces(points, faces).compute_normals()
    surface.point_data["one"] = np.ones(len(points))
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataNotKeptWarning)
        odt_plugins.refine(surface, 0)
    surface.point_data["T"], surface.cell_data["side"] = points[:, 0], side
    with pytest.warns(DataNotKeptWarning, match="tetrahedra: T, side; those") as told:
        odt_plugins.refine(surface, 0)
    assert cli.in_flags(str(told[0].message)).endswith(
        "those of the faces of a file do with tetrahedralize, which takes levels too")
    mesh = meshio.Mesh(points, [("triangle", faces)],
                       cell_data={"name": [side.astype(object)]}, cell_sets={"all": [[0, 1]]})
    with pytest.warns(DataNotKeptWarning, match="tetrahedra: all, name; those"):
        odt_plugins.refine(mesh, 0)


def test_no_level_optimises_the_coarse_mesh(meshed):
    points, cells = coarse_ball()
    (p, t), report = odt_plugins.refine_with_report((points, cells), 0)
    assert [at.level for at in report.levels] == [0]
    assert len(p) == len(points)
    expected = odt_plugins.optimize((points, cells))
    assert np.array_equal(p, expected[0])
    assert np.array_equal(t, expected[1])
    _, report = odt_plugins.refine_with_report(
        surface_meshes.sphere(3), 0, edge_length=0.3, envelope=1e-1)
    assert report.levels[-1].quality.n_points == len(points)


def test_no_level_on_the_command_line(tmp_path, capsys):
    points, cells = coarse_ball()
    meshio.Mesh(points, [("tetra", cells)]).write(tmp_path / "in.vtu")
    out = tmp_path / "out.vtu"
    assert cli.main(["mesh", str(tmp_path / "in.vtu"), str(out), "--levels", "0"]) == 0
    assert len(meshio.read(out).points) == len(points)
    assert "0" in capsys.readouterr().out


def test_a_boundary_out_of_the_envelope_is_told():
    with pytest.warns(ODTWarning, match=r"up to 0\.\d+ from the surface .* try one more level"):
        _, report = odt_plugins.refine_with_report(
            coarse_ball(), 1, surface=surface_meshes.sphere(3), envelope=1e-4)
    assert not report.within
    assert "not within the envelope" in str(report)


def test_what_has_no_meaning_is_refused_with_one_sentence(meshed, monkeypatch):
    mesh = coarse_ball()
    sphere = surface_meshes.sphere(2)
    plane = np.array([[0.0, 0], [1, 0], [0, 1]]), np.array([[0, 1, 2]])
    cases = (
        (mesh, {"levels": -1}, "got levels=-1; expected an integer of at least 0"),
        (mesh, {"levels": True}, "got levels=True"),
        (mesh, {"envelope": 0.0}, r"got envelope=0.0; expected a part of the diagonal"),
        (mesh, {"edge_length": -1.0}, "got edge_length=-1.0"),
        (mesh, {"edge_length": 0.3}, "got edge_length=0.3 for a mesh of tetrahedra, where it has"),
        (mesh, {"insert": True}, "got insert=True"),
        (mesh, {"insert": 0.5}, "got insert=0.5"),
        (mesh, {"regions": np.zeros(len(mesh[1]), int)}, "got regions as an array"),
        (mesh, {"density": np.ones(len(mesh[0]))}, "got density as a ndarray"),
        (mesh, {"metric": np.ones((len(mesh[0]), 6))}, "got metric as a ndarray; .* callable"),
        (sphere, {"surface": sphere}, "got surface for a mesh of triangles"),
        (sphere, {"fixed": [0]}, "got fixed for a mesh of triangles"),
    )
    for given_, options, words in cases:
        with pytest.raises(InvalidOptionError, match=words):
            odt_plugins.refine_with_report(given_, **options)
    with pytest.raises(InvalidOptionError, match="got edge_length= with optimize=False"):
        odt_plugins.refine(sphere, optimize=False, edge_length=0.3)
    open_ = sphere[0], sphere[1][1:]
    for given_, options, words in (
        (open_, {}, r"not closed: 3 edges \(first: between vertices .*\) belong to an odd"),
        (mesh, {"surface": open_}, "not closed"),
        (plane, {}, "got triangles in the plane as a surface.*try odt_plugins.remesh"),
        (mesh, {"surface": mesh}, "got tetrahedra as a surface"),
        (mesh, {"levels": 9}, r"9 levels of refinement would make \d{11} tetrahedra of \d+"),
    ):
        with pytest.raises(InvalidMeshError, match=words):
            odt_plugins.refine_with_report(given_, **options)
    assert not meshed
