"""One mesh in blocks: every cell is inside one in some round, the whole keeps the promise."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from itertools import takewhile
from typing import Any

import meshio
import numpy as np
import pytest
import surface_meshes
import tet_meshes
from policies import set_policy

import odt_plugins
from odt_plugins.carrying.roundtrip import optimized
from odt_plugins.compare.start import ball, plate, reordered, stored
from odt_plugins.distributed import optimize as blocks_module
from odt_plugins.distributed.block import Block, Improved, improve
from odt_plugins.distributed.glue import Task, Whole, labels, one_round
from odt_plugins.distributed.optimize import run_blocks
from odt_plugins.distributed.partition import (
    RINGS,
    WORST_RINGS,
    bricks,
    clusters,
    groups,
    grown,
    seams,
)
from odt_plugins.distributed.versions import versions_here
from odt_plugins.engine.cells.geometry import boundary_facets
from odt_plugins.engine.run.outcome import as_it_is
from odt_plugins.engine.run.within import Within
from odt_plugins.engine.topology import coloring
from odt_plugins.errors import InvalidMeshError, InvalidOptionError
from odt_plugins.mesh.simplex import SimplexMesh, simplex_mesh
from odt_plugins.mesh.surface import surface_mesh
from odt_plugins.options import Options
from odt_plugins.promise.volume import broken_promises


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let small meshes be cut."""
    monkeypatch.setattr(blocks_module, "LEAST_CELLS", 300)
    monkeypatch.setattr(blocks_module, "LAST_CELLS", 3000)


def mesh_of(n: int, **given: Any) -> SimplexMesh:
    start = ball(n)
    return simplex_mesh(start.points, start.cells, **given)[0]


def whole_of(mesh: SimplexMesh) -> Whole:
    n = len(mesh.points)
    return Whole(mesh, None, np.ones(n, dtype=bool), np.full(n, -1, dtype=np.int32))


def figures(points: Any, cells: Any) -> dict[str, float]:
    q = tet_meshes.quality(points, cells)
    return {"mean": q.mean(), "p1": np.quantile(q, 0.01), "min": q.min()}


def unchanged(block: Block) -> Improved:
    mesh = block.mesh
    return Improved(mesh.points, mesh.cells, mesh.regions, block.density, mesh.metric, {}, None)


@pytest.mark.parametrize("count", [1, 2, 3, 7, 16])
def test_bricks_hold_equal_numbers_of_cells(count):
    mesh = mesh_of(200)
    label = bricks(mesh.points, mesh.cells, count)
    sizes = np.bincount(label, minlength=count)
    assert len(sizes) == count
    assert sizes.max() - sizes.min() <= np.ceil(np.log2(count + 1))


def test_bricks_do_not_depend_on_the_order_of_the_cells():
    mesh = mesh_of(800)
    order = np.random.default_rng(3).permutation(len(mesh.cells))
    assert np.array_equal(bricks(mesh.points, mesh.cells[order], 5),
                          bricks(mesh.points, mesh.cells, 5)[order])


def test_seams_are_where_labels_meet_and_patches_where_two_do():
    mesh = mesh_of(100)
    label = bricks(mesh.points, mesh.cells, 4) - 1
    shared, patch = seams(mesh.cells, label, len(mesh.points))
    pairs: dict[int, set[int]] = {}
    for v in range(len(mesh.points)):
        around = {*label[(mesh.cells == v).any(axis=1)].tolist()}
        assert shared[v] == (len(around) > 1)
        assert (patch[v] >= 0) == (len(around) == 2)
        if patch[v] >= 0:
            assert pairs.setdefault(patch[v], around) == around
    assert len(pairs) == len({frozenset(pair) for pair in pairs.values()}) > 2


def test_labels_grow_ring_by_ring():
    mesh = mesh_of(300)
    patch = np.full(len(mesh.points), -1, dtype=np.int32)
    patch[[7, 90]] = [4, 2]
    for count in (1, 2, 3):
        label = grown(patch, mesh.cells, count)
        reached = {4: {7}, 2: {90}}
        for _ in range(count):
            near = {k: np.isin(mesh.cells, list(v)).any(axis=1) for k, v in reached.items()}
            reached = {k: set(mesh.cells[near[k]].ravel().tolist()) for k in reached}
        assert np.array_equal(label >= 0, near[2] | near[4])
        assert (label[near[2] & ~near[4]] == 2).all()
        assert (label[near[4] & ~near[2]] == 4).all()


