"""The judge of outputs: meshes broken on purpose in every way are found out."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import Delaunay

from odt_plugins.figures import summarize
from odt_plugins.mesh import facets as facets_module
from odt_plugins.mesh.facets import uneven_facets
from odt_plugins.mesh.simplex import SimplexMesh, simplex_mesh
from odt_plugins.promise import volume as promise
from odt_plugins.promise.locked_facets import LOCAL_FACETS, facet_census, locked_facets
from odt_plugins.promise.volume import broken_promises, held_vertices

SIZE = {2: "area", 3: "volume"}


def grid_mesh(d: int, seed: int = 809) -> SimplexMesh:
    """Delaunay mesh of a jittered grid in the unit box, two regions, some vertices inside."""
    rng = np.random.default_rng(seed)
    side = np.linspace(0.0, 1.0, 6)
    x = np.stack(np.meshgrid(*[side] * d, indexing="ij"), axis=-1).reshape(-1, d)
    inside = ((x > 0) & (x < 1)).all(axis=1)
    x[inside] += rng.uniform(-0.06, 0.06, size=(inside.sum(), d))
    x[~inside] += 1e-9 * rng.uniform(-1, 1, size=((~inside).sum(), d)) * (x[~inside] % 1 > 0)
    cells = Delaunay(x).simplices
    corners = x[cells]
    size = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    cells = cells[size > 1e-4 * np.median(size)]
    regions = (x[cells].mean(axis=1)[:, 0] > 0.5).astype(np.int32)
    return simplex_mesh(x, cells, regions=regions)[0]


@pytest.fixture(params=[2, 3])
def mesh(request: pytest.FixtureRequest) -> SimplexMesh:
    return grid_mesh(request.param)


def sentences(
    mesh: SimplexMesh, points: object = None, cells: object = None, regions: object = None,
    keep: tuple[str, ...] = (),
) -> list[str]:
    return broken_promises(
        mesh,
        mesh.points if points is None else points,
        mesh.cells if cells is None else cells,
        mesh.regions if regions is None else regions,
        keep,
    )


def said(found: list[str], pattern: str) -> bool:
    return any(re.search(pattern, sentence) for sentence in found)


def test_the_mesh_itself_keeps_the_promise(mesh: SimplexMesh) -> None:
    assert sentences(mesh, keep=("min_quality", "mean_quality", "max_angle")) == []


def test_order_of_cells_and_even_permutations_are_free(mesh: SimplexMesh) -> None:
    order = np.random.default_rng(811).permutation(len(mesh.cells))
    cells = mesh.cells[order]
    cells[::2] = cells[::2][:, [1, 2, 0, *range(3, mesh.dim + 1)]]
    assert sentences(mesh, cells=cells, regions=mesh.regions[order],
                     keep=("min_quality", "mean_quality")) == []


def test_a_free_vertex_may_move(mesh: SimplexMesh) -> None:
    v = np.flatnonzero(~held_vertices(mesh))[0]
    points = mesh.points.copy()
    points[v] += 1e-4
    assert sentences(mesh, points) == []


def test_held_vertices_by_a_slow_twin(mesh: SimplexMesh) -> None:
    owners: dict[frozenset[int], list[int]] = {}
    for c, cell in enumerate(mesh.cells.tolist()):
        for v in cell:
            owners.setdefault(frozenset(cell) - {v}, []).append(int(mesh.regions[c]))
    held = {v for facet, labels in owners.items()
            if len(labels) == 1 or labels[0] != labels[1] for v in facet}
    assert set(np.flatnonzero(held_vertices(mesh))) == held


def test_vertices_between_regions_of_one_body_may_move_but_the_facets_stay(
    mesh: SimplexMesh
) -> None:
    one = replace(mesh, body=np.zeros(2, dtype=np.int32))
    v = np.flatnonzero(held_vertices(mesh) & ~held_vertices(one))[0]
    points = mesh.points.copy()
    points[v] += 1e-4
    assert said(sentences(mesh, points), "interface vertex")
    assert sentences(one, points) == []
    assert said(sentences(one, regions=np.zeros_like(mesh.regions)), "interface facet .* is gone")


@pytest.mark.parametrize("words", [1 << 64, 1000, 200])
@pytest.mark.parametrize("d", [2, 3])
def test_the_census_of_any_heap_of_cells_by_a_slow_twin(
    d: int, words: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(facets_module, "WORDS", words)
    rng = np.random.default_rng(827)
    for m in (1, 5, 12, 30):
        cells = np.argsort(rng.random((m, 8)), axis=1)[:, : d + 1].astype(np.int32)
        regions = rng.integers(0, 1 + m % 3, m).astype(np.int32)
        sides: dict[tuple[int, ...], list[tuple[bool, int]]] = {}
        for cell, label in zip(cells.tolist(), regions.tolist(), strict=True):
            for local in LOCAL_FACETS[d + 1]:
                facet = [cell[i] for i in local]
                odd = sum(a > b for i, b in enumerate(facet) for a in facet[:i]) % 2 == 1
                sides.setdefault(tuple(sorted(facet)), []).append((odd, label))
        uneven = uneven_facets(cells, 8, threads=1 + m % 2)
        found = {name: sorted(map(tuple, rows.tolist()))
                 for name, rows in uneven._asdict().items()}
        crowded = sorted(f for f, s in sides.items()
                         for side in (True, False) for _ in [x for x, _ in s if x == side][1:])
        assert set(found["open"]) - set(crowded) == {f for f, s in sides.items() if len(s) == 1}
        assert found["crowded"] == crowded
        locked, overlaps = facet_census(cells, regions, 8, uneven)
        assert sorted(tuple(sorted(f)) for f in overlaps.tolist()) == crowded
        rows = [(tuple(sorted(f)), bool(b))
                for f, b in zip(locked.facets.tolist(), locked.boundary, strict=True)
                if len(sides[tuple(sorted(f))]) <= 2]
        assert sorted(rows) == sorted(
            (f, len(s) == 1) for f, s in sides.items()
            if len(s) == 1 or (len(s) == 2 and s[0][1] != s[1][1]) for _ in s)
        assert np.array_equal(locked.labels, regions[locked.cells])


def test_locked_facets_look_outward(mesh: SimplexMesh) -> None:
    locked = locked_facets(mesh.cells, mesh.regions, len(mesh.points))
    assert (~locked.boundary).sum() % 2 == 0
    assert (~locked.boundary).any()
    for facet, cell in zip(locked.facets, locked.cells, strict=True):
        inner = mesh.points[mesh.cells[cell]].mean(axis=0)
        corner = mesh.points[facet]
        assert np.linalg.det(np.vstack([corner[1:] - corner[0], inner - corner[0]])) * \
            (1 if mesh.dim == 2 else -1) > 0


def test_every_shape_is_checked_first(mesh: SimplexMesh) -> None:
    assert said(sentences(mesh, mesh.points[:-1]), "points have shape")
    assert said(sentences(mesh, cells=mesh.cells[:, 1:]), "cells have shape")
    assert said(sentences(mesh, regions=mesh.regions[1:]), "regions have shape")
    outside = mesh.cells.copy()
    outside[3, 0] = len(mesh.points)
    assert said(sentences(mesh, cells=outside), "cells name vertices")


def test_a_vertex_that_is_not_finite(mesh: SimplexMesh) -> None:
    points = mesh.points.copy()
    points[5, 0] = np.nan
    assert sentences(mesh, points) == ["vertex 5 is not finite, 1 in all"]


def test_an_inverted_cell(mesh: SimplexMesh) -> None:
    v = np.flatnonzero(~held_vertices(mesh))[0]
    points = mesh.points.copy()
    points[v] += 3.0
    assert said(sentences(mesh, points), rf"cell \d+ has {SIZE[mesh.dim]} -")


def test_a_flat_cell_is_not_positive(mesh: SimplexMesh) -> None:
    cells = np.vstack([mesh.cells, np.repeat(mesh.cells[:1, :1], mesh.dim + 1, axis=1)])
    regions = np.append(mesh.regions, mesh.regions[0]).astype(np.int32)
    found = sentences(mesh, cells=cells, regions=regions)
    assert said(found, f"has {SIZE[mesh.dim]} 0, not positive")


@pytest.mark.parametrize("why", ["boundary", "interface", "fixed", "frozen", "unused"])
def test_a_held_vertex_that_moved_by_one_bit(mesh: SimplexMesh, why: str) -> None:
    n = len(mesh.points)
    locked = locked_facets(mesh.cells, mesh.regions, n)
    on_boundary = np.zeros(n, bool)
    on_boundary[locked.facets[locked.boundary]] = True
    free = np.flatnonzero(~held_vertices(mesh))
    v = free[0]
    if why == "boundary":
        v = np.flatnonzero(on_boundary)[0]
    elif why == "interface":
        v = np.setdiff1d(locked.facets[~locked.boundary], np.flatnonzero(on_boundary))[0]
    elif why == "fixed":
        mesh = replace(mesh, fixed=np.arange(n) == v)
    elif why == "frozen":
        mesh = replace(mesh, frozen=(mesh.cells == v).any(axis=1))
    else:
        mesh = replace(mesh, points=np.vstack([mesh.points, np.full(mesh.dim, 0.3)]),
                       fixed=np.append(mesh.fixed, False))
        v = n
    points = mesh.points.copy()
    points[v, 0] = np.nextafter(points[v, 0], 2.0)
    assert said(sentences(mesh, points), f"^{why} vertex {v} moved, 1 in all")


def test_minus_zero_is_not_zero() -> None:
    mesh = grid_mesh(2)
    v = np.flatnonzero(mesh.points[:, 0] == 0)[0]
    points = mesh.points.copy()
    points[v, 0] = -0.0
    assert said(sentences(mesh, points), f"boundary vertex {v} moved")


def test_a_vertex_that_is_dropped(mesh: SimplexMesh) -> None:
    v = int(np.flatnonzero(~held_vertices(mesh))[0])
    rest = (mesh.cells != v).all(axis=1)
    found = sentences(mesh, cells=mesh.cells[rest], regions=mesh.regions[rest])
    assert said(found, f"vertex {v} is no longer used")
    assert said(found, "boundary facet .* is new")
    assert said(found, f"the {SIZE[mesh.dim]} of region")


def test_a_lost_cell_at_the_boundary(mesh: SimplexMesh) -> None:
    locked = locked_facets(mesh.cells, mesh.regions, len(mesh.points))
    lost = locked.cells[locked.boundary][0]
    rest = np.arange(len(mesh.cells)) != lost
    found = sentences(mesh, cells=mesh.cells[rest], regions=mesh.regions[rest])
    assert said(found, "boundary facet .* is gone")


def test_a_cell_that_appears_twice(mesh: SimplexMesh) -> None:
    cells = np.vstack([mesh.cells, mesh.cells[-1:]])
    regions = np.append(mesh.regions, mesh.regions[-1]).astype(np.int32)
    assert said(sentences(mesh, cells=cells, regions=regions),
                rf"two cells on one side, {mesh.dim + 1} such facets")


def test_a_cell_that_changed_its_region(mesh: SimplexMesh) -> None:
    inner = int(np.flatnonzero((~held_vertices(mesh))[mesh.cells].any(axis=1))[0])
    regions = mesh.regions.copy()
    regions[inner] = 1 - regions[inner]
    found = sentences(mesh, regions=regions)
    assert said(found, "interface facet .* is new")
    assert said(found, f"the {SIZE[mesh.dim]} of region 0 went from")


def test_labels_swapped_on_both_sides_of_an_interface(mesh: SimplexMesh) -> None:
    assert said(sentences(mesh, regions=(1 - mesh.regions).astype(np.int32)),
                "interface facet .* is gone")


def test_a_flip_is_allowed_but_not_of_a_frozen_cell_nor_across_regions() -> None:
    square = np.array([[0.0, 0], [1, 0], [1, 1.1], [0, 1]])
    old, new = np.array([[0, 1, 2], [0, 2, 3]]), np.array([[0, 1, 3], [1, 2, 3]])
    mesh = simplex_mesh(square, old)[0]
    cells, none = new.astype(np.int32), np.zeros(2, np.int32)
    assert sentences(mesh, cells=cells, regions=none) == []
    frozen = replace(mesh, frozen=np.array([True, False]))
    assert sentences(frozen, cells=cells, regions=none) == ["frozen cell 0 is gone, 1 in all"]
    two = replace(mesh, regions=np.array([0, 1], np.int32))
    assert said(sentences(two, cells=cells, regions=two.regions), r"facet \(0, 2\) is gone")


def test_a_figure_that_got_worse_and_only_if_it_was_named(mesh: SimplexMesh) -> None:
    free = ~held_vertices(mesh)
    points = mesh.points.copy()
    points[free] += np.random.default_rng(821).uniform(-0.006, 0.006, (free.sum(), mesh.dim))
    old, new = summarize(mesh.points, mesh.cells), summarize(points, mesh.cells)
    assert new.inverted == 0
    for name, verb, worse in (
        ("min_quality", "fell", new.min_quality < old.min_quality),
        ("p1_quality", "fell", new.p1_quality < old.p1_quality),
        ("mean_quality", "fell", new.mean_quality < old.mean_quality),
        ("min_angle", "fell", new.min_angle < old.min_angle),
        ("max_angle", "rose", new.max_angle > old.max_angle),
    ):
        sentence = f"{name} {verb} from {getattr(old, name):.6g} to {getattr(new, name):.6g}"
        assert sentences(mesh, points, keep=(name,)) == ([sentence] if worse else [])
    assert any((new.min_quality < old.min_quality, new.mean_quality < old.mean_quality))


def test_the_slack_is_rounding_and_no_more() -> None:
    old = summarize(grid_mesh(2).points, grid_mesh(2).cells)
    for factor, holds in ((1 - 1e-13, True), (1 - 1e-11, False), (1.1, True)):
        new = replace(old, min_quality=old.min_quality * factor)
        assert (promise.worse_figures(old, new) == []) is holds
    assert promise.worse_figures(old, replace(old, mean_quality=float("nan"))) != []


def test_figures_that_hardly_differ_have_digits_enough_to_tell_them_apart() -> None:
    old = replace(summarize(grid_mesh(2).points, grid_mesh(2).cells), min_angle=16.3979)
    for angle, told in ((16.39, "16.39"), (16.3979 - 3e-7, "16.3978997"), (16.3979 - 2e-10, None)):
        [said] = promise.worse_figures(old, replace(old, min_angle=angle), ["min_angle"])
        first, last = said.removeprefix("min_angle fell from ").split(" to ")
        assert float(first) > float(last)
        assert told in (None, last)


def test_facet_keys_beyond_64_bits(mesh: SimplexMesh, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(facets_module, "WORDS", 1000)
    assert sentences(mesh) == []
    rest = np.arange(len(mesh.cells)) != 7
    assert sentences(mesh, cells=mesh.cells[rest], regions=mesh.regions[rest]) != []
    flagged = replace(mesh, frozen=np.arange(len(mesh.cells)) % 3 == 0)
    assert sentences(flagged) == []


# Vertices that come and go: the same judge with the origin of every vertex.


def with_a_vertex(mesh: SimplexMesh, c: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Put a vertex into the middle of a cell: points, cells, regions."""
    n = len(mesh.points)
    new = [np.where(mesh.cells[c] == v, n, mesh.cells[c]) for v in mesh.cells[c]]
    points = np.vstack([mesh.points, mesh.points[mesh.cells[c]].mean(axis=0)])
    cells = np.vstack([np.delete(mesh.cells, c, axis=0), new]).astype(np.int32)
    regions = np.append(np.delete(mesh.regions, c), [mesh.regions[c]] * len(new)).astype(np.int32)
    return points, cells, regions


