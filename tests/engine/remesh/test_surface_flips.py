"""Edges of the surface flip with the tetrahedra beside them: a mesh stays one, within the rules."""

import numpy as np
import pytest
from crossings import crossing_pairs
from hypothesis import given, settings
from hypothesis import strategies as st
from tet_meshes import ball, shelled

import odt_plugins
import odt_plugins.engine.remesh.run as remesh_run
from odt_plugins.engine.cells.extremes import FREELY as EVERYTHING
from odt_plugins.engine.remesh.body import FREELY, STAYS
from odt_plugins.engine.remesh.flip import flip_patches
from odt_plugins.engine.remesh.lay_out import lay_out
from odt_plugins.engine.remesh.sizes import unique_edges
from odt_plugins.engine.run.work import make_start
from odt_plugins.mesh.simplex import SimplexMesh

A, B, C, D = range(4)
BELOW, ABOVE = 8, 9
PLATE = np.array([[0, 0, 0], [4, 0, 0], [2, 0.5, 0], [2, -0.5, 0], [-4, -5, 0], [8, -5, 0],
                  [8, 5, 0], [-4, 5, 0], [2, 0, -4], [2, 0, 4.0]])
"""Ends of a long edge in z = 0, corners of the two triangles on it, a square, apices."""

AROUND = np.array([[A, D, 4], [D, 5, 4], [D, B, 5], [B, 6, 5], [B, C, 6], [C, 7, 6], [C, A, 7],
                   [A, 4, 7]])


def flipped(points, cells, regions=None, *, edges=None, reach=1.0, hold=(), lines=()):
    """Flip edges of a mesh, all of them if not given: points, cells, their regions, how many."""
    points, cells = np.asarray(points, dtype=float), np.asarray(cells, dtype=np.int32)
    regions = np.zeros(len(cells), np.int32) if regions is None else np.asarray(regions, np.int32)
    cells = np.where((volumes(points, cells) < 0)[:, None], cells[:, [1, 0, 2, 3]], cells)
    start = make_start(SimplexMesh(
        points, np.ascontiguousarray(cells), regions, np.zeros(len(points), np.bool_),
        lines=np.array(lines, dtype=np.int32).reshape(-1, 2)))
    held = np.full(len(points), FREELY, dtype=np.uint8)
    held[list(hold)] = STAYS
    vertices = start.frame.vertices
    body, guard, scratch, _ = lay_out(
        start, held[vertices], np.full(len(vertices), reach * start.frame.scale), 80.0,
        EVERYTHING)
    pairs = start.number[np.array(edges, dtype=np.int32)] if edges is not None else unique_edges(
        body.triangles.rows[body.triangles.live()])
    count = flip_patches(body, guard, np.ascontiguousarray(pairs), scratch)
    live, rows = body.tets.live(), body.triangles.rows[body.triangles.live()]
    result = vertices[body.tets.rows[live]]
    assert (np.sort(np.sort(vertices[rows], axis=1), axis=0).tolist()
            == np.sort(surface(result, body.tets.tag[live]), axis=0).tolist())
    return result, body.tets.tag[live], count


def volumes(points, cells):
    x = points[cells]
    return np.linalg.det(x[:, 1:] - x[:, :1]) / 6


def surface(cells, regions):
    """Facets (k, 3), sorted, with a cell on one side alone or with two regions on their sides."""
    rows = np.sort(np.concatenate([np.delete(cells, i, axis=1) for i in range(4)]), axis=1)
    unique, inverse, count = np.unique(rows, axis=0, return_inverse=True, return_counts=True)
    assert count.max() <= 2
    tags = np.tile(regions, 4)
    low, high = np.full(len(unique), 99), np.full(len(unique), -1)
    np.minimum.at(low, inverse.ravel(), tags)
    np.maximum.at(high, inverse.ravel(), tags)
    return unique[(count == 1) | (low != high)]


def has(cells, *vertices):
    return np.isin(cells, vertices).sum(axis=1) == len(vertices)


def cones(*rows, apices=(BELOW,)):
    """Tetrahedra between triangles and apices."""
    rows = np.concatenate([rows, AROUND])
    return np.concatenate([np.column_stack([rows, np.full(len(rows), top)]) for top in apices])


PAIR = cones([A, B, C], [A, B, D])
BOTH = cones([A, B, C], [A, B, D], apices=(BELOW, ABOVE))


def test_a_long_edge_between_two_flat_triangles_gives_way_to_the_short_one():
    cells, _, count = flipped(PLATE[:9], PAIR, edges=[[A, B]])
    assert count == 1
    assert len(cells) == len(PAIR)
    assert has(cells, A, C, D, BELOW).sum() == has(cells, B, C, D, BELOW).sum() == 1
    assert not has(cells, A, B).any()
    assert volumes(PLATE, cells).min() > 0
    assert volumes(PLATE, cells).sum() == pytest.approx(160)
    again, _, count = flipped(PLATE[:9], cells, edges=[[C, D]])
    assert count == 0
    assert len(again) == len(cells)


