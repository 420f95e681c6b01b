"""Cells stretched alike with their neighbours stay by default; slivers are none of them."""

from __future__ import annotations

import functools
import itertools
from typing import Any

import numpy as np
import pytest
from scipy.spatial import Delaunay, cKDTree

import odt_plugins
from odt_plugins.mesh.layers import (
    inverse_metrics,
    keep_layers,
    layer_cells,
    most_regular,
    regularity,
    shapes,
)
from odt_plugins.mesh.simplex import simplex_mesh
from odt_plugins.mesh.symmetric import eigen, logarithms

HEIGHTS = 0.002 * (1.4 ** np.arange(9) - 1.0) / 0.4


def around_ellipse() -> tuple[Any, Any, Any]:
    """Triangles around an ellipse: rows that grow along the normal, then a disc of random points.

    Returns points, cells, and which cells are in the rows.
    """
    points, cells, layer = _around_ellipse(96)
    return points.copy(), cells.copy(), layer.copy()


@functools.cache
def _around_ellipse(columns: int) -> tuple[Any, Any, Any]:
    angle = np.linspace(0.0, 2.0 * np.pi, columns, endpoint=False)
    wall = np.stack([np.cos(angle), 0.5 * np.sin(angle)], axis=1)
    normal = np.stack([0.5 * np.cos(angle), np.sin(angle)], axis=1)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    rows = (wall + h * normal for h in HEIGHTS)
    points = np.concatenate(list(rows))
    i, j = np.meshgrid(np.arange(len(HEIGHTS) - 1), np.arange(columns), indexing="ij")
    a, b = (i * columns + j).ravel(), (i * columns + (j + 1) % columns).ravel()
    layer = np.concatenate([np.stack([a, b, b + columns], 1),
                            np.stack([a, b + columns, a + columns], 1)])
    rng = np.random.default_rng(0)
    more = rng.uniform(-2.0, 2.0, (6000, 2))
    inside = ((np.abs(more) / (1.12, 0.62)) ** 2).sum(axis=1) < 1.0
    apart = more[~inside]
    kept: list[Any] = []
    for x in apart:
        if not kept or np.min(np.linalg.norm(np.array(kept) - x, axis=1)) > 0.06:
            kept.append(x)
    outer = points[-columns:]
    beyond = Delaunay(np.concatenate([outer, np.array(kept)])).simplices
    beyond = beyond[~(beyond < columns).all(axis=1)]
    cells = np.concatenate([layer, beyond + len(points) - columns])
    return np.concatenate([points, np.array(kept)]), cells, np.arange(len(cells)) < len(layer)