def judged(mesh: SimplexMesh, points: object, cells: object, regions: object,
           origin: object, **allowed: float) -> list[str]:
    return broken_promises(
        mesh, points, cells, regions, (), origin=np.asarray(origin), **allowed)


@pytest.mark.parametrize(("insert", "most"), [(0.1, 21), (True, 108)])
def test_added_vertices_are_allowed_up_to_a_share(insert: bool | float, most: int) -> None:
    mesh = grid_mesh(3)
    n = len(mesh.points)
    now, origin = mesh, list(range(n))
    for count in range(1, most + 2):
        points, cells, regions = with_a_vertex(now, 0)
        now = replace(now, points=points, cells=cells, regions=regions,
                      fixed=np.zeros(len(points), bool), anchored=np.zeros(len(points), bool),
                      frozen=np.zeros(len(cells), bool))
        origin.append(-1)
        found = judged(mesh, points, cells, regions, origin, insert=insert)
        if count <= most:
            assert found == []
    assert found == [f"{n + count} vertices are used, {n} were; expected at most {n + most}"]
    assert said(sentences(mesh, points, cells, regions), "points have shape")


def removed_again(mesh: SimplexMesh) -> tuple[SimplexMesh, int]:
    """A mesh with a vertex, not the last one, in the middle of a cell, and the mesh without it."""
    points, cells, regions = with_a_vertex(mesh, 5)
    n = len(points) - 1
    swap = np.arange(n + 1, dtype=np.int32)
    swap[[3, n]] = n, 3
    before, _ = simplex_mesh(points[swap], swap[cells], regions=regions)
    return before, 3