def test_an_interface_flips_on_both_sides_at_once():
    cells, regions, count = flipped(PLATE, BOTH, np.repeat([0, 1], 10), edges=[[B, A]])
    assert count == 1
    assert not has(cells, A, B).any()
    assert has(cells, C, D).sum() == 4
    assert volumes(PLATE, cells).min() > 0
    assert has(cells, ABOVE).tolist() == (regions == 1).tolist()
    for region in (0, 1):
        assert volumes(PLATE, cells)[regions == region].sum() == pytest.approx(160)


@pytest.mark.parametrize("sides", [1, 2])
def test_a_tetrahedron_that_is_flat_against_the_surface_goes(sides):
    """It goes from the mesh, or where there is a region above to that."""
    points = PLATE[: 8 + sides].copy()
    points[[C, D], 2] = -1e-4
    cells = np.concatenate([[[A, B, C, D]], cones([A, C, D], [B, C, D]), BOTH[10:]])
    cells = cells[: 11 if sides == 1 else 21]
    regions = np.repeat([0, 1], [11, 10])[: len(cells)]
    found, after, count = flipped(points, cells, regions, edges=[[A, B]])
    assert count == 1
    assert len(found) == len(cells) - 1
    assert not has(found, A, B).any()
    assert volumes(points, found).min() > 0
    kept = np.abs(volumes(points, cells)[1:11]).sum()
    assert volumes(points, found)[after == 0].sum() == pytest.approx(kept, rel=1e-12)


@pytest.mark.parametrize("change", ["feature line", "both ends stay", "would turn", "too far"])
def test_an_edge_stays_where_it_must(change):
    points = PLATE[:9].copy()
    how = {"feature line": {"lines": [[A, B]]}, "both ends stay": {"hold": [A, B]},
           "too far": {"reach": 0.03}, "would turn": {"reach": 4.0}}.get(change, {})
    points[[C, D], 2] = -0.02 * (change == "too far")
    if change == "would turn":
        points[[A, B], 2], points[[C, D], 1], points[BELOW, 2] = -2.0, [1.5, -1.5], -200.0
    cells, _, count = flipped(points, PAIR, edges=[[A, B]], **how)
    assert count == 0
    assert has(cells, A, B).sum() == 2


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), regions=st.booleans())
def test_any_surface_stays_closed_and_all_cells_positive(seed, regions):
    points, cells = ball(150, seed)
    tags = (points[cells].mean(axis=1)[:, 0] > 0).astype(np.int32) * regions
    found, after, _ = flipped(points, cells, tags, reach=0.2)
    assert volumes(points, found).min() > 0
    for r in np.unique(tags):
        was = volumes(points, cells)[tags == r].sum()
        assert volumes(points, found)[after == r].sum() == pytest.approx(was, rel=2e-3)
    rows = surface(found, after)
    edges = np.sort(np.concatenate([rows[:, [0, 1]], rows[:, [1, 2]], rows[:, [2, 0]]]), axis=1)
    degree = np.unique(edges, axis=0, return_counts=True)[1]
    assert degree.min() >= 2
    assert (np.sort(np.unique(found)) == np.unique(cells)).all()


@pytest.fixture
def calls(monkeypatch):
    """Parts of the envelope of every attempt, and what it broke."""
    found = []
    once = remesh_run._once

    def noted(*how, **more):
        result = once(*how, **more)
        found.append((how[0].share * how[0].parts, result[1]))
        return result

    monkeypatch.setattr(remesh_run, "_once", noted)
    return found


def test_bodies_that_cut_each_other_use_less_of_the_envelope(calls):
    mesh = shelled(2e-3, 60)
    (points, cells), report = odt_plugins.remesh_with_report(mesh, scale=1, envelope=0.01)
    assert report.fallback is None
    assert not any("stay as they are" in note for note in report.notes)
    assert calls[0][0].min() > calls[-1][0].min()
    assert calls[0][1].why == "the boundary cuts through itself"
    rim = surface(cells, np.zeros(len(cells), dtype=int))
    assert not len(crossing_pairs(points, rim))
    assert volumes(points, cells).min() > 0


def test_where_bodies_cut_each_other_already_the_envelope_is_whole(calls):
    points, cells = ball(150, 1)
    points, cells = (np.vstack([points, 0.9 * points + [1, 0, 0]]),
                     np.vstack([cells, cells + len(points)]))
    odt_plugins.remesh((points, cells), scale=0.8, envelope=0.03)
    rim = surface(cells, np.zeros(len(cells), dtype=int))
    own = np.unique(rim[crossing_pairs(points, rim)])
    assert calls[0][1].why == "the boundary cuts through itself"
    assert all((shares[own] == calls[0][0][0]).all() for shares, _ in calls[:-1])
    assert len({shares.min() for shares, _ in calls}) <= 3