def boxes(heights: Any, across: int = 8) -> tuple[Any, Any, Any]:
    """Boxes of given levels, each cut into six tetrahedra, and the level that every cell is in."""
    levels = len(heights) - 1
    x = np.arange(across + 1) / across
    points = np.stack(np.meshgrid(x, x, heights, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(points)).reshape(across + 1, across + 1, levels + 1)
    corner = np.stack(np.meshgrid(*map(np.arange, (across, across, levels)), indexing="ij"), -1)
    corner = corner.reshape(-1, 3)
    cells, level = [], []
    for steps in itertools.permutations(np.eye(3, dtype=int)):
        path = [corner + sum(steps[:k], np.zeros(3, dtype=int)) for k in range(4)]
        cells.append(np.stack([number[tuple(at.T)] for at in path], axis=1))
        level.append(corner[:, 2])
    return points, np.concatenate(cells), np.concatenate(level)


def prisms() -> tuple[Any, Any, Any]:
    """Thin levels that grow at a wall and thick ones, whose vertices are moved a little, beyond."""
    heights = np.append(HEIGHTS, HEIGHTS[-1] + 0.125 * np.arange(1, 6))
    points, cells, level = boxes(heights)
    inner = ((points > 0.0) & (points < (1.0, 1.0, heights[-1]))).all(axis=1)
    inner &= points[:, 2] > HEIGHTS[-1]
    rng = np.random.default_rng(1)
    points[inner] += rng.uniform(-0.03, 0.03, (inner.sum(), 3))
    return points, cells, level < len(HEIGHTS) - 2


def thin_plate() -> tuple[Any, Any, Any]:
    """One level of boxes, far thinner than wide, with vertices moved along it."""
    points, cells, level = boxes([0.0, 0.004, 0.008])
    inner = ((points > 0.0) & (points < (1.0, 1.0, 0.008))).all(axis=1)
    points[inner, :2] += np.random.default_rng(2).uniform(-0.02, 0.02, (inner.sum(), 2))
    return points, cells, level >= 0


def random_ball(d: int, n: int = 3000) -> tuple[Any, Any]:
    """Delaunay cells of random points in a ball: slivers of any direction."""
    x = np.random.default_rng(3).normal(size=(n, d))
    x *= (np.random.default_rng(4).random(n) ** (1.0 / d) / np.linalg.norm(x, axis=1))[:, None]
    return x, Delaunay(x).simplices


def rows_of(cells: Any) -> set[tuple[int, ...]]:
    return {tuple(row) for row in np.sort(cells, axis=1).tolist()}


@pytest.mark.parametrize("made", [around_ellipse, prisms, thin_plate])
def test_layers_stay_bit_for_bit_by_default_and_not_when_freed(made: Any) -> None:
    points, cells, layer = made()
    vertices = np.unique(cells[layer])
    (out, rows), report = odt_plugins.optimize_with_report((points, cells))
    assert (out[vertices] == points[vertices]).all()
    assert rows_of(cells[layer]) <= rows_of(rows)
    assert report.layers >= layer.sum()
    assert report.to_dict()["layers"] == report.layers
    line = [line for line in str(report).splitlines() if line.startswith("layers ")]
    assert len(line) == 1
    assert str(report.layers) in line[0]
    assert "free='layers'" in line[0]
    (out, rows), report = odt_plugins.optimize_with_report(
        (points, cells), free="layers", keep=())
    changed = (out[vertices] != points[vertices]).any() or not (
        rows_of(cells[layer]) <= rows_of(rows))
    assert changed
    assert report.layers == 0
    assert "free='layers'" not in str(report)


def test_what_lies_beyond_a_layer_is_improved_as_ever() -> None:
    points, cells, layer = around_ellipse()
    out, rows = odt_plugins.optimize((points, cells))
    before = regularity(points, cells[~layer])
    after = regularity(out, np.array(sorted(rows_of(rows) - rows_of(cells[layer]))))
    assert after.mean() > before.mean() + 0.01


@pytest.mark.parametrize("d", [2, 3])
def test_random_delaunay_cells_are_no_layer(d: int) -> None:
    points, cells = random_ball(d)
    assert (regularity(points, cells) < most_regular(4.0, d)).mean() > 0.1
    assert not layer_cells(points, cells.astype(np.int32)).any()


def filled(axes: Any, n: int) -> tuple[Any, Any]:
    """Delaunay cells of points on an ellipsoid, with none inside."""
    i = np.arange(n) + 0.5
    z, turn = 1.0 - 2.0 * i / n, np.pi * (1.0 + 5.0**0.5) * i
    across = np.sqrt(1.0 - z * z)
    points = np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1) * axes
    cells = Delaunay(points).simplices
    volumes = np.linalg.det(points[cells[:, 1:]] - points[cells[:, :1]])
    cells[volumes < 0.0] = cells[volumes < 0.0][:, [1, 0, 2, 3]]
    return points, cells[np.abs(volumes) > 1e-12].astype(np.int32)


@pytest.mark.parametrize(("axes", "n"), [
    ((1.0, 1.0, 1.0), 400), ((1.0, 0.8, 0.6), 400), ((1.0, 0.5, 0.2), 2000)])
def test_what_fills_a_surface_without_vertices_inside_is_no_layer(axes: Any, n: int) -> None:
    points, cells = filled(axes, n)
    assert (regularity(points, cells) < most_regular(4.0, 3)).mean() > 0.5
    assert not layer_cells(points, cells).any()
    _, report = odt_plugins.remesh_with_report((points, cells), scale=1.0)
    assert report.layers == 0
    assert report.after.min_quality > 0.3
    assert report.after.mean_quality > 0.6 > 0.2 > report.before.mean_quality