def test_a_free_vertex_may_be_removed_and_no_other() -> None:
    mesh = grid_mesh(3)
    before, v = removed_again(mesh)
    n = len(before.points)
    origin = np.delete(np.arange(n), v)
    points = before.points[origin]
    old = np.where(np.arange(n) == n - 1, v, np.arange(n))
    number = np.searchsorted(origin, np.where(old == v, n - 1, old))
    cells = number[mesh.cells].astype(np.int32)
    assert judged(before, points, cells, mesh.regions, origin) == []
    for name in ("fixed", "anchored"):
        marked = np.arange(n) == v
        assert said(judged(replace(before, **{name: marked}), points, cells, mesh.regions, origin),
                    f"{name} vertex {v} was removed, 1 in all")
    frozen = (before.cells == v).any(axis=1)
    found = judged(replace(before, frozen=frozen), points, cells, mesh.regions, origin)
    assert said(found, f"frozen vertex {v} was removed")
    assert said(found, "frozen cell .* is gone, 4 in all")
    corner = int(before.cells[0][held_vertices(before)[before.cells[0]]][0])
    wrong = np.delete(np.arange(n), corner)
    found = judged(before, before.points[wrong], np.minimum(before.cells, n - 2), before.regions,
                   wrong)
    assert said(found, rf"(boundary|interface) vertex {corner} was removed")


