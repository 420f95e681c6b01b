"""Feature edges, kinds of vertices, orientation and the checks of curved surfaces."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import surface_meshes as sm

from odt_plugins.engine.ground.features import (
    LARGEST_FAN,
    find_features,
    label_borders,
    marked_edges,
    pinched_vertices,
    sharp_edges,
)
from odt_plugins.engine.ground.sheet import LINE, LOCKED, SMOOTH
from odt_plugins.engine.topology.star import vertex_stars
from odt_plugins.errors import EndlessWalkError, InvalidMeshError, InvalidOptionError
from odt_plugins.mesh.surface import surface_edges, surface_mesh


def features(p, t, angle=40.0, fixed=(), kept=None, **options):
    mesh = surface_mesh(p, t)
    edges = surface_edges(mesh.cells, len(p))
    mask = np.zeros(len(p), bool)
    mask[list(fixed)] = True
    found = find_features(mesh.points, mesh.cells, edges, vertex_stars(mesh.cells, len(p)),
                          angle=angle, fixed=mask, kept=kept and kept(edges), **options)
    return found, {tuple(e) for e in edges.vertices[found.edges].tolist()}


def test_edges_know_their_triangles():
    p, t = sm.bowl(6)
    edges = surface_edges(t.astype(np.int32), len(p))
    assert {tuple(e): d for e, d in zip(edges.vertices.tolist(), edges.degree.tolist(),
                                        strict=True)} == sm.edge_set(t)
    for c in range(len(t)):
        for i in range(3):
            ends = {int(t[c, (i + 1) % 3]), int(t[c, (i + 2) % 3])}
            assert set(edges.vertices[edges.of_cell[c, i]].tolist()) == ends
            other = [d for d in range(len(t)) if d != c and ends <= set(t[d].tolist())]
            assert [edges.neighbors[c, i]] == (other or [-1])
            assert edges.forward[c, i] == (t[c, (i + 1) % 3] < t[c, (i + 2) % 3])


@pytest.mark.parametrize("noise", [0.0, 0.8])
@pytest.mark.parametrize("k", [1, 4])
def test_a_cube_has_twelve_edges_and_eight_corners(k, noise):
    p, t = sm.cube(k, noise * (k > 1))
    p = sm.turned(p)
    found, edges = features(p, t)
    assert len(edges) == 12 * k
    assert found.corners == 8
    assert np.bincount(found.kind, minlength=3).tolist() == [
        6 * (k - 1) ** 2, 12 * (k - 1), 8]
    for slot in found.lines.slot[found.kind == LINE]:
        a, v, b = found.lines.nodes[slot - 1 : slot + 2]
        assert {tuple(sorted((a, v))), tuple(sorted((v, b)))} <= edges


def test_a_cylinder_has_two_rims_whose_vertices_stay():
    p, t = sm.cylinder(24, 6, 3, noise=0.5)
    found, edges = features(p, t)
    assert len(edges) == 48
    assert found.corners == 2, "one anchor for each closed line"
    on = np.unique(list(edges))
    assert (found.kind[on] == LOCKED).all()
    assert (np.delete(found.kind, on) == SMOOTH).all()
    slides, _ = features(p, t, slack=0.02)
    assert (slides.kind[on] == LINE).sum() == 46


def test_smooth_surfaces_have_none_and_a_rim_is_one():
    assert not features(*sm.sphere(2, 0.05))[1]
    assert not features(*sm.torus(noise=0.3))[1]
    found, edges = features(*sm.bowl(12, noise=0.5))
    assert len(edges) == 44
    assert found.corners == 4


def test_noise_is_no_crease():
    p, t = sm.bowl(30)
    rng = np.random.default_rng(21)
    inner = np.ones(len(p), bool)
    inner[list({v for e, d in sm.edge_set(t).items() if d == 1 for v in e})] = False
    p[inner, 2] += 0.22 * 2 / 29 * rng.standard_normal(int(inner.sum()))
    normal = np.cross(p[t[:, 1]] - p[t[:, 0]], p[t[:, 2]] - p[t[:, 0]])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    edges = surface_edges(t.astype(np.int32), len(p))
    cell, corner = np.nonzero(edges.neighbors >= 0)
    turns = (normal[cell] * normal[edges.neighbors[cell, corner]]).sum(axis=1)
    raw = (turns < np.cos(np.radians(40))).sum() / 2
    assert raw > 100
    assert len(features(p, t)[1]) - 4 * 29 < 0.4 * raw


def test_the_edges_of_a_folded_sliver_are_no_crease():
    p, t = sm.cube(4)
    v = int(np.flatnonzero((p == [0.5, 0.5, 1.0]).all(axis=1))[0])
    w = int(np.flatnonzero((p == [0.75, 0.5, 1.0]).all(axis=1))[0])
    p[v] = p[w] + [-1e-3, 1e-4, 2e-3]
    assert len(features(p, t)[1]) == 48


def test_a_long_crease_that_ends_within_is_kept_and_a_short_one_is_not():
    for length, kept in ((12, True), (2, False)):
        i, j = (x.ravel().astype(float) for x in np.meshgrid(range(21), range(21),
                                                             indexing="ij"))
        rise = np.clip(length - np.abs(i - 10), 0, 4) / 4
        p = np.stack([i, j, rise * 1.2 * np.abs(j - 10)], axis=1)
        _, edges = features(p, sm.grid(21, 21))
        middle = {e for e in edges if all(p[v, 1] == 10 for v in e)}
        assert bool(middle) == kept


def test_a_crease_with_loose_ends_counts_from_five_edges_on():
    i, j = (x.ravel().astype(float) for x in np.meshgrid(range(21), range(21), indexing="ij"))
    t = sm.grid(21, 21).astype(np.int32)
    seen = set()
    for steps in range(2, 9):
        # a low fold along y = 10 that is sharp for some steps
        slope = np.where((i >= 5) & (i <= 5 + steps), 0.38, 0.1)
        p = np.stack([i, j, slope * np.minimum(np.abs(j - 10), 1)], axis=1)
        sharp = int(sharp_edges(p, t, surface_edges(t, len(p)), 40.0).sum())
        _, edges = features(p, t)
        found = [e for e in edges if all(p[v, 1] == 10 for v in e)]
        assert len(found) == (sharp if sharp >= 5 else 0)
        seen.add(sharp)
    assert {4, 5} <= seen


def test_labels_marks_and_fixed_vertices():
    p, t = sm.sphere(2)
    label = (p[t].mean(axis=1)[:, 2] > 0).astype(np.int32)
    _, edges = features(p, t, kept=lambda edges: label_borders(edges, label))
    border = {e for e in sm.edge_set(t)
              if len({label[c] for c in np.flatnonzero(np.isin(t, e).sum(axis=1) == 2)}) == 2}
    assert edges == border
    assert edges
    a, b = (int(v) for v in t[0, :2])
    assert features(p, t, kept=lambda edges: marked_edges(
        edges, np.array([[b, a], [0, 0]]), len(p)))[1] == {(min(a, b), max(a, b))}
    assert features(p, t, fixed=[5])[0].kind[5] == LOCKED
    p, t = sm.cube(4)
    line = int(np.flatnonzero(features(p, t)[0].kind == LINE)[0])
    assert features(p, t, fixed=[line])[0].kind[line] == LOCKED


def test_three_sheets_meet_in_a_line_that_stays():
    p, t = sm.cube(3)
    wing = len(p)
    top = np.flatnonzero((p[:, 2] == 1) & (p[:, 1] == 1))
    top = top[np.argsort(p[top, 0])]
    p = np.concatenate([p, p[top] + [0, 1, 1]])
    extra = [(top[i], top[i + 1], wing + i) for i in range(3)]
    extra += [(top[i + 1], wing + i + 1, wing + i) for i in range(3)]
    t = np.concatenate([t, extra])
    found, edges = features(p, t)
    assert {tuple(sorted((int(a), int(b)))) for a, b in pairwise(top)} <= edges
    assert found.pinched[top].all()
    assert (found.kind[top[1:-1]] == LINE).all()


def test_vertices_where_two_fans_meet_are_held():
    p, t = sm.sphere(2)
    q = np.concatenate([p, p[1:] + 2 * p[0]])
    other = np.where(t == 0, 0, t + len(p) - 1)
    found, _ = features(q, np.concatenate([t, other]))
    assert found.pinched.nonzero()[0].tolist() == [0]
    assert found.kind[0] == LOCKED


def test_triangles_that_lead_on_without_an_end_are_named():
    # the last two run through the edge of vertices 0 and 1 the same way
    t = np.array([[0, 2, 5], [0, 1, 2], [0, 1, 3]], dtype=np.int32)
    with pytest.raises(EndlessWalkError, match="triangles around vertex 0 that lead on") as caught:
        pinched_vertices(t, surface_edges(t, 6), vertex_stars(t, 6), 6)
    assert caught.value.vertex == 0


@pytest.mark.parametrize(("around", "kind"), [(LARGEST_FAN, SMOOTH), (LARGEST_FAN + 1, LOCKED)])
def test_a_vertex_of_very_many_triangles_stays(around, kind):
    angle = np.arange(around) * 2 * np.pi / around
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    i, j = np.arange(around), np.roll(np.arange(around), -1)
    found, _ = features(np.concatenate([ring, [[0.0, 0.1, 0.2]]]),
                        np.stack([i, j, np.full(around, around)], axis=1))
    assert found.kind[around] == kind


def test_unused_vertices_do_no_harm():
    p, t = sm.sphere(1)
    found, edges = features(np.concatenate([p, [[9.0, 9, 9]]]), t)
    assert found.kind[-1] == LOCKED
    assert not edges


@pytest.mark.parametrize(("change", "message"), [
    (lambda p, t: (p, np.concatenate([t, t[4:5, [0, 2, 1]]])), r"cell 80.*\(cell 4\)"),
    (lambda p, t: (p, np.concatenate([t, [[3, 3, 5]]])), "vertex used twice"),
    (lambda p, t: (p * 1e80, t), "mesh is 2.0e.80 long"),
    (lambda p, t: (p, np.concatenate([t[:5, [0, 2, 1]], t[5:]])), "disagree about the outside"),
])
def test_bad_surfaces_are_named(change, message):
    with pytest.raises(InvalidMeshError, match=message):
        surface_mesh(*change(*sm.sphere(1)))


def test_orient_turns_the_smaller_part():
    p, t = sm.torus(8, 6)
    rng = np.random.default_rng(12)
    odd = rng.random(len(t)) < 0.3
    mixed = t.copy()
    mixed[odd] = t[odd][:, [0, 2, 1]]
    assert np.array_equal(surface_mesh(p, mixed, orient=True).cells, t)
    points, strip = sm.moebius()
    assert surface_mesh(points, strip, orient=True).frozen.any()
    strip[::7] = strip[::7, [0, 2, 1]]
    with pytest.raises(InvalidMeshError, match="Moebius strip, non-orientable"):
        surface_mesh(points, strip, orient=True)


def test_options_must_fit():
    p, t = sm.sphere(1)
    with pytest.raises(InvalidOptionError, match="regions have shape"):
        surface_mesh(p, t, regions=np.zeros(3, int))
    with pytest.raises(InvalidOptionError, match="fixed"):
        surface_mesh(p, t, fixed=[99])
    mesh = surface_mesh(p, t, selection=[0, 1])
    assert mesh.frozen.sum() == len(t) - 2


def test_a_bend_whose_vertex_is_there_several_times_is_held():
    # a folded strip whose crease turns by 15 degrees at three vertices at the same place
    turn = np.radians(15.0)
    x = np.array([[0.0, 0], [1, 0], [2, 0], [2 + 1e-9, 0], [2 + 2e-9, 0],
                  [2 + np.cos(turn), np.sin(turn)], [2 + 2 * np.cos(turn), 2 * np.sin(turn)]])
    k = len(x)
    crease = np.column_stack([x, np.zeros(k)])
    points = np.concatenate([crease, crease + np.array([0, 1, 0]), crease + np.array([0, 0, 1])])
    i = np.arange(k - 1)
    cells = np.concatenate([
        np.stack([i, i + 1, k + i], axis=1), np.stack([i + 1, k + i + 1, k + i], axis=1),
        np.stack([i + 1, i, 2 * k + i], axis=1),
        np.stack([2 * k + i + 1, i + 1, 2 * k + i], axis=1),
    ])
    found, _ = features(points, cells)
    assert found.kind[:k].tolist() == [LOCKED, LINE, LOCKED, LOCKED, LOCKED, LINE, LOCKED]