@pytest.mark.parametrize("mesh", ["ball", "airfoil"])
def test_an_affine_image_of_a_good_mesh_is_a_layer(mesh: str) -> None:
    from odt_plugins.compare import start

    made = start.ball(3000) if mesh == "ball" else start.plate(2000)
    points = made.points
    cells = made.cells.astype(np.int32)
    assert not layer_cells(points, cells).any()
    rng = np.random.default_rng(5)
    turn = np.linalg.qr(rng.normal(size=(points.shape[1],) * 2))[0]
    factor = np.ones(points.shape[1])
    factor[0] = 12.0
    assert layer_cells((points @ turn) * factor @ turn.T, cells).mean() > 0.9


def test_cells_of_a_layer_do_not_depend_on_unit_place_order_or_threads() -> None:
    points, cells, _ = around_ellipse()
    cells = cells.astype(np.int32)
    found = layer_cells(points, cells)
    assert (layer_cells(points * 2.0**-30, cells) == found).all()
    assert (layer_cells(points, cells, threads=2) == found).all()
    order = np.random.default_rng(6).permutation(len(cells))
    assert (layer_cells(points, cells[order][:, [2, 0, 1]]) == found[order]).all()


def test_a_thin_level_between_thick_ones_of_other_labels_is_a_layer() -> None:
    points, cells, level = boxes([-0.2, -0.1, 0.0, 0.004, 0.104, 0.204])
    label = np.where(level == 2, 1, 0).astype(np.int32)
    found = layer_cells(points, cells.astype(np.int32), label)
    assert found[level == 2].all()
    assert not found[level != 2].any()


def test_the_boundary_layer_of_gmsh_around_an_ellipse_stays() -> None:
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.clear()
    occ, mesh = gmsh.model.occ, gmsh.model.mesh
    wall, far = occ.addEllipse(0, 0, 0, 1, 0.4), occ.addCircle(0, 0, 0, 4)
    occ.addPlaneSurface([occ.addCurveLoop([far]), occ.addCurveLoop([wall])])
    occ.synchronize()
    mesh.setTransfiniteCurve(wall, 100)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.4)
    field = mesh.field.add("BoundaryLayer")
    mesh.field.setNumbers(field, "CurvesList", [wall])
    for name, value in {"Size": 0.001, "Ratio": 1.3, "Thickness": 0.04, "Quads": 0}.items():
        mesh.field.setNumber(field, name, value)
    mesh.field.setAsBoundaryLayer(field)
    mesh.generate(2)
    tags, places, _ = mesh.getNodes()
    corners = mesh.getElementsByType(2)[1].reshape(-1, 3)
    gmsh.finalize()
    number = np.zeros(int(tags.max()) + 1, dtype=np.int64)
    number[tags] = np.arange(len(tags))
    points, cells = places.reshape(-1, 3)[:, :2].copy(), number[corners]
    angle = np.linspace(0.0, 2.0 * np.pi, 20001)
    curve = np.stack([np.cos(angle), 0.4 * np.sin(angle)], axis=1)
    layer = np.flatnonzero(cKDTree(curve).query(points)[0] < 0.038)
    assert len(layer) > 200
    out, rows = odt_plugins.optimize((points, cells))
    assert (out[layer] == points[layer]).all()
    assert rows_of(cells[np.isin(cells, layer).all(axis=1)]) <= rows_of(rows)
    out, rows = odt_plugins.optimize((points, cells), free="layers")
    assert (out[layer] != points[layer]).any(axis=1).sum() > 50


def test_few_stretched_cells_are_no_layer() -> None:
    points, cells, _ = boxes([0.0, 0.01], across=3)
    assert not layer_cells(points, cells.astype(np.int32)).any()


def test_needles_of_a_curved_surface_stay_free() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.concatenate([np.insert(ring, 2, z, axis=1) for z in (0.0, 5.0)])
    a, b = np.arange(60), (np.arange(60) + 1) % 60
    cells = np.concatenate([np.stack([a, b, b + 60], 1), np.stack([a, b + 60, a + 60], 1)])
    from odt_plugins.mesh.surface import surface_mesh

    mesh = surface_mesh(points, cells)
    assert keep_layers(mesh) == (mesh, 0)