def test_an_unused_vertex_stays_and_an_added_one_is_used() -> None:
    mesh = grid_mesh(3)
    n = len(mesh.points)
    padded, _ = simplex_mesh(np.vstack([mesh.points, [[5.0, 5.0, 5.0]]]), mesh.cells,
                             regions=mesh.regions)
    assert said(judged(padded, mesh.points, mesh.cells, mesh.regions, np.arange(n)),
                f"unused vertex {n} was removed")
    found = judged(mesh, padded.points, mesh.cells, mesh.regions, np.append(np.arange(n), -1))
    assert found == [f"added vertex {n} is not used, 1 in all"]


def test_held_vertices_are_compared_in_their_old_numbers() -> None:
    before, v = removed_again(grid_mesh(3))
    n = len(before.points)
    origin = np.append(np.delete(np.arange(n), v), -1)
    points = np.vstack([before.points[origin[:-1]], before.points[v]])
    number = np.empty(n, dtype=np.int32)
    number[origin[:-1]] = np.arange(n - 1)
    number[v] = n - 1
    cells = number[before.cells]
    assert judged(before, points, cells, before.regions, origin) == []
    held = np.flatnonzero(held_vertices(before))
    points[number[held[-1]], 0] = np.nextafter(points[number[held[-1]], 0], np.inf)
    assert said(judged(before, points, cells, before.regions, origin),
                rf"(boundary|interface) vertex {held[-1]} moved, 1 in all")


@pytest.mark.parametrize("origin", ["short", "order", "range", "mixed"])
def test_malformed_origins_are_told(origin: str) -> None:
    mesh = grid_mesh(3)
    n = len(mesh.points)
    wrong = {"short": np.arange(n - 1), "order": np.r_[1, 0, 2:n], "range": np.arange(1, n + 1),
             "mixed": np.r_[0, -1, 2:n]}[origin]
    assert judged(mesh, mesh.points, mesh.cells, mesh.regions, wrong) == [
        f"the origin of {n} vertices names no vertices in their order"]