def test_clusters_are_whole_components():
    cells = np.array([[0, 1, 2, 3], [3, 4, 5, 6], [10, 11, 12, 13], [20, 21, 22, 23]])
    label = clusters(cells, 2)
    assert label[0] == label[1]
    assert set(label.tolist()) == {0, 1}
    assert [g.tolist() for g in groups(np.array([2, -1, 0, 2]))] == [[2], [0, 3]]


@pytest.mark.parametrize(("count", "rounds"), [(2, 2), (5, 2), (8, 3), (20, 3), (20, 4)])
def test_every_vertex_is_inside_a_block_in_some_round(count, rounds):
    mesh = mesh_of(600)
    n = len(mesh.points)
    inside = np.zeros(n, dtype=bool)
    whole = whole_of(mesh)
    for index in range(rounds):
        label = labels(whole, count, index, rounds)
        # Slow twin: all cells around the vertex are in one block.
        stars = [label[np.flatnonzero((whole.mesh.cells == v).any(axis=1))]
                 for v in np.flatnonzero(~inside)]
        inside[~inside] = [s.min() >= 0 and s.min() == s.max() for s in stars]
        whole, traffic = one_round(whole, label, Task(Options()), lambda _, b: map(unchanged, b))
        assert (whole.waiting == ~inside).all()
        assert traffic.cells == (label >= 0).sum()
    assert inside.all()


def test_gluing_what_was_cut_gives_the_mesh_back():
    mesh = mesh_of(500, regions=np.arange(len(ball(500).cells)) % 3)
    whole = replace(whole_of(mesh), density=np.arange(len(mesh.points), dtype=float))
    label = bricks(mesh.points, mesh.cells, 4)
    label[::7] = -1
    glued, _ = one_round(whole, label, Task(Options()), lambda _, b: map(unchanged, b))
    assert np.array_equal(glued.mesh.points, mesh.points)
    assert np.array_equal(glued.density, whole.density)
    rows = [sorted(zip(m.cells.tolist(), m.regions.tolist(), strict=True))
            for m in (mesh, glued.mesh)]
    assert rows[0] == rows[1]


def test_the_last_round_looks_after_the_worst_cells_too():
    mesh = mesh_of(2000)
    n = len(mesh.points)
    waiting, worst = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    waiting[:2], worst[9] = True, True
    whole = replace(whole_of(mesh), waiting=waiting, patch=np.where(waiting, 0, -1))
    for index in (1, 2):
        label = labels(whole, 2, index, 3, worst)
        wanted = np.zeros(len(mesh.cells), dtype=bool)
        for start, rings in ((waiting, RINGS), (worst, WORST_RINGS)):
            reached = start.copy()
            for _ in range(rings if index == 2 or start is waiting else 0):
                near = reached[mesh.cells].any(axis=1)
                reached[mesh.cells[near]] = True
                wanted |= near
        assert np.array_equal(label >= 0, wanted)
    assert not wanted.all()


def test_the_worst_cells_are_looked_for_away_from_the_cuts():
    mesh = mesh_of(600)
    q = tet_meshes.quality(mesh.points, mesh.cells)
    waiting = np.zeros(len(mesh.points), dtype=bool)
    waiting[mesh.cells[q.argsort()[:30]]] = True
    away = mesh.cells[~waiting[mesh.cells].any(axis=1)]
    least = away[tet_meshes.quality(mesh.points, away).argsort()[:blocks_module.WORST_CELLS]]
    assert blocks_module._worst(replace(whole_of(mesh), waiting=waiting))[least].all()


