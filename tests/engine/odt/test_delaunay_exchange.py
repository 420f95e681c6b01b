"""Exchange with scipy's Delaunay triangulation: mathematics, twin, and what must stay."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import reference_flips as ref
from hypothesis import given, settings
from hypothesis import strategies as st
from planar_meshes import jittered_grid
from reference import cell_figures
from scipy.spatial import ConvexHull, Delaunay, QhullError

from odt_plugins.engine.cells.extremes import FREELY, Bounds, Extremes
from odt_plugins.engine.odt import delaunay
from odt_plugins.engine.odt.delaunay import delaunay_exchange, non_delaunay_facets
from odt_plugins.engine.odt.rounds import Log, exchange
from odt_plugins.engine.topology.complex import make_complex

REFUSALS = ("missing_facet", "several_regions", "hidden_vertex", "flat", "volume",
            "energy", "guard")


def rows(cells):
    return sorted(tuple(sorted(c)) for c in np.asarray(cells).tolist())


def positive(points, cells):
    cells = np.array(cells, dtype=np.int32)
    for c in cells:
        if ref.volume(points, c) < 0:
            c[:2] = c[1::-1].copy()
    return cells


def convex_mesh(dim, seed, count=25):
    """Points whose hull has no flat part, with a connectivity far from Delaunay."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, dim))
    best = positive(points, Delaunay(points).simplices)
    return points, best, ref.random_flips(points, best, rng, 60)


def holed_mesh(dim, seed):
    """Non-convex jittered grid with holes."""
    rng = np.random.default_rng(seed)
    if dim == 2:
        points, cells, _ = jittered_grid(9, 8, rng, 0.24, holes={(3, 3), (3, 4), (8, 7), (0, 5)})
        return points, cells
    points, cells = ref.tet_grid((4, 3, 3), rng, 0.2, holes={(1, 1, 1), (3, 2, 2), (0, 0, 1)})
    return points, ref.random_flips(points, cells, rng, 40)


def regions_of(points, cells, kind):
    if kind == "one":
        return np.full(len(cells), 7, dtype=np.int32)
    return (points[cells].mean(axis=1)[:, 0] > 1.5).astype(np.int32) * 5


def check_kept(points, cells, regions, new_cells, new_regions):
    """Everything that an exchange promises, by brute force."""
    assert all(ref.volume(points, c) > 0 for c in new_cells)
    assert max(map(len, ref.facet_owners(new_cells).values())) <= 2
    assert ref.kept_facets(new_cells, new_regions) >= ref.kept_facets(cells, regions)
    assert set(np.unique(new_cells)) == set(np.unique(cells))
    for label in np.unique(regions):
        here = sum(ref.volume(points, c) for c in cells[regions == label])
        there = sum(ref.volume(points, c) for c in new_cells[new_regions == label])
        assert there == pytest.approx(here, rel=1e-12)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_delaunay_minimises_the_energy_over_connectivities(dim, seed):
    points, best, other = convex_mesh(dim, seed)
    assert rows(best) != rows(other)
    assert ref.total_energy(points, best) < ref.total_energy(points, other)
    new, _, _ = delaunay_exchange(points, other, np.zeros(len(other), dtype=np.int32))
    assert ref.total_energy(points, new) == pytest.approx(ref.total_energy(points, best))
    rng = np.random.default_rng(seed + 100)
    inside = np.einsum("kj,kjd->kd", rng.dirichlet(np.ones(dim + 1), 300),
                       points[other[rng.integers(len(other), size=300)]])
    low, high = (ref.interpolated(points, c, inside) for c in (new, other))
    assert (low <= high + 1e-12).all()
    assert (low < high - 1e-6).any()
    assert (low >= (inside**2).sum(axis=1) - 1e-12).all()


@pytest.mark.parametrize("dim", [2, 3])
def test_lifting_gives_delaunay(dim):
    points, _, other = convex_mesh(dim, 8)
    lifted = np.c_[points, (points**2).sum(axis=1)]
    hull = ConvexHull(lifted)
    lower = hull.simplices[hull.equations[:, dim] < 0]
    new, _, stats = delaunay_exchange(points, other, np.zeros(len(other), dtype=np.int32))
    assert stats.exchanged > 0
    assert rows(new) == rows(lower)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kind", ["one", "two"])
