"""Stars, adjacency, boundary, colours: integers against loops."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
import pytest
import reference as ref
from hypothesis import given
from hypothesis import strategies as st
from strategies import SEEDS, jittered, lattice, meshes

from odt_plugins.engine.cells.geometry import boundary_facets, boundary_vertices
from odt_plugins.engine.topology import coloring
from odt_plugins.engine.topology.adjacency import cell_neighbors
from odt_plugins.engine.topology.order import by_lowest_vertex, curve_order
from odt_plugins.engine.topology.star import star_average, star_sum, vertex_neighbors, vertex_stars
from odt_plugins.engine.topology.stencil import make_topology
from odt_plugins.errors import InvalidMeshError


def shuffled(mesh, seed):
    """The same cells in another order, with their corners and the vertices renamed."""
    points, cells = mesh
    rng = np.random.default_rng(seed)
    names = rng.permutation(len(points)).astype(np.int32)
    cells = names[cells][rng.permutation(len(cells))]
    renamed = np.empty_like(points)
    renamed[names] = points
    return renamed, np.ascontiguousarray(np.roll(cells, int(rng.integers(3)), axis=1))


def with_gaps(cells, seed):
    """The cells with free slots among them, which keep old numbers behind their -1."""
    places = np.random.default_rng(seed).integers(0, len(cells) + 1, 5)
    free = np.full((5, cells.shape[1]), 1, dtype=np.int32)
    free[:, 0] = -1
    return np.insert(cells, places, free, axis=0)


@given(meshes(), SEEDS)
def test_stars_and_neighbors_equal_the_loops(mesh, seed):
    points, cells = shuffled(mesh, seed)
    stars = vertex_stars(cells, len(points) + 1)
    rows = vertex_neighbors(cells, stars)
    for i in range(len(points)):
        mine = ref.star(cells, i)
        assert stars.indices[stars.indptr[i] : stars.indptr[i + 1]].tolist() == mine
        near = rows.indices[rows.indptr[i] : rows.indptr[i + 1]]
        assert sorted(near) == sorted(set(cells[mine].ravel()) - {i})
    assert stars.indptr[-1] == stars.indptr[-2] == cells.size


@given(meshes(), SEEDS)
def test_stars_do_not_depend_on_the_threads_and_leave_free_slots_out(mesh, seed):
    points, cells = shuffled(mesh, seed)
    cells = cells.copy()
    cells[np.random.default_rng(seed).random(len(cells)) < 0.2, 0] = -1
    with ThreadPoolExecutor(2) as pool:
        shared = vertex_stars(cells, len(points), pool)
    alone = vertex_stars(cells, len(points))
    live = np.flatnonzero(cells[:, 0] >= 0)
    expected = [c for i in range(len(points)) for c in live if i in cells[c]]
    assert shared.indptr.tolist() == alone.indptr.tolist()
    for stars in (shared, alone):
        assert stars.indices[: stars.indptr[-1]].tolist() == expected


@given(meshes(), SEEDS)
def test_cells_across_facets_equal_the_loop(mesh, seed):
    _, cells = shuffled(mesh, seed)
    table = ref.facets(cells)
    neighbors = cell_neighbors(cells)
    with ThreadPoolExecutor(2) as pool:
        assert np.array_equal(neighbors, cell_neighbors(cells, pool=pool))
    for c, cell in enumerate(cells):
        for opposite in range(len(cell)):
            both = table[frozenset(np.delete(cell, opposite).tolist())]
            other = [b for b in both if b != c]
            assert neighbors[c, opposite] == (other[0] if other else -1)


def test_three_cells_on_a_facet_are_refused(d):
    _, cells = lattice(d, 2)
    doubled = np.concatenate([cells, cells[3:4]])
    with pytest.raises(InvalidMeshError, match="third cell"):
        cell_neighbors(doubled)
    assert cell_neighbors(np.empty((0, d + 1), dtype=np.int32)).shape == (0, d + 1)
    fan = np.array([[0, 1, k] if d == 2 else [0, 1, 2, k] for k in (5, 6, 7)], dtype=np.int32)
    with pytest.raises(InvalidMeshError, match="third cell"):
        cell_neighbors(fan)


@given(meshes(), SEEDS)
def test_boundary_facets_face_outwards(mesh, seed):
    points, cells = mesh
    table = ref.facets(cells)
    single = {facet for facet, both in table.items() if len(both) == 1}
    facets = boundary_facets(cells)
    assert {frozenset(f.tolist()) for f in facets} == single
    assert len(facets) == len(single)
    for facet in facets[::3]:
        (c,) = table[frozenset(facet.tolist())]
        (inside,) = set(cells[c].tolist()) - set(facet.tolist())
        assert ref.volume(points[[*facet, inside]]) * (-1) ** points.shape[1] > 0.0


def test_boundary_volume_by_the_divergence_theorem(d):
    points, cells = lattice(d, 3)
    apex = np.full(d, 0.37)
    pieces = [ref.volume(np.concatenate([[apex], points[f]])) for f in boundary_facets(cells)]
    assert min(pieces) > 0.0
    assert sum(pieces) == pytest.approx(1.0, rel=1e-13)


@given(meshes(), st.integers(1, 3), SEEDS)
def test_boundary_and_interface_vertices(mesh, labels, seed):
    points, cells = mesh
    regions = np.random.default_rng(seed).integers(0, labels, len(cells)).astype(np.int32)
    expected = np.zeros(len(points) + 2, dtype=bool)
    for facet, both in ref.facets(cells).items():
        if len(both) == 1 or regions[both[0]] != regions[both[1]]:
            expected[list(facet)] = True
    assert np.array_equal(boundary_vertices(cells, len(points) + 2, regions), expected)
    neighbors = cell_neighbors(cells)
    assert np.array_equal(boundary_vertices(cells, len(points) + 2, regions, neighbors), expected)


@given(meshes(), SEEDS)
def test_no_cell_has_vertices_in_two_blocks_of_one_color(mesh, seed):
    points, cells = shuffled(mesh, seed)
    movable = np.random.default_rng(seed).random(len(points)) < 0.7
    bits = seed % 4
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(coloring, "ONE_BLOCK", 0)
        patch.setattr(coloring, "SMALLEST_BITS", bits)
        patch.setattr(coloring, "MOST_BLOCKS", len(points) + 1)
        found = coloring.vertex_coloring(cells, movable)
        touch = coloring.touching_blocks(with_gaps(cells, seed), movable)
        again = coloring.vertex_coloring(cells, movable, touch)
    assert all(np.array_equal(a, b) for a, b in zip(found, again, strict=True))
    pairs = {(a >> bits, b >> bits) for cell in cells for a in cell for b in cell
             if movable[a] and movable[b] and a >> bits > b >> bits}
    assert {(a, b) for a, b in np.argwhere(touch[:-1]).tolist() if a > b} == pairs
    assert sorted(found.order) == np.flatnonzero(movable).tolist()
    blocks = [found.order[a:b] for a, b in pairwise(found.blocks)]
    assert all(len(b) and np.all(np.diff(b) > 0) and b[0] >> bits == b[-1] >> bits for b in blocks)
    block, color = np.full(len(points), -1), np.full(len(points), -1)
    for i, mine in enumerate(blocks):
        block[mine] = i
    for c, (first, last) in enumerate(pairwise(found.offsets)):
        color[np.isin(block, np.arange(first, last))] = c
    assert np.array_equal(color >= 0, movable)
    assert sorted(map(tuple, found.links.tolist())) == sorted(
        {(a, b) for cell in cells for a in block[cell] for b in block[cell] if 0 <= a < b})
    for cell in cells:
        mine = cell[movable[cell]]
        assert len(set(color[mine])) == len(set(block[mine]))


@given(meshes(), SEEDS)
def test_cells_are_sorted_by_their_lowest_vertex(mesh, seed):
    points, cells = shuffled(mesh, seed)
    slots = with_gaps(cells, seed)
    live = np.flatnonzero(slots[:, 0] >= 0)
    expected = live[np.argsort(slots[live].min(axis=1), kind="stable")]
    assert np.array_equal(by_lowest_vertex(slots, len(points)), expected)
    vertices, order = curve_order(points, cells)
    place = np.argsort(vertices)
    assert sorted(order) == list(range(len(cells)))
    assert np.all(np.diff(place[cells[order]].min(axis=1)) >= 0)


def test_topology_leaves_vertices_without_cells_alone(d):
    points, cells = jittered(d, 3, 1)
    near = np.append(boundary_vertices(cells, len(points)), False)
    topology = make_topology(cells, ~near, near)
    assert not topology.movable[-1]
    assert topology.movable.sum() == (~near).sum() - 1
    nothing = make_topology(cells, np.zeros_like(near), near)
    assert nothing.coloring.order.size == 0
    assert topology.largest_star == max(len(ref.star(cells, i)) for i in range(len(points)))


def test_star_averages_by_hand(d):
    points, cells = jittered(d, 2, 2)
    rng = np.random.default_rng(3)
    values, weights = rng.normal(size=(len(cells), d)), rng.uniform(1, 2, len(cells))
    average = star_average(values, weights, cells, len(points))
    sums = star_sum(weights, cells, len(points) + 1)
    for i in range(len(points)):
        mine = ref.star(cells, i)
        assert sums[i] == pytest.approx(weights[mine].sum())
        assert average[i] == pytest.approx(weights[mine] @ values[mine] / weights[mine].sum())
    assert sums[-1] == 0.0
    with pytest.raises(InvalidMeshError, match=rf"index {len(points)} \(2 of them\)"):
        star_average(values, weights, cells, len(points) + 2)