def test_phases_for_the_worst_cells_of_the_whole_wait_for_the_last_round(small_blocks):
    mesh = mesh_of(600)
    seen: list[tuple[str, ...]] = []
    at_work: list[Any] = []

    def sees(function: Any, items: Iterable[Block]) -> Iterator[Improved]:
        for block in items:
            seen.append(block.within.without)
            if not block.within.without:
                at_work.append(block.mesh)
            yield unchanged(block)

    run_blocks(mesh, Options(), 3, 3, sees)
    assert seen[0] == blocks_module.LAST
    assert set(seen) == {blocks_module.LAST, ()}
    angles = tet_meshes.dihedral_angles(mesh.points, mesh.cells).reshape(len(mesh.cells), -1)
    worst = mesh.cells[angles.min(axis=1).argsort()[:blocks_module.WORST_CELLS]]
    places = {tuple(x) for block in at_work for x in block.points}
    assert all(tuple(x) in places for x in mesh.points[worst].reshape(-1, 3))


@pytest.mark.parametrize(("most", "rounds"), [(0, 3), (30_000, 2)])
def test_few_cells_around_the_cuts_are_done_in_one_last_round(
    small_blocks, monkeypatch, most, rounds
):
    monkeypatch.setattr(blocks_module, "LAST_CELLS", most)
    seen: list[list[Block]] = []

    def sees(function: Any, items: Iterable[Block]) -> Iterator[Improved]:
        seen.append([])
        for block in items:
            seen[-1].append(block)
            yield unchanged(block)

    mesh = mesh_of(600)
    run_blocks(mesh, Options(), 4, 3, sees)
    assert len(seen) == rounds
    assert all(block.within.fresh is None for block in seen[0])
    assert all(block.within.part == blocks_module.FIRST_PART for block in seen[0])
    inside = sum(len(block.mesh.cells) for block in seen[-1])
    for block in seen[-1]:
        assert block.within.fresh is not None
        assert block.within.part == inside / len(mesh.cells)
        assert not block.within.cut.any()
        assert block.within.without == ()
    fresh = [block.within.fresh.any() for blocks in seen[1:] for block in blocks]
    assert any(fresh)


def moved_rim(result: Improved) -> Improved:
    return replace(result, points=result.points + 1e-3)


def other_vertices(result: Improved) -> Improved:
    return replace(result, points=result.points[1:])


def foreign_cells(result: Improved) -> Improved:
    return replace(result, cells=result.cells + len(result.points))


@pytest.mark.parametrize("spoil", [moved_rim, other_vertices, foreign_cells])
def test_a_result_that_does_not_fit_its_block_is_refused(spoil):
    mesh = mesh_of(200)
    whole = whole_of(mesh)
    label = bricks(mesh.points, mesh.cells, 2)
    with pytest.raises(InvalidMeshError, match="block 0 does not fit"):
        one_round(whole, label, Task(Options()), lambda _, b: map(lambda x: spoil(unchanged(x)), b))


@pytest.mark.parametrize(("name", "seed"), [
    ("bunny", None), ("cgal-bunny", 1), ("ball", None),
])
def test_blocks_are_about_as_good_as_one_piece(name, seed, monkeypatch):
    monkeypatch.setattr(blocks_module, "LEAST_CELLS", 5000)
    # as in the larger blocks of a run
    monkeypatch.setattr(coloring, "ONE_BLOCK", 0)
    start = ball(4000) if name == "ball" else stored(name)
    start = start if seed is None else reordered(start, seed)
    mesh = start.points, start.cells
    one, blocks = (
        figures(*result) for result in (
            odt_plugins.optimize(mesh), odt_plugins.optimize(mesh, blocks=4),
        )
    )
    assert abs(one["mean"] - blocks["mean"]) <= 0.003
    assert abs(one["p1"] - blocks["p1"]) <= 0.01


def fine_near_the_middle(points: Any) -> Any:
    """A metric that is five times as fine across a plane as along it, near that plane."""
    out = np.tile(9.0 * np.eye(3), (len(points), 1, 1))
    out[:, 2, 2] *= 1.0 + 24.0 * np.exp(-((points[:, 2] / 0.3) ** 2))
    return out