@pytest.mark.parametrize("guard", [None, (0.3, 0.0, 180.0), (0.0, 60.0, 180.0), (0.0, 0.0, 75.0)])
def test_equals_slow_twin(dim, kind, guard):
    points, cells = holed_mesh(dim, 21)
    regions = regions_of(points, cells, kind)
    fixed = ref.kept_vertices(cells, regions, len(points)) if guard else None
    limit = guard or (0.0, 0.0, 180.0)
    if guard:
        fixed |= np.random.default_rng(1).random(len(points)) < 0.6
    new, labels, stats = delaunay_exchange(
        points, cells, regions, fixed,
        limit=Extremes(limit[0], *np.cos(np.radians(limit[1:]))))
    used = np.unique(cells)
    low, high = points[used].min(axis=0), points[used].max(axis=0)
    simplices = used[Delaunay((points[used] - 0.5 * (low + high)) / (high - low).max()).simplices]
    twin, twin_labels, count = ref.exchange(points, cells, regions, simplices, fixed, limit)
    assert stats.exchanged == count > 0
    assert (stats.guard > 0) == bool(guard)
    ours = sorted((tuple(sorted(c)), r) for c, r in zip(new.tolist(), labels.tolist(), strict=True))
    theirs = sorted((tuple(sorted(c)), r) for c, r in zip(twin, twin_labels, strict=True))
    assert ours == theirs
    check_kept(points, cells, regions, new, labels)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), dim=st.sampled_from([2, 3]),
       kind=st.sampled_from(["one", "two"]))
def test_domain_regions_and_vertices_stay(seed, dim, kind):
    points, cells = holed_mesh(dim, seed)
    regions = regions_of(points, cells, kind)
    new, labels, stats = delaunay_exchange(points, cells, regions)
    check_kept(points, cells, regions, new, labels)
    assert stats.pieces == stats.unchanged + stats.exchanged + sum(
        getattr(stats, name) for name in REFUSALS)
    before, after = ref.total_energy(points, cells), ref.total_energy(points, new)
    assert (after < before) == (stats.exchanged > 0)
    again = delaunay_exchange(points, new, labels)
    assert again[2].exchanged == 0
    np.testing.assert_array_equal(again[0], new)


@pytest.mark.parametrize("dim", [2, 3])
def test_delaunay_mesh_is_left_as_it_is(dim):
    points, best, _ = convex_mesh(dim, 13)
    regions = np.arange(len(best), dtype=np.int32) % 3
    new, labels, stats = delaunay_exchange(points, best, regions)
    np.testing.assert_array_equal(new, best)
    np.testing.assert_array_equal(labels, regions)
    assert stats.unchanged == stats.pieces == len(best)


@pytest.mark.parametrize("dim", [2, 3])
def test_cospherical_ties_are_left_alone(dim):
    rng = np.random.default_rng(3)
    if dim == 2:
        points, cells, _ = jittered_grid(5, 5, rng, 0.0)
    else:
        points, cells = ref.tet_grid((3, 3, 3), rng, 0.0)
    new, _, stats = delaunay_exchange(points, cells, np.zeros(len(cells), dtype=np.int32))
    np.testing.assert_array_equal(new, cells)
    assert stats.exchanged == 0


@pytest.mark.parametrize("dim", [2, 3])
def test_scale_and_translation_do_not_matter(dim):
    points, cells = holed_mesh(dim, 33)
    points = np.round(points * 2.0**20) / 2.0**20
    regions = regions_of(points, cells, "two")
    expected, _, _ = delaunay_exchange(points, cells, regions)
    for other in (points * 2.0**-40, points * 2.0**30, points + 2.0**20):
        np.testing.assert_array_equal(delaunay_exchange(other, cells, regions)[0], expected)


@pytest.mark.parametrize("dim", [2, 3])
def test_guard_with_every_vertex_fixed_keeps_the_worst_cell(dim):
    refused = 0
    for seed in range(6):
        points, cells = holed_mesh(dim, seed)
        regions = np.zeros(len(cells), dtype=np.int32)
        free, _, _ = delaunay_exchange(points, cells, regions)
        new, _, stats = delaunay_exchange(points, cells, regions, np.ones(len(points), dtype=bool))
        refused += stats.guard
        worst = [min(ref.radius_ratio(points, c) for c in mesh) for mesh in (cells, new, free)]
        assert worst[1] >= worst[0]
    if dim == 3:
        assert refused > 0