def test_frozen_cells_are_not_counted_again() -> None:
    points, cells, _ = thin_plate()
    half = np.arange(len(cells)) % 2 == 0
    mesh, _ = simplex_mesh(points, cells, selection=half)
    kept, count = keep_layers(mesh)
    assert kept.frozen.all()
    assert count == half.sum()


def test_edges_have_length_one_in_the_metric_of_their_cell() -> None:
    rng = np.random.default_rng(7)
    for d in (2, 3):
        points = rng.normal(size=(d + 1, d))
        cells = np.arange(d + 1, dtype=np.int32)[None]
        inverse = inverse_metrics(points, cells)[0]
        pairs = itertools.combinations(range(d + 1), 2)
        edges = np.array([points[b] - points[a] for a, b in pairs])
        squares = np.einsum("ei,ij,ej->e", edges, np.linalg.inv(inverse), edges)
        assert np.ptp(squares) < 1e-9 * squares.mean()
        shape = shapes(inverse[None])[0]
        assert abs(np.trace(shape)) < 1e-12
        values = np.exp(np.linalg.eigvalsh(shape))
        assert np.isclose(regularity(points, cells)[0], (values / values.mean()).prod())
        assert regularity(points, cells)[0] <= most_regular(
            np.sqrt(values[-1] / values[0]), d) * (1 + 1e-12)


def test_layers_of_a_tangled_mesh_stay_and_what_untangling_stretches_is_none() -> None:
    points, cells, layer = around_ellipse()
    boundary = Delaunay(points).convex_hull
    free = np.setdiff1d(np.arange(len(points)), np.append(cells[layer], boundary))
    star = next(v for v in free if np.isin(cells[(cells == v).any(axis=1)], free).all())
    around = cells[(cells == star).any(axis=1)]
    far = points[around].mean(axis=1) - points[star]
    bent = points.copy()
    bent[star] += 4.0 * far[np.argmax(np.linalg.norm(far, axis=1))]
    vertices = np.unique(cells[layer])
    (out, rows), report = odt_plugins.optimize_with_report((bent, cells))
    assert report.untangled is not None
    assert (out[vertices] == points[vertices]).all()
    assert rows_of(cells[layer]) <= rows_of(rows)
    assert report.layers < 1.2 * layer.sum()


def test_where_most_cells_are_stretched_they_get_the_sizes_that_are_asked_for() -> None:
    around = 2 * np.pi * np.arange(60) / 60
    ring = np.stack([np.cos(around), np.sin(around)], axis=1)
    i, j = np.arange(60), np.roll(np.arange(60), -1)
    points = np.concatenate([ring, 0.2 * ring])
    cells = np.concatenate([np.stack([i, j, 60 + j], 1), np.stack([i, 60 + j, 60 + i], 1)])
    assert odt_plugins.optimize_with_report((points, cells))[1].layers == len(cells)
    out, report = odt_plugins.remesh_with_report((points, cells), 0.1)
    assert report.layers == 0
    assert any("metric='input'" in note for note in report.notes)
    assert report.after.mean_quality > 0.97 > 0.2 > report.before.mean_quality
    assert len(out[1]) > 4 * len(cells)


@pytest.mark.parametrize("d", [2, 3])
def test_eigenvalues_and_logarithms_are_those_of_numpy(d: int) -> None:
    rng = np.random.default_rng(8)
    matrices = rng.normal(size=(200, d, d))
    matrices = np.concatenate([
        matrices @ matrices.transpose(0, 2, 1), np.zeros((1, d, d)), np.eye(d)[None],
        np.diag([1e-12, 1.0, 1e6][:d])[None]])
    values, axes = eigen(matrices)
    known = np.linalg.eigvalsh(matrices)
    assert np.allclose(np.sort(values, axis=1), known, rtol=1e-13, atol=1e-14)
    assert np.allclose(axes * values[:, None, :] @ axes.transpose(0, 2, 1), matrices, atol=1e-13)
    numbers = np.exp(rng.uniform(-300.0, 300.0, 1000))
    assert np.allclose(logarithms(numbers), np.log(numbers), rtol=1e-15, atol=1e-15)


def test_an_unknown_way_is_refused() -> None:
    with pytest.raises(odt_plugins.InvalidOptionError, match="free='skip'"):
        odt_plugins.Options(free="skip")  # type: ignore[arg-type]