@pytest.mark.parametrize("boundary", ["fixed", "slide"])
def test_blocks_see_the_metric(small_blocks, boundary):
    start = ball(600)
    mesh = start.points, start.cells

    def seen(points, cells):
        middle = points[cells].mean(axis=1, keepdims=True)
        root = np.sqrt(fine_near_the_middle(middle[:, 0]).diagonal(axis1=1, axis2=2))
        apart = (points[cells] * root[:, None]).reshape(-1, 3)
        return figures(apart, np.arange(len(apart)).reshape(-1, 4))

    how = {"metric": fine_near_the_middle, "boundary": boundary}
    one, blocks = (odt_plugins.optimize(mesh, **how, **more) for more in ({}, {"blocks": 3}))
    before, alone, apart = seen(*mesh), seen(*one), seen(*blocks)
    assert not np.array_equal(one[1], blocks[1])
    assert apart["mean"] > before["mean"] + 0.8 * (alone["mean"] - before["mean"])
    assert apart["p1"] > before["p1"] + 0.5 * (alone["p1"] - before["p1"])
    plain = seen(*odt_plugins.optimize(mesh, boundary=boundary, blocks=3))
    assert apart["mean"] > plain["mean"] + 0.02


def test_blocks_of_a_curved_surface_see_the_metric(small_blocks):
    points, cells = surface_meshes.sphere(3)
    rng = np.random.default_rng(0)
    away = points + rng.normal(scale=0.03, size=points.shape)
    mesh = away / np.linalg.norm(away, axis=1)[:, None], cells

    def seen(points, cells):
        middle = points[cells].mean(axis=1)
        root = np.sqrt(fine_near_the_middle(middle).diagonal(axis1=1, axis2=2))
        a, b, c = np.moveaxis(points[cells] * root[:, None], 1, 0)
        area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
        squares = sum(((x - y) ** 2).sum(axis=1) for x, y in ((a, b), (b, c), (c, a)))
        return (4.0 * np.sqrt(3.0) * area / squares).mean()

    one, blocks = (odt_plugins.optimize(mesh, metric=fine_near_the_middle, envelope=0.01, **more)
                   for more in ({}, {"blocks": 3}))
    before, alone, apart = seen(*mesh), seen(*one), seen(*blocks)
    assert not np.array_equal(one[1], blocks[1])
    assert apart > before + 0.8 * (alone - before) > before + 0.01


def test_the_metric_moves_with_the_vertices(small_blocks):
    """After two rounds it is the one of the places where they are."""
    start = ball(600)
    mesh = simplex_mesh(start.points, start.cells)[0]
    rows = np.zeros((len(mesh.points), 6))
    rows[:, 5] = 0.3 * mesh.points[:, 2]
    outcome = run_blocks(replace(mesh, metric=rows), Options(), 3, 2, map)
    assert np.abs(outcome.points - mesh.points).max() > 0.01
    assert outcome.metric[:, 5] == pytest.approx(0.3 * outcome.points[:, 2], abs=1e-12)


def test_the_metric_of_a_curved_surface_moves_with_the_vertices(small_blocks):
    """After two rounds it is the one of the places of the input where they are."""
    points, cells = surface_meshes.sphere(3)
    away = points + np.random.default_rng(0).normal(scale=0.03, size=points.shape)
    mesh = surface_mesh(away / np.linalg.norm(away, axis=1)[:, None], cells)
    rows = np.zeros((len(mesh.points), 6))
    rows[:, 5] = 0.3 * mesh.points[:, 2]
    outcome = run_blocks(replace(mesh, metric=rows), Options(envelope=0.01), 3, 2, map)
    assert outcome.fallback is None, "the second round was given up"
    assert np.abs(outcome.points - mesh.points).max() > 0.01
    assert outcome.metric[:, 5] == pytest.approx(0.3 * outcome.points[:, 2], abs=1e-12)


def test_blocks_choose_their_flips_as_the_whole_would(small_blocks, monkeypatch):
    mesh = mesh_of(600)
    seen: list[str] = []

    def sees(function: Any, items: Iterable[Block]) -> Iterator[Improved]:
        for block in items:
            seen.append(block.options.smoothing.connectivity)
            yield unchanged(block)

    run_blocks(mesh, Options(), 4, 1, sees)
    assert seen[:4] == ["auto"] * 4
    seen.clear()
    set_policy(monkeypatch, blocks_module, exchange_cells=len(mesh.cells) - 1)
    run_blocks(mesh, Options(), 4, 1, sees)
    run_blocks(mesh, Options(smoothing={"connectivity": "delaunay"}), 4, 1, sees)
    assert seen == ["flips"] * 4 + ["delaunay"] * 4