def test_guard_holds_to_every_limit_where_no_cell_was_stuck_before():
    # two tetrahedra on one facet against three around the edge from top to bottom
    points = np.array([[1.0, 0, 0], [-0.5, 0.8, 0], [-0.5, -0.9, 0], [0, 0, 0.4], [0, 0.1, -0.45]])
    cells = positive(points, [[0, 1, 2, 3], [0, 1, 2, 4]])
    fixed = np.array([False, True, True, True, True])
    regions = np.zeros(2, dtype=np.int32)
    found = cell_figures(points, np.array([[1, 2, 3, 4]]))
    quality, large, small = found[0][0], *np.cos(np.radians([found[1][0], found[2][0]]))
    for name, value, easier in (("quality", quality, -1e-6), ("large", large, 1e-6),
                                ("small", small, -1e-6)):
        low, _, stats = delaunay_exchange(
            points, cells, regions, fixed, limit=FREELY._replace(**{name: value + easier}))
        assert (len(low), stats.exchanged) == (3, 1)
        high, _, stats = delaunay_exchange(
            points, cells, regions, fixed, limit=FREELY._replace(**{name: value - easier}))
        assert (len(high), stats.guard) == (2, 1)


def test_a_round_holds_the_exchange_to_the_bounds_of_locked_cells():
    points = np.array([[1.0, 0, 0], [-0.5, 0.8, 0], [-0.5, -0.9, 0], [0, 0, 0.4], [0, 0.1, -0.45]])
    cells = positive(points, [[0, 1, 2, 3], [0, 1, 2, 4]])
    locked = np.array([False, True, True, True, True])
    _, least, _ = cell_figures(points, np.array([[1, 2, 3, 4]]))
    for easier, count in ((1e-6, 3), (-1e-6, 2)):
        mesh = make_complex(points, cells, np.zeros(2, dtype=np.int32), locked, locked)
        large = np.cos(np.radians(least[0])) + easier
        bounds = Bounds(FREELY, FREELY._replace(large=float(large)))
        assert exchange(mesh, bounds, Log()).count() == count


def test_piece_of_two_regions_stays():
    points = np.array([[1.0, 0, 0], [-0.5, 0.8, 0], [-0.5, -0.9, 0], [0, 0, 0.4], [0, 0.1, -0.45]])
    cells = positive(points, [[0, 1, 2, 3], [0, 1, 2, 4]])
    assert len(delaunay_exchange(points, cells, np.array([4, 4], dtype=np.int32))[0]) == 3
    new, labels, stats = delaunay_exchange(points, cells, np.array([4, 5], dtype=np.int32))
    np.testing.assert_array_equal(new, cells)
    np.testing.assert_array_equal(labels, [4, 5])
    assert stats.several_regions == 1


@pytest.mark.parametrize("dim", [2, 3])
def test_vertex_that_qhull_hides_keeps_its_cells(dim, monkeypatch):
    points, cells = holed_mesh(dim, 3)
    regions = regions_of(points, cells, "one")
    kept = ref.kept_vertices(cells, regions, len(points))
    hidden = 0
    for lost in np.flatnonzero(~kept[np.unique(cells)]):

        def hiding(x, lost=lost):
            rest = np.delete(np.arange(len(x)), lost)
            return SimpleNamespace(simplices=rest[Delaunay(x[rest]).simplices])

        monkeypatch.setattr("scipy.spatial.Delaunay", hiding)
        new, labels, stats = delaunay_exchange(points, cells, regions)
        check_kept(points, cells, regions, new, labels)
        hidden += stats.hidden_vertex
    assert hidden > 0


@pytest.mark.parametrize("dim", [2, 3])
def test_unused_vertices_stay_unused(dim):
    points, cells = holed_mesh(dim, 5)
    regions = regions_of(points, cells, "one")
    expected, _, _ = delaunay_exchange(points, cells, regions)
    extra = points[np.unique(cells)[:40]] + 0.31
    more = np.concatenate([extra, points])
    new, _, _ = delaunay_exchange(more, cells + np.int32(len(extra)), regions)
    np.testing.assert_array_equal(new - len(extra), expected)


