"""Places of a mesh that must not come apart, or that are worked around."""

from __future__ import annotations

import re
from itertools import combinations, permutations

import meshio
import numpy as np
import pytest
import trimesh
from boxes import box as regular

import odt_plugins
from odt_plugins.errors import InvalidMeshError
from odt_plugins.mesh.facets import uneven_facets
from odt_plugins.mesh.periodic import periodic_triangles


def patches(n=6):
    """The six sides of a cube as patches of their own, which share places but no vertices."""
    rng = np.random.default_rng(2)
    points, cells = [], []
    u = np.linspace(0, 1, n + 1)
    index = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (i.ravel() for i in (index[:-1, :-1], index[1:, :-1], index[1:, 1:],
                                      index[:-1, 1:]))
    square = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    for axis in range(3):
        for side in (0, 1):
            x = np.stack([i.ravel() for i in np.meshgrid(u, u, indexing="ij")], axis=1)
            inside = ((x > 0) & (x < 1)).all(axis=1)
            x[inside] += rng.uniform(-0.3, 0.3, (inside.sum(), 2)) / n
            cells.append((square if side else square[:, ::-1]) + len(points) * len(x))
            place = np.insert(x, axis, side, axis=1)
            points.append(place[:, [2, 1, 0]] if axis == 1 else place)
    return np.concatenate(points), np.concatenate(cells)


def test_patches_that_share_places_do_not_come_apart():
    points, cells = patches()
    mesh = trimesh.Trimesh(points, cells, process=False)
    better, report = odt_plugins.optimize_with_report(mesh)
    assert report.after.mean_quality > report.before.mean_quality
    counts = []
    for one in (mesh, better):
        merged = one.copy()
        merged.merge_vertices()
        counts.append(len(merged.vertices))
    assert counts[0] == counts[1] < len(points)
    assert "merge_vertices" in str(report)


def test_a_few_places_where_neighbours_disagree_are_worked_around_and_named():
    sphere = trimesh.creation.icosphere(3)
    points = sphere.vertices + np.random.default_rng(5).normal(0, 0.02, sphere.vertices.shape)
    cells = np.array(sphere.faces)
    cells[100] = cells[100, ::-1]
    better, report = odt_plugins.optimize_with_report((points, cells))
    assert report.after.mean_quality > report.before.mean_quality
    said = re.search(r"about the outside at 3 edges \(1 place: (.*)\) and stay", str(report))
    assert said is not None
    pairs = {tuple(sorted((int(a), int(b)))) for a, b in combinations(cells[100], 2)}
    assert any(said[1].startswith(f"{pair} around (") for pair in pairs)
    _, far = odt_plugins.optimize_with_report((points + 1e5, cells))
    near, there = (
        np.array([float(x) for x in re.findall(r"around \((.*?)\)", str(one))[0].split(", ")])
        for one in (report, far))
    assert np.abs(there - 1e5 - near).max() < 0.01
    flipped = cells.copy()
    apart = np.arange(0, 1200, 150)
    flipped[apart] = flipped[apart, ::-1]
    _, more = odt_plugins.optimize_with_report((points, flipped))
    (line,) = [line for line in str(more).splitlines() if "disagree" in line]
    assert f"at {3 * len(apart) + 3} edges ({len(apart) + 1} places: " in line
    assert line.count(" around (") == 5
    assert line.endswith(", ...) and stay there; try repair='orient', or removing them")
    rows = {tuple(np.roll(c, -int(np.argmin(c))).tolist()) for c in better[1]}
    assert tuple(np.roll(cells[100], -int(np.argmin(cells[100]))).tolist()) in rows
    assert (better[0][cells[100]] == points[cells[100]]).all()
    cells[::3] = cells[::3, ::-1]
    with pytest.raises(InvalidMeshError, match="disagree about the outside; expected one orient"):
        odt_plugins.optimize((points, cells))


def test_faces_that_a_file_calls_periodic_still_correspond_when_the_surface_slides(tmp_path):
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.clear()
        gmsh.model.add("periodic")
        gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
        gmsh.model.occ.synchronize()
        gmsh.model.mesh.setPeriodic(2, [2], [1], [1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1])
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.25)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(tmp_path / "a.msh"))
    finally:
        gmsh.finalize()
    _, report = odt_plugins.optimize_with_report(tmp_path / "a.msh", target=tmp_path / "b.msh",
                                                 boundary="slide")
    assert "of periodic faces stay" in str(report)
    x = meshio.read(tmp_path / "b.msh").points
    low, high = (x[np.abs(x[:, 0] - side) < 1e-9][:, 1:] for side in (0, 1))
    away = np.linalg.norm(low[:, None] - high[None], axis=2).min(axis=1)
    assert len(low) == len(high)
    assert away.max() < 1e-9