def backwards(function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
    """Finish the last block first."""
    work = list(items)
    done = [function(item) for item in reversed(work)]
    return reversed(done)


def test_the_whole_keeps_the_promise_in_any_order_of_completion(small_blocks):
    start = ball(600)
    rng = np.random.default_rng(5)
    m = len(start.cells)
    x = start.points[start.cells].mean(axis=1)
    selection = np.linalg.norm(x - [0.5, 0.0, 0.0], axis=1) > 0.25
    fixed = rng.random(len(start.points)) < 0.05
    mesh = simplex_mesh(start.points, start.cells, regions=(x[:, 0] > 0.0).astype(int),
                        fixed=fixed, selection=selection)[0]
    assert 0 < selection.sum() < m
    options = Options()
    outcome = run_blocks(mesh, options, 5, 3, map)
    assert not broken_promises(mesh, outcome.points, outcome.cells, outcome.regions)
    assert outcome.counts["round 1 blocks"] == 5
    assert (outcome.points != start.points).any(axis=1).sum() > 0.2 * len(start.points)
    other = run_blocks(mesh, options, 5, 3, backwards)
    for a, b in zip((outcome.points, outcome.cells, outcome.regions),
                    (other.points, other.cells, other.regions), strict=True):
        assert np.array_equal(a, b)


@pytest.mark.parametrize("always", [True, False])
def test_a_round_that_breaks_the_promise_of_the_whole_is_done_again_or_given_up(
    small_blocks, always
):
    mesh = mesh_of(900)
    judged: list[bool] = []

    def spoiled(function: Any, items: Iterable[Block]) -> Iterator[Improved]:
        judged.append(False)
        for block in items:
            judged[-1] = block.within.whole is None
            result = function(block)
            if len(judged) % 3 == 0 and (always or block.within.whole is not None):
                free = ~block.mesh.fixed
                centre = result.points.mean(axis=0)
                points = result.points.copy()
                points[free] = centre
                result = replace(result, points=points)
            yield result

    outcome = run_blocks(mesh, Options(), 5, 3, spoiled)
    assert judged == [False] * 3 + [True] * 3
    assert not broken_promises(mesh, outcome.points, outcome.cells, outcome.regions)
    calls: list[int] = []

    def alone(block: Block) -> Improved:
        return improve(replace(block, within=block.within._replace(whole=None)))

    expected = run_blocks(mesh, Options(), 5, 3, lambda _, b: map(
        alone if calls.append(1) or not always or len(calls) < 3 else unchanged, b))
    assert np.array_equal(outcome.points, expected.points)
    if always:
        assert "a later round was given up" in outcome.fallback
    else:
        assert outcome.fallback == expected.fallback


def test_blocks_are_held_to_the_worst_cells_of_the_whole_then_to_their_own(
    small_blocks, monkeypatch
):
    mesh = mesh_of(600)
    seen: list[Any] = []
    real = blocks_module.faults

    def sees(function: Any, items: Iterable[Block]) -> Iterator[Improved]:
        for block in items:
            seen.append(block.within.whole)
            yield function(block)

    def spoiled(*given: Any) -> Any:
        return real(*given) if seen[-1] is None else (["min_angle would be worse"], None)

    monkeypatch.setattr(blocks_module, "faults", spoiled)
    outcome = run_blocks(mesh, Options(), 5, 3, sees)
    first = list(takewhile(lambda whole: whole is not None, seen))
    second = seen[len(first):]
    q = tet_meshes.quality(mesh.points, mesh.cells)
    angles = np.radians(tet_meshes.dihedral_angles(mesh.points, mesh.cells))
    assert all(whole.min_quality == pytest.approx(q.min()) for whole in first)
    assert all(whole.cos_min_angle == pytest.approx(np.cos(angles.min())) for whole in first)
    assert all(whole.cos_max_angle == pytest.approx(np.cos(angles.max())) for whole in first)
    assert first
    assert second == [None] * len(second)
    assert second
    assert outcome.fallback is None or "would be worse" not in outcome.fallback
    assert not broken_promises(mesh, outcome.points, outcome.cells, outcome.regions)
    assert (outcome.points != mesh.points).any()


def test_data_of_the_caller_come_through(small_blocks):
    start = ball(700)
    m = len(start.cells)
    part = (start.points[start.cells].mean(axis=1)[:, 2] > 0.0).astype(np.int32)
    mesh = meshio.Mesh(start.points.astype(np.float32), [("tetra", start.cells)],
                       point_data={"id": np.arange(len(start.points))},
                       cell_data={"marker": [part], "x": [np.arange(m, dtype=float)]})
    seen: list[tuple[str, float]] = []
    result, report = odt_plugins.optimize_with_report(
        mesh, blocks=3, progress=lambda stage, share: seen.append((stage, share))
    )
    assert type(result) is meshio.Mesh
    assert result.points.dtype == np.float32
    assert np.array_equal(result.point_data["id"], np.arange(len(start.points)))
    volume = [np.bincount(k.cell_data["marker"][0], tet_meshes.signed_volumes(
        k.points.astype(float), k.cells[0].data)) for k in (mesh, result)]
    assert volume[1] == pytest.approx(volume[0], rel=1e-5)
    assert report.after.mean_quality > report.before.mean_quality + 0.1
    assert {name for name, _ in seen} == {"preparing", "round 1", "round 2", "round 3"}
    assert report.counts["round 1 bytes sent"] > 16 * m


@pytest.mark.parametrize("density", ["keep", "uniform", "vertices", "cells", "function"])
def test_densities_come_through(small_blocks, density):
    start = ball(500)
    given: Any = {"vertices": 1.0 + start.points[:, 0] ** 2,
                  "cells": 1.0 + np.arange(len(start.cells)) / len(start.cells),
                  "function": lambda x: 1.0 + x[:, 1] ** 2}.get(density, density)
    selection = np.arange(len(start.cells) - 50)
    before = figures(start.points, start.cells)
    result = odt_plugins.optimize(
        (start.points, start.cells), blocks=3, density=given, selection=selection
    )
    assert figures(*result)["mean"] > before["mean"] + 0.1


def test_a_density_is_carried_with_the_vertices():
    start = ball(500)
    mesh = simplex_mesh(start.points, start.cells)[0]
    linear = 2.0 + mesh.points @ [0.3, -0.2, 0.5]
    rim = mesh.points[:, 0] > 0.6
    block = Block(replace(mesh, fixed=rim), linear, Options(), -5.0, {}, Within(cut=rim))
    result = improve(block)
    moved = (result.points != mesh.points).any(axis=1)
    assert moved.sum() > 100
    right = 2.0 + result.points @ [0.3, -0.2, 0.5]
    assert np.allclose(result.density, right, rtol=1e-12)
    assert np.array_equal(result.density[~moved], linear[~moved])


@pytest.mark.parametrize("density", ["keep", "uniform"])
def test_finishing_is_tried_alone_where_sizes_are_kept_and_little_may_move(density):
    start = ball(500)
    mesh = simplex_mesh(start.points, start.cells)[0]
    fixed = np.arange(len(mesh.points)) > 2
    values = np.ones(len(mesh.points))
    block = Block(replace(mesh, fixed=fixed), values, Options(density=density), -5.0,
                  versions_here(), Within(cut=fixed))
    assert ("runs of finishing alone" in improve(block).counts) == (density == "keep")


def test_planar_meshes_and_small_ones_work_too(small_blocks):
    start = plate(2000)
    before, after = (odt_plugins.quality(m) for m in (
        (start.points, start.cells),
        odt_plugins.optimize((start.points, start.cells), blocks=3),
    ))
    assert after.mean_quality > before.mean_quality + 0.02
    tiny = ball(60)
    a = odt_plugins.optimize((tiny.points, tiny.cells), blocks=4)
    b = odt_plugins.optimize((tiny.points, tiny.cells))
    assert all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def test_the_curvature_of_flat_meshes_is_refused_in_blocks(small_blocks):
    for start in (plate(400), ball(600)):
        mesh = start.points, start.cells
        with pytest.raises(InvalidOptionError, match="no curved surface"):
            odt_plugins.optimize(mesh, density="curvature", blocks=3)


def test_what_does_not_go_with_blocks_is_refused():
    start = ball(60)
    mesh = (start.points, start.cells)
    for wrong in ({"blocks": 0}, {"blocks": 2.0}, {"blocks": 2, "block_rounds": 0},
                  {"blocks": 2, "workers": -1}, {"workers": 2}, {"client": 1},
                  {"blocks": 2, "rings": 1}, {"target": "out.vtu"},
                  {"blocks": 2, "workers": 2, "density": lambda x: x[:, 0]}):
        with pytest.raises(InvalidOptionError, match="expected"):
            odt_plugins.optimize(mesh, **wrong)


def same_in_any_order(mesh: SimplexMesh, options: Options, blocks: int) -> Any:
    """Outcome of a run in blocks, which must not depend on which block is done first."""
    one, other = (run_blocks(mesh, options, blocks, 3, apply) for apply in (map, backwards))
    for name in ("points", "cells", "regions", "origin"):
        assert np.array_equal(getattr(one, name), getattr(other, name))
    return one


def test_a_boundary_slides_in_blocks(small_blocks):
    mesh = mesh_of(600)
    options = Options(boundary="slide")
    rims: list[Any] = []

    def sees(function: Any, items: Iterable[Block]) -> Iterator[Improved]:
        rims.append(0)
        for block in items:
            result = function(block)
            moved = (result.points != block.mesh.points).any(axis=1)
            rims[-1] += int(moved[boundary_facets(block.mesh.cells)].any(axis=1).sum())
            yield result

    one = optimized(mesh, options, as_it_is)
    outcome = run_blocks(mesh, options, 3, 3, sees)
    assert len(rims) == 3
    assert all(rims)
    assert outcome.fallback is None
    assert 0.0 < max(outcome.slid.forward, outcome.slid.backward) <= outcome.slid.envelope
    assert not broken_promises(mesh, outcome.points, outcome.cells, outcome.regions, slides=True)
    q = [figures(found.points, found.cells)["mean"] for found in (mesh, one, outcome)]
    assert q[2] > q[1] - 0.01 > q[0] + 0.1
    shell = np.zeros(len(mesh.points), dtype=bool)
    shell[boundary_facets(mesh.cells)] = True
    moved = (outcome.points != mesh.points).any(axis=1)
    assert moved[shell].mean() > 0.9


def test_vertices_are_inserted_in_blocks(small_blocks):
    mesh = mesh_of(600)
    n = len(mesh.points)
    outcome = same_in_any_order(mesh, Options(insert=0.02, density="keep"), 3)
    added = int((outcome.origin < 0).sum())
    assert added > 0
    assert len(outcome.points) <= n + 0.02 * n
    assert not broken_promises(mesh, outcome.points, outcome.cells, outcome.regions,
                               origin=outcome.origin, insert=0.02)
    without = run_blocks(mesh, Options(), 3, 3, map)
    assert (figures(outcome.points, outcome.cells)["mean"]
            > figures(without.points, without.cells)["mean"])


def test_a_curved_surface_is_as_good_in_blocks_within_the_same_envelope(small_blocks):
    start = stored("bunny-surface")
    mesh = start.points, start.cells
    one, blocks = (call(mesh, density="curvature") for call in (
        odt_plugins.optimize_with_report,
        partial(odt_plugins.optimize_with_report, blocks=4)))
    report = blocks[1]
    assert report.fallback is None
    assert report.counts["round 2 blocks"] > 0
    assert max(report.surface["forward"], report.surface["backward"]) <= report.surface["envelope"]
    assert report.after.mean_quality == pytest.approx(one[1].after.mean_quality, abs=0.003)
    assert report.after.p1_quality > one[1].after.p1_quality - 0.01