def test_slit_with_doubled_vertices_stays_open():
    rng = np.random.default_rng(9)
    points, cells, _ = jittered_grid(8, 8, rng, 0.24)
    slit = [4 * 9 + j for j in range(2, 7)]
    points[slit] = [[4.0, j] for j in range(2, 7)]
    twin = {v: len(points) + k for k, v in enumerate(slit[1:-1])}
    points = np.vstack([points, points[slit[1:-1]]])
    right = points[cells].mean(axis=1)[:, 0] > 4.0
    for t in np.flatnonzero(right):
        cells[t] = [twin.get(v, v) for v in cells[t].tolist()]
    cells = positive(points, cells)
    regions = np.zeros(len(cells), dtype=np.int32)
    new, labels, stats = delaunay_exchange(points, cells, regions)
    check_kept(points, cells, regions, new, labels)
    assert stats.missing_facet > 0
    assert stats.exchanged > 0


@pytest.mark.parametrize("error", [QhullError("QH6154 initial simplex is flat\nmore"),
                                   ValueError("")])
def test_qhull_failure_leaves_the_mesh(monkeypatch, error):
    def fail(*_):
        raise error

    monkeypatch.setattr("scipy.spatial.Delaunay", fail)
    points, cells = holed_mesh(2, 1)
    regions = regions_of(points, cells, "two")
    new, labels, stats = delaunay_exchange(points, cells, regions)
    np.testing.assert_array_equal(new, cells)
    np.testing.assert_array_equal(labels, regions)
    assert stats.failure in ("QH6154 initial simplex is flat", "ValueError")
    assert new is not cells


@pytest.mark.parametrize("dim", [2, 3])
def test_one_cell(dim):
    points = np.vstack([np.zeros(dim), np.eye(dim)])
    cells = positive(points, [list(range(dim + 1))])
    new, _, stats = delaunay_exchange(points, cells, np.zeros(1, dtype=np.int32))
    np.testing.assert_array_equal(new, cells)
    assert (stats.pieces, stats.unchanged) == (1, 1)


@pytest.mark.parametrize("dim", [2, 3])
def test_inputs_unchanged_and_types(dim):
    points, cells = holed_mesh(dim, 6)
    regions = regions_of(points, cells, "two")
    copies = points.copy(), cells.copy(), regions.copy()
    new, labels, _ = delaunay_exchange(points, cells, regions)
    for a, b in zip((points, cells, regions), copies, strict=True):
        np.testing.assert_array_equal(a, b)
    assert new.dtype == labels.dtype == np.int32
    assert new.flags.c_contiguous


@pytest.mark.parametrize("dim", [2, 3])
def test_non_delaunay_facets_against_exact_arithmetic(dim):
    points, cells = holed_mesh(dim, 17)
    neighbors = ref.brute_neighbors(cells)
    expected = set()
    for facet, own in ref.facet_owners(cells).items():
        if len(own) == 2:
            (far,) = set(cells[own[1]].tolist()) - set(facet)
            if ref.in_sphere(points, cells[own[0]], points[far]) > 0:
                expected.add(facet)
    found = non_delaunay_facets(points, cells, neighbors)
    facets = {tuple(sorted(np.delete(cells[t], i).tolist())) for t, i in found.tolist()}
    assert facets == expected
    assert len(found) == len(expected) > 0
    assert len(non_delaunay_facets(points, cells, neighbors)) > 0
    points, best, _ = convex_mesh(dim, 1)
    assert len(non_delaunay_facets(points, best, ref.brute_neighbors(best))) == 0


def test_piece_with_an_open_facet_or_two_counterparts_has_no_match():
    # an annulus whose inner edges the other mesh lacks: 0 1 2 outside, 3 4 5 inside
    ring = np.array([[0, 1, 3], [1, 4, 3], [1, 2, 4], [2, 5, 4], [2, 0, 5], [0, 3, 5]])
    fan = np.array([[0, 1, 6], [1, 2, 6], [2, 0, 6]])
    inner = np.array([[4, 3, 7], [5, 4, 7], [3, 5, 7]])
    for old, new in ((ring, fan), (fan, ring), (ring, np.vstack([fan, inner])),
                     (np.vstack([fan, inner]), ring)):
        assert (delaunay._matching_pieces(old, new, 8)[2] == -1).all()
    whole = np.vstack([ring, [[3, 4, 5]]])
    piece, _, partner = delaunay._matching_pieces(whole, fan, 8)
    assert (piece == 0).all()
    np.testing.assert_array_equal(partner, [0])