def box(n, seed=3):
    """A cube of n^3 boxes of six tetrahedra, vertices inside of it and of its faces jittered.

    Opposite faces have the same jitter.
    """
    index = np.arange((n + 1) ** 3).reshape([n + 1] * 3)
    cells = []
    for order in permutations(range(3)):
        corner = np.zeros((4, 3), dtype=int)
        for i, axis in enumerate(order):
            corner[i + 1] = corner[i]
            corner[i + 1, axis] += 1
        tet = np.stack([index[a:n + a, b:n + b, c:n + c].ravel() for a, b, c in corner], axis=1)
        even = np.linalg.det(np.eye(3)[list(order)]) > 0
        cells.append(tet if even else tet[:, [0, 1, 3, 2]])
    place = np.stack(np.meshgrid(*[np.arange(n + 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    jitter = np.random.default_rng(seed).uniform(-0.25, 0.25, (n + 1, n + 1, n + 1, 3))
    for axis in range(3):
        for side in (0, n):
            jitter[(*[slice(None)] * axis, side)][..., axis] = 0.0
        first = [slice(None)] * 3
        first[axis] = 0
        last = [*first]
        last[axis] = n
        jitter[tuple(last)] = jitter[tuple(first)]
    return (place + jitter.reshape(-1, 3)) / n, np.concatenate(cells)


def partners(points, cells, axis):
    """Triangles at both ends of an axis, the places of their corners without that axis, sorted."""
    ordered = np.sort(cells, axis=1)
    facets, count = np.unique(np.concatenate([np.delete(ordered, i, axis=1) for i in range(4)]),
                              axis=0, return_counts=True)
    facets = facets[count == 1]
    out = []
    for side in (points[:, axis].min(), points[:, axis].max()):
        at = facets[(np.abs(points[facets][..., axis] - side) < 1e-9).all(axis=1)]
        places = np.round(np.delete(points[at], axis, axis=2), 9) + 0.0
        out.append(sorted(tuple(sorted(map(tuple, triangle))) for triangle in places.tolist()))
    return out


@pytest.mark.parametrize("turned", [False, True])
def test_opposite_faces_that_match_in_any_mesh_still_do_when_the_surface_slides(turned):
    points, cells = box(5)
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0] if turned else np.eye(3)
    turn[:, 0] *= np.sign(np.linalg.det(turn))
    if not turned:
        points = points * [1.0, 0.9, 0.8]
    (out, rows), report = odt_plugins.optimize_with_report(
        (points @ turn.T + 3.0 * turned, cells), boundary="slide", keep=())
    back = (out - 3.0 * turned) @ turn
    for axis in range(3):
        low, high = partners(back, rows, axis)
        assert low == high
        assert len(low) == 50
    assert "152 vertices of periodic faces stay" in str(report)
    assert "free='periodic'" in str(report)
    assert any('free="periodic"' in cell.hint for cell in report.binding)
    assert not any("vertices in fixed" in cell.hint for cell in report.binding)
    free, rows = odt_plugins.optimize(
        (points @ turn.T, cells), boundary="slide", free="periodic", keep=())
    assert (free != points @ turn.T).any(axis=1).sum() > 64


@pytest.mark.parametrize("power", [1.0, 1.3])
def test_faces_of_one_label_correspond_by_chance_where_they_get_other_sizes(power):
    points, cells = regular(3, 4)
    points = points**power
    walls = uneven_facets(cells, len(points)).open
    assert [len(rows) for rows in periodic_triangles(points, walls)] == [6 * 32, 0]
    out, report = odt_plugins.remesh_with_report((points, cells), scale=2)
    assert "opposite faces of 192 triangles match, by chance" in str(report)
    assert "try boundary='fixed'" in str(report)
    assert len(uneven_facets(out[1], len(out[0])).open) < 0.6 * len(walls)
    _, report = odt_plugins.remesh_with_report((points, cells), scale=2, boundary="fixed")
    assert "opposite faces" not in str(report)


def test_facets_inside_are_no_borders_of_labels_of_faces_that_correspond():
    points, cells = regular(3, 4)
    points = points**1.3
    inside = ~np.isin(points, [0.0, 1.0]).any(axis=1)
    facets = np.unique(np.sort(cells[:, list(combinations(range(4), 3))].reshape(-1, 3)), axis=0)
    facets = facets[inside[facets].all(axis=1)]
    baffle = facets[np.argsort(points[facets][..., 2].mean(axis=1))[:12]]
    walls = uneven_facets(cells, len(points)).open
    mesh = meshio.Mesh(points, [("tetra", cells), ("triangle", baffle)])
    out, report = odt_plugins.remesh_with_report(mesh, scale=2)
    assert "triangles beside the tetrahedra" in str(report)
    assert "of periodic faces stay" not in str(report)
    assert len(out.cells_dict["triangle"]) == len(baffle)
    assert len(uneven_facets(out.cells_dict["tetra"].astype(np.int64), len(out.points)).open) < (
        0.8 * len(walls))


def test_faces_of_several_labels_that_correspond_stay_where_others_get_other_sizes():
    points, cells = regular(3, 4)
    points = points**1.3
    labels = (points[cells][..., 0].mean(axis=1) > points[:, 0].mean()).astype(int)
    walls = uneven_facets(cells, len(points)).open
    between = np.isclose(points[:, 0], 0.5**1.3)
    held, chance = periodic_triangles(points, walls, between)
    assert set(map(tuple, held)) == {
        tuple(row) for row in walls
        if not np.isclose(points[row], points[row[0]]).all(axis=0)[0]}
    assert len(held) + len(chance) == len(walls)
    assert len(periodic_triangles(regular(3, 4)[0], walls, between)[1]) == len(walls)
    (out, *_), report = odt_plugins.remesh_with_report((points, cells, labels), scale=2)
    assert f"opposite faces of {len(chance)} triangles match, by chance" in str(report)
    assert f"{len(np.unique(held))} vertices of periodic faces stay" in str(report)
    assert {p.tobytes() for p in points[np.unique(held)]} <= {p.tobytes() for p in out}
    inside = np.flatnonzero((points[:, 0] == 0.0) & ~np.isin(points[:, 1:], [0.0, 1.0]).any(axis=1))
    assert not {p.tobytes() for p in points[inside]} <= {p.tobytes() for p in out}


@pytest.mark.parametrize("rounded", [
    lambda x: (x + 1000.0).astype(np.float32),
    lambda x: np.round(x + 1000.0, 4),
])
def test_grids_whose_coordinates_are_rounded_correspond_by_chance_too(rounded):
    points, cells = regular(3, 6)
    labels = (points[cells][..., 0].mean(axis=1) > 0.5).astype(int)
    points = rounded(points)
    (out, rows, _), report = odt_plugins.remesh_with_report((points, cells, labels), scale=1.5)
    assert "of periodic faces stay" not in str(report)
    walls = uneven_facets(cells, len(points)).open
    assert len(uneven_facets(rows, len(out)).open) < 0.6 * len(walls)


def test_faces_that_hardly_match_slide():
    points, cells = box(4)
    faces = np.flatnonzero(np.isclose(points, 1).sum(axis=1) == 1)
    first, _ = periodic_triangles(points, uneven_facets(cells, len(points)).open)
    assert len(first) == 6 * 32
    for axis in range(3):
        at = faces[np.isclose(points[faces, axis], 1)]
        points[at[0], axis - 1] += 0.01
    assert not len(periodic_triangles(points, uneven_facets(cells, len(points)).open)[0])
    _, report = odt_plugins.optimize_with_report((points, cells), boundary="slide")
    assert "periodic" not in str(report)


def test_a_translation_and_the_same_triangles_are_what_matches():
    low = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    points = np.concatenate([low, low + np.array([0.3, 0.2, 2.0])])
    square = np.array([[0, 1, 2], [0, 2, 3]])
    sides = np.array([[0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [3, 2, 6], [3, 6, 7], [0, 3, 7],
                      [0, 7, 4]])
    whole = np.concatenate([square, square + 4, sides])
    assert len(periodic_triangles(points, whole)[0]) == 12
    other = np.concatenate([square, [[4, 5, 7], [5, 6, 7]], sides])
    assert {tuple(row) for row in periodic_triangles(points, other)[0].tolist()} == {
        tuple(row) for row in sides.tolist()}
    mirrored = points.copy()
    mirrored[4:, :2] *= [1.2, 1.1]
    assert not len(periodic_triangles(mirrored, whole)[0])
