"""Tetrahedra whose boundary slides along the input surface."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest
from measure.hard import hard_meshes
from policies import set_policy
from surface_meshes import two_sided
from tet_meshes import (
    ball,
    brute_neighbors,
    dihedral_angles,
    facets_of,
    oriented,
    quality,
    shelled,
    signed_volumes,
)

import odt_plugins
from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import Bounds, Extremes
from odt_plugins.engine.cells.measures import QUALITY
from odt_plugins.engine.finish.phases import Phase, bulk, tail
from odt_plugins.engine.finish.volume import _flip_surface, finish
from odt_plugins.engine.ground.crossings import count_crossings, crossing_triangles
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import figures
from odt_plugins.engine.record.memory import Memory
from odt_plugins.engine.run import plan, retreat
from odt_plugins.engine.run.plan import run
from odt_plugins.engine.run.within import Within
from odt_plugins.engine.sliding import skin as sliding_skin
from odt_plugins.engine.sliding.skin import flip_skin, make_skin
from odt_plugins.engine.topology.complex import make_complex
from odt_plugins.errors import InvalidOptionError
from odt_plugins.figures import summarize
from odt_plugins.mesh.simplex import simplex_mesh
from odt_plugins.options import Options
from odt_plugins.promise.volume import broken_promises

DATA = Path(odt_plugins.__file__).parent / "compare" / "data"
LIMITS = Bounds(Extremes(0.0, 1.0, -1.0), Extremes(0.3, 0.97, -0.92))
NONE = np.zeros((0, 2), dtype=np.int32)


def boundary(cells):
    """Facets of one cell, outward, (b, 3)."""
    every = np.concatenate([cells[:, f] for f in ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))])
    _, first, count = np.unique(
        np.sort(every, axis=1), axis=0, return_index=True, return_counts=True
    )
    return every[np.sort(first[count == 1])]


def diagonal(points):
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def stored(name):
    mesh = meshio.read(DATA / name)
    return mesh.points, mesh.cells_dict["tetra"].astype(np.int32)


def skinned(points, cells, envelope=1e-2, held=None, stays=NONE):
    """A complex whose boundary slides."""
    mesh, _ = simplex_mesh(points, cells)
    rim = np.zeros(len(points), dtype=bool)
    rim[boundary(mesh.cells)] = True
    held = np.zeros(len(points), dtype=bool) if held is None else held
    x = mesh.points.copy()
    skin = make_skin(
        x, mesh.cells, locked=held, envelope=envelope * diagonal(x), angle=40.0, stays=stays,
        lines=NONE,
    )
    return make_complex(x, mesh.cells, mesh.regions, rim | held, rim, skin)


def box(k=6, inside=160, seed=4):
    """A cube: jittered vertices in its faces and inside, exact ones on its edges."""
    rng = np.random.default_rng(seed)
    g = np.linspace(0.0, 1.0, k)
    x = np.stack(np.meshgrid(g, g, g, indexing="ij"), axis=-1).reshape(-1, 3)
    ends = (x == 0.0) | (x == 1.0)
    faces = x[ends.sum(axis=1) == 1]
    faces += np.where((faces == 0.0) | (faces == 1.0), 0.0, rng.uniform(-0.05, 0.05, faces.shape))
    points = np.concatenate(
        [x[ends.sum(axis=1) > 1], faces, rng.uniform(0.12, 0.88, (inside, 3))]
    )
    from scipy.spatial import Delaunay

    cells = Delaunay(points).simplices.astype(np.int32)
    volume = signed_volumes(points, cells)
    cells[volume < 0.0] = cells[volume < 0.0][:, [1, 0, 2, 3]]
    return points, cells[np.abs(volume) > 1e-12]


@pytest.mark.parametrize(
    ("name", "mean", "one", "least", "below", "angle"),
    [("bunny.vtu", 0.825, 0.57, 0.20, 35, 11.7), ("cgal-bunny.vtu", 0.832, 0.53, 0.22, 35, 15.0)],
)
def test_sliding_reaches_what_a_fixed_boundary_cannot(name, mean, one, least, below, angle):
    points, cells = stored(name)
    (x, t), report = odt_plugins.optimize_with_report((points, cells), boundary="slide")
    q = quality(x, t)
    small = dihedral_angles(x, t).min(axis=1)
    assert q.mean() >= mean
    assert np.quantile(q, 0.01) >= one
    assert q.min() >= least
    assert (small < 20.0).sum() <= below
    assert small.min() >= angle
    assert (signed_volumes(x, t) > 0.0).all()
    old, new = signed_volumes(points, cells).sum(), signed_volumes(x, t).sum()
    assert abs(new / old - 1.0) <= 3e-3
    assert report.slid["volume"] == pytest.approx(new / old - 1.0, rel=1e-9)
    assert report.slid["forward"] <= report.slid["envelope"]
    assert report.slid["envelope"] == pytest.approx(1e-3 * diagonal(points))
    assert "slid" in str(report)


def test_distances_of_the_report_are_those_of_samples():
    points, cells = ball(400, 3)
    (x, t), report = odt_plugins.optimize_with_report(
        (points, cells), boundary="slide", envelope=5e-3
    )
    forward, backward = two_sided(points, boundary(cells), x, boundary(t))
    assert 0.0 < forward <= report.slid["forward"] * (1.0 + 1e-9)
    assert 0.0 < backward <= report.slid["backward"] * (1.0 + 1e-9)
    assert max(report.slid["forward"], report.slid["backward"]) <= 5e-3 * diagonal(points)


def test_a_cube_keeps_its_faces_edges_and_corners():
    points, cells = box()
    x, t = odt_plugins.optimize((points, cells), boundary="slide")
    assert signed_volumes(x, t).sum() == pytest.approx(1.0, abs=1e-13)
    moved = (x != points).any(axis=1)
    flat = (points == 0.0) | (points == 1.0)
    assert moved[flat.any(axis=1)].sum() > 40
    assert np.array_equal(x[flat], points[flat])
    assert not moved[flat.sum(axis=1) == 3].any()
    on_edges = flat.sum(axis=1) >= 2
    pairs = {tuple(p) for p in edges_on(boundary(cells), on_edges, flat)}
    assert pairs
    assert pairs == {tuple(p) for p in edges_on(boundary(t), on_edges, flat)}
    assert quality(x, t).mean() > quality(*odt_plugins.optimize((points, cells))).mean()


def edges_on(triangles, on_edges, flat):
    """Edges of triangles that lie on an edge of the cube."""
    sides = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    pairs = np.unique(np.sort(sides, axis=1), axis=0)
    both = (flat[pairs[:, 0]] & flat[pairs[:, 1]]).sum(axis=1) == 2
    return pairs[on_edges[pairs].all(axis=1) & both].tolist()


def test_a_fixed_boundary_is_the_default_and_stays():
    points, cells = ball(300, 5)
    x, _ = odt_plugins.optimize((points, cells))
    rim = np.unique(boundary(cells))
    assert np.array_equal(x[rim].view(np.int64), points[rim].view(np.int64))


@pytest.mark.parametrize("seed", [1, 2])
def test_sheet_cells_and_adjacency_agree_after_every_pass(seed):
    points, cells = ball(350, seed)
    mesh = skinned(points, cells)
    for phase in (*bulk(3), *tail(3)):
        finish(mesh, (phase,), LIMITS, None, 1)
        live = mesh.live()
        t = mesh.cells[live]
        assert (signed_volumes(mesh.points, t) > 0.0).all()
        row = np.full(len(mesh.cells), -1)
        row[live] = np.arange(len(live))
        inner = mesh.neighbors[live]
        assert np.array_equal(np.where(inner >= 0, row[inner], -1), brute_neighbors(t))
        ours, theirs = (
            {tuple(np.roll(f, -int(np.argmin(f))).tolist()) for f in triangles}
            for triangles in (mesh.skin.sheet.triangles, boundary(t))
        )
        assert ours == theirs
        for v in np.unique(mesh.skin.sheet.triangles):
            assert v in mesh.skin.sheet.triangles[mesh.skin.fan[v]]


def test_the_change_of_the_volume_is_counted_and_bounded():
    points, cells = ball(500, 8)
    mesh = skinned(points, cells, envelope=0.05)
    before = signed_volumes(mesh.points, mesh.cells[mesh.live()]).sum()
    finish(mesh, (*bulk(3), *tail(3)), LIMITS, None, 1)
    change = signed_volumes(mesh.points, mesh.cells[mesh.live()]).sum() - before
    assert mesh.skin.volume[0, 0] == pytest.approx(change, abs=1e-12 * before)
    assert 1e-4 * before < abs(change) <= 2.9e-3 * before


@pytest.mark.parametrize(("n", "seed"), [(500, 2), (500, 8), (900, 5)])
def test_a_larger_envelope_is_no_worse(n, seed):
    # the budget of the volume, which binds on these, is shared by all vertices
    found = []
    for envelope in (3e-4, 1e-3, 2e-2):
        x, t = odt_plugins.optimize(ball(n, seed), boundary="slide", envelope=envelope)
        q = quality(x, t)
        found.append((q.mean(), np.quantile(q, 0.01)))
    means, ones = zip(*found, strict=True)
    assert means[1] > means[0] + 0.005
    assert means[2] > means[1] - 0.002
    assert ones[2] > ones[1] - 0.02
    assert ones[1] > ones[0]


def test_every_vertex_has_its_budget_of_the_volume():
    points, cells = ball(300, 8)
    mesh = skinned(points, cells, envelope=0.05)
    budgets = mesh.skin.volume[1:, 1]
    rim = np.unique(boundary(cells))
    # a convex surface: no change cancels another
    assert budgets.sum() == pytest.approx(1.2)
    area = np.zeros(len(points))
    for row in boundary(cells).tolist():
        a, b, c = mesh.points[row]
        area[row] += np.linalg.norm(np.cross(b - a, c - a))
    assert budgets[rim] == pytest.approx(1.2 * area[rim] / area.sum())
    finish(mesh, (*bulk(3), *tail(3)), LIMITS, None, 1)
    spent = np.abs(mesh.skin.volume[1:, 0])
    assert (spent <= budgets * mesh.skin.most * (1 + 1e-12)).all()
    assert (spent > 0.5 * budgets * mesh.skin.most).sum() > 20


def test_flips_of_the_surface_lower_the_cost():
    points, cells = ball(500, 2)
    mesh = skinned(points, cells, envelope=0.02)

    def total():
        return (quality(mesh.points, mesh.cells[mesh.live()]) ** -2.0).sum()

    before = total()
    mesh.status[: mesh.used] = 1
    flips = _flip_surface(mesh, Phase(2.0, 1.0, 1, 1), LIMITS)
    assert flips > 10
    assert total() < before
    assert len(facets_of(mesh.cells[mesh.live()])) > 0


def flipped(prepare=lambda mesh: None, bounds=LIMITS):
    """A ball whose surface was flipped once, and how often."""
    mesh = skinned(*ball(500, 2), envelope=0.02)
    prepare(mesh)
    mesh.status[: mesh.used] = 1
    return mesh, _flip_surface(mesh, Phase(2.0, 1.0, 1, 1), bounds)


def test_flips_of_the_surface_leave_interfaces():
    def halves(mesh):
        mesh.regions[: mesh.used] = mesh.points[mesh.cells[: mesh.used], 0].sum(axis=1) > 0

    def interface(mesh):
        live = mesh.live()
        owners = facets_of(mesh.cells[live])
        return {f for f, o in owners.items() if len({int(mesh.regions[live][c]) for c in o}) == 2}

    start = skinned(*ball(500, 2), envelope=0.02)
    halves(start)
    mesh, flips = flipped(halves)
    assert flips > 10
    assert interface(mesh) == interface(start)


def test_locked_edges_of_the_surface_are_not_flipped():
    def lock(mesh):
        mesh.skin.sheet.locked[:] = True

    assert flipped()[1] > 10
    assert flipped(lock)[1] == 0


def test_flips_of_the_surface_respect_the_extremes():
    # no new cell may be worse than the worst that it replaces, in any figure
    strict = Bounds(Extremes(1.0, -1.0, 1.0), Extremes(1.0, -1.0, 1.0))
    assert 0 < flipped(bounds=strict)[1] < flipped()[1]


@pytest.mark.parametrize(("label", "flips"), [(1, 1), (2, 0)])
def test_a_flat_cell_of_the_surface_goes_unless_an_interface_is_behind_it(label, flips):
    points = np.array(
        [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, -1e-3], [0.0, -1.0, -1e-3],
         [0.0, 0.0, -1.0]]
    )
    cells = oriented(points, [[0, 1, 2, 3], [0, 2, 3, 4], [1, 3, 2, 4]])
    mesh, _ = simplex_mesh(points, cells, regions=[1, label, 1])
    rim = np.ones(len(points), dtype=bool)
    held = np.array([True, False, True, True, True])
    stays = np.array([[0, 2], [0, 3], [1, 2], [1, 3]], dtype=np.int32)
    skin = make_skin(
        mesh.points, mesh.cells, locked=held, envelope=0.01, angle=40.0, stays=stays, lines=NONE
    )
    tets = make_complex(mesh.points, mesh.cells, mesh.regions, rim, rim, skin)
    flat = np.array([True, False, False])
    assert flip_skin(tets, skin, flat, Cost(QUALITY, 2.0), LIMITS) == flips
    assert len(tets.live()) == 3 - flips


@pytest.mark.parametrize(("n", "seed"), [(500, 6), (800, 2), (800, 3)])
def test_every_vertex_of_the_surface_knows_a_triangle_where_flips_were_undone(
        n, seed, monkeypatch):
    wrong = []

    def checked(mesh, skin, near, cost, bounds):
        flips = flip_skin(mesh, skin, near, cost, bounds)
        used = np.unique(skin.sheet.triangles)
        wrong.append((skin.sheet.triangles[skin.fan[used]] != used[:, None]).all(axis=1).sum())
        return flips

    monkeypatch.setattr(sliding_skin, "flip_skin", checked)
    odt_plugins.optimize(ball(n, seed), boundary="slide")
    assert len(wrong) > 3
    assert not any(wrong)


def test_frozen_cells_beside_flips_that_are_undone_are_no_error():
    points, cells = ball(350, 7)
    order = np.argsort(quality(points, cells))
    selection = np.ones(len(cells), dtype=bool)
    selection[order[: len(cells) // 100]] = False
    x, t = odt_plugins.remesh((points, cells), scale=1.4, selection=selection)
    assert signed_volumes(x, t).min() > 0.0
    was = {tuple(sorted(map(tuple, points[cell]))) for cell in cells[~selection]}
    assert was <= {tuple(sorted(map(tuple, x[cell]))) for cell in t}


def test_edges_that_stay_are_not_flipped_and_held_vertices_not_moved():
    points, cells = ball(350, 4)
    rim = boundary(cells)
    edges = np.unique(np.sort(rim[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    held = np.zeros(len(points), dtype=bool)
    held[np.unique(rim)[::3]] = True
    mesh = skinned(points, cells, held=held, stays=edges.astype(np.int32))
    finish(mesh, (*bulk(3), *tail(3)), LIMITS, None, 1)
    now = {tuple(sorted(f)) for f in mesh.skin.sheet.triangles.tolist()}
    assert now == {tuple(sorted(f)) for f in rim.tolist()}
    assert np.array_equal(mesh.points[held], points[held])
    assert (mesh.points != points)[np.unique(rim)].any()


def test_regions_fixed_vertices_and_frozen_cells_stay():
    points, cells = ball(600, 6)
    middle = points[cells].mean(axis=1)
    regions = (middle[:, 0] > 0.0).astype(int)
    mesh, _ = simplex_mesh(points, cells, regions=regions)
    rim = boundary(cells)
    fixed = np.unique(rim)[::7]
    selection = middle[:, 2] < 0.5
    x, t, r = odt_plugins.optimize(
        (points, cells, regions), boundary="slide", fixed=fixed, selection=selection,
    )
    assert np.array_equal(x[fixed], points[fixed])
    frozen = {tuple(sorted(c)) for c in cells[~selection].tolist()}
    assert frozen <= {tuple(sorted(c)) for c in t.tolist()}
    assert np.array_equal(x[cells[~selection]], points[cells[~selection]])
    assert interface(t, r) == interface(cells, regions)
    shared = np.unique([v for f in interface(cells, regions) for v in f])
    assert np.array_equal(x[shared], points[shared])
    assert (x != points)[np.unique(rim)].any()
    assert mesh.dim == 3


def interface(cells, regions):
    """Facets between two labels."""
    sides = {}
    for c, label in zip(np.sort(cells, axis=1).tolist(), np.asarray(regions).tolist(), strict=True):
        for i in range(4):
            sides.setdefault(tuple(c[:i] + c[i + 1 :]), set()).add(label)
    return {f for f, labels in sides.items() if len(labels) == 2}


def test_triangles_and_lines_of_a_file_stay_in_it(tmp_path):
    points, cells = ball(400, 7)
    rim = boundary(cells)
    sides = 2 + (points[rim].mean(axis=1)[:, 0] > 0)
    source = tmp_path / "in.msh"
    meshio.write_points_cells(
        source, points, [("tetra", cells), ("triangle", rim)],
        cell_data={"gmsh:physical": [np.ones(len(cells), int), sides],
                   "gmsh:geometrical": [np.ones(len(cells), int), np.ones(len(rim), int)]},
        file_format="gmsh22", binary=False,
    )
    result = odt_plugins.optimize(source, boundary="slide")
    kept = result.cells_dict["triangle"]
    assert np.array_equal(kept, rim)
    assert {tuple(sorted(f)) for f in boundary(result.cells_dict["tetra"]).tolist()} == {
        tuple(sorted(f)) for f in rim.tolist()
    }
    assert (result.points != points)[np.unique(rim)].any()


def test_the_judge_sees_what_breaks():
    points, cells = ball(300, 9)
    mesh, _ = simplex_mesh(points, cells)

    def judged(x, t, before=mesh):
        regions = np.zeros(len(t), dtype=np.int32)
        return " ".join(broken_promises(before, x, t, regions, (), slides=True))

    assert judged(mesh.points, mesh.cells) == ""
    assert "volume went" in judged(1.01 * mesh.points, mesh.cells)
    on_rim = np.isin(mesh.cells, np.unique(boundary(mesh.cells)))
    assert "facets" in judged(mesh.points, mesh.cells[on_rim.sum(axis=1) < 4][1:])
    held, _ = simplex_mesh(points, cells, fixed=np.unique(boundary(cells)))
    moved = mesh.points * (1.0 + 1e-6)
    assert judged(moved, mesh.cells) == ""
    assert "fixed vertex" in judged(moved, mesh.cells, held)


@pytest.mark.parametrize("options", [{"envelope": 0.0}, {"envelope": -1e-3}, {"envelope": "x"},
                                     {"feature_angle": 0.0}, {"boundary": "free"}])
def test_wrong_options_are_named(options):
    points, cells = ball(100, 1)
    with pytest.raises(InvalidOptionError, match=next(iter(options))):
        odt_plugins.optimize((points, cells), **options)


def test_threads_and_repeats_give_the_same_bits(many_blocks):
    points, cells = ball(500, 10)
    one, two = (
        odt_plugins.optimize((points, cells), boundary="slide", threads=k) for k in (1, 2)
    )
    assert np.array_equal(one[0], two[0])
    assert np.array_equal(one[1], two[1])


def test_sliding_does_not_see_scale_or_place():
    points, cells = ball(300, 11)
    points = np.round(points * 2.0**24) / 2.0**24
    x, t = odt_plugins.optimize((points, cells), boundary="slide")
    for scale, shift in ((2.0**-30, 0.0), (2.0**30, 0.0), (1.0, 1024.0)):
        y, s = odt_plugins.optimize((points * scale + shift, cells), boundary="slide")
        assert np.array_equal(t, s), (scale, shift)
        assert np.abs((y - shift) / scale - x).max() <= 1e-12, (scale, shift)


def test_mid_nodes_follow_the_edges_of_a_surface_that_slides():
    points, cells = ball(250, 12)
    sides = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
    pairs = np.sort(np.concatenate([cells[:, s] for s in sides]), axis=1)
    edges, number = np.unique(pairs, axis=0, return_inverse=True)
    rows = np.hstack([cells, len(points) + number.reshape(6, -1).T])
    mesh = meshio.Mesh(
        np.concatenate([points, points[edges].mean(axis=1)]), [("tetra10", rows)]
    )
    result = odt_plugins.optimize(mesh, boundary="slide")
    x, t = result.points, result.cells_dict["tetra10"]
    assert (x[: len(points)] != points)[np.unique(boundary(cells))].any()
    for i, (a, b) in enumerate(sides):
        middle = 0.5 * (x[t[:, a]] + x[t[:, b]])
        assert np.abs(x[t[:, 4 + i]] - middle).max() <= 1e-12


def test_bodies_close_to_each_other_never_overlap(monkeypatch):
    set_policy(monkeypatch, retreat, slide_retreats=0)
    points, cells = shelled(2e-4)
    assert count_crossings(points, boundary(cells)) == 0
    (x, t), report = odt_plugins.optimize_with_report(
        (points, cells), boundary="slide", envelope=2e-2
    )
    assert report.slid is None
    assert "cuts through itself" in report.fallback
    (line,) = [line for line in str(report).splitlines() if line.startswith("fell back: ")]
    assert re.search(r"at mean q 0\.\d{3} and least q 0\.\d{3}.*; try envelope=0\.01$", line)
    assert crossing_pairs(x, boundary(t)) == 0
    rim = np.unique(boundary(cells))
    assert np.array_equal(x[rim], points[rim])


def test_a_surface_is_left_alone_only_where_it_would_cut_through_itself():
    points, cells = shelled(0.1)
    ball = np.arange(len(points)) < 181
    points[ball, 0] += 0.0985
    rim = np.unique(boundary(cells))
    assert count_crossings(points, boundary(cells)) == 0
    shares = []
    (x, t), report = odt_plugins.optimize_with_report(
        (points, cells), boundary="slide", envelope=1e-2,
        progress=lambda stage, share: shares.append(share),
    )
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert crossing_pairs(x, boundary(t)) == 0
    alone = report.counts["surface vertices left alone"]
    moved = (x[rim] != points[rim]).any(axis=1)
    assert 0 < alone <= (~moved).sum()
    assert report.slid["vertices"] == moved.sum() > 400
    assert max(report.slid["forward"], report.slid["backward"]) <= report.slid["envelope"]


def test_a_surface_is_left_alone_where_cells_would_pass_the_extremes(monkeypatch):
    mesh = simplex_mesh(*ball(500, 5))[0]
    rim = np.unique(boundary(mesh.cells))
    once = plan.run_once
    free, nowhere = once(mesh, Options(boundary="slide"), plan.as_it_is)
    assert len(nowhere) == 0
    alone = rim[(free.points[rim] != mesh.points[rim]).any(axis=1)][:5]

    def spoiled_at_first(start, options, *given, **named):
        if start is mesh and options.boundary == "slide":
            return replace(free, slid=None), alone
        return once(start, options, *given, **named)

    monkeypatch.setattr(plan, "run_once", spoiled_at_first)
    outcome = run(mesh, Options(boundary="slide"))
    assert outcome.counts["surface vertices left alone"] == 5
    assert outcome.slid.vertices > 20
    assert outcome.times["smoothing"] > free.times["smoothing"]
    assert outcome.points[alone].tobytes() == mesh.points[alone].tobytes()
    assert broken_promises(mesh, outcome.points, outcome.cells, outcome.regions, slides=True) == []


@pytest.fixture(scope="module")
def fixed_ones():
    """Hard meshes by name, and what becomes of them within their surface."""
    meshes = {hard.name: simplex_mesh(hard.points, hard.cells, regions=hard.regions)[0]
              for hard in hard_meshes(30, (3,))}
    return {name: (mesh, run(mesh, Options())) for name, mesh in meshes.items()}


@pytest.mark.parametrize(("poor", "few"), [
    (POLICY.poor_quality, 0), (0.0, POLICY.few_cells)])
def test_a_surface_that_may_slide_is_no_worse_than_a_fixed_one(
        monkeypatch, fixed_ones, poor, few):
    set_policy(monkeypatch, retreat, poor_quality=poor, few_cells=few)
    left = {}
    for name, (mesh, fixed) in fixed_ones.items():
        slid = run(mesh, Options(boundary="slide"))
        compared = few or summarize(slid.points, slid.cells).p1_quality < poor
        assert score(slid) >= score(fixed) - (1e-12 if compared else 0.03), name
        if slid.slid is None:
            left[name] = slid.fallback
            assert slid.points.tobytes() == fixed.points.tobytes()
    assert any("a surface that slid gave less" in why for why in left.values())


def score(outcome):
    """What is weighed: mean, 1 % and least radius ratio, and the price of small angles."""
    found = summarize(outcome.points, outcome.cells)
    small = min(found.share_below_20, POLICY.counted_small_angles)
    return (found.mean_quality + 0.5 * found.p1_quality + 0.25 * found.min_quality
            - POLICY.small_angle_price * small)


def test_a_surface_that_slides_is_alone_where_cells_are_many_and_good(monkeypatch):
    asked = []
    once = plan.run_once

    def counted(start, options, *given, **named):
        asked.append(options.boundary)
        return once(start, options, *given, **named)

    monkeypatch.setattr(plan, "run_once", counted)
    set_policy(monkeypatch, retreat, few_cells=0)
    mesh = simplex_mesh(*ball(500, 5))[0]
    assert run(mesh, Options(boundary="slide")).slid is not None
    assert run(mesh, Options(boundary="slide", finish=False, keep=())).slid is not None
    assert asked == ["slide", "slide"]
    stretched = replace(
        mesh, points=mesh.points * [1.0, 1.0, 64.0],
        metric=np.tile([0.0, 0.0, 0.0, 0.0, 0.0, -np.log(64.0)], (len(mesh.points), 1)))
    assert run(stretched, Options(boundary="slide", envelope=1e-5)).slid is not None
    assert asked == ["slide"] * 3


def test_a_refused_state_tells_the_cells_beyond_the_extremes():
    mesh = simplex_mesh(*ball(300, 2))[0]
    keep = Options().keep
    before = replace(figures(mesh.points, mesh.cells), mean_quality=0.0, p1_quality=0.0)
    rim = np.unique(boundary(mesh.cells))
    state = make_complex(mesh.points, mesh.cells, mesh.regions, np.isin(
        np.arange(len(mesh.points)), rim), np.isin(np.arange(len(mesh.points)), rim))
    stored_cells = state.mesh_arrays()[0]
    q, angles = (f(mesh.points, stored_cells) for f in (quality, dihedral_angles))
    for change, bad in (
        ({"min_quality": np.sort(q)[3] + 1e-9}, np.argsort(q)[:4]),
        ({"cos_min_angle": np.cos(np.radians(np.sort(angles.min(axis=1))[2] + 1e-6))},
         np.argsort(angles.min(axis=1))[:3]),
        ({"cos_max_angle": np.cos(np.radians(np.sort(angles.max(axis=1))[-2] - 1e-6))},
         np.argsort(angles.max(axis=1))[-2:]),
    ):
        memory = Memory(replace(before, **change), keep, "radius_ratio", by_score=True)
        assert not memory.offer(state, "x")
        assert np.array_equal(memory.spoiled(), np.unique(stored_cells[bad]))
    memory = Memory(replace(before, min_quality=1.0, mean_quality=1.0), keep,
                           "radius_ratio", by_score=True)
    assert not memory.offer(state, "x")
    assert not len(memory.spoiled())


def crossing_pairs(points, triangles):
    """Edges through triangles, every pair looked at: the slow twin."""
    sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    count = 0
    for row in triangles:
        a, b, c = points[row]
        apart = ~np.isin(sides, row).any(axis=1)
        owners = np.tile(np.arange(len(triangles)), 3)
        apart &= ~np.isin(triangles[owners], row).any(axis=1)
        u, v = points[sides[apart, 0]], points[sides[apart, 1]]
        normal = np.cross(b - a, c - a)
        start, end = (u - a) @ normal, (v - a) @ normal
        through = start * end < 0.0
        w = np.divide(start, start - end, out=np.zeros(len(u)), where=through)
        hit = u + w[:, None] * (v - u)
        inside = [np.cross(q - p, hit - p) @ normal > 0.0 for p, q in ((a, b), (b, c), (c, a))]
        count += int((through & inside[0] & inside[1] & inside[2]).sum())
    return count


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_crossings_are_those_of_the_slow_twin(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(60, 3))
    triangles = np.array([rng.choice(60, 3, replace=False) for _ in range(50)], dtype=np.int32)
    found = count_crossings(points, triangles)
    assert found == crossing_pairs(points, triangles)
    assert found > 5


def test_crossings_in_many_strips_are_those_of_the_slow_twin():
    # mostly small triangles in a flat slab, and a few that reach through many strips
    rng = np.random.default_rng(8)
    size = np.where(np.arange(500) % 25 == 0, 1.0, 0.15)
    corners = rng.uniform(0.0, [3.0, 2.0, 0.5], (500, 1, 3)) + (
        size[:, None, None] * rng.normal(size=(500, 3, 3)))
    points, triangles = corners.reshape(-1, 3), np.arange(1500, dtype=np.int32).reshape(-1, 3)
    found = count_crossings(points, triangles)
    assert found == crossing_pairs(points, triangles)
    assert found > 500
    hit = crossing_triangles(points, triangles)
    alone = [count_crossings(points, np.delete(triangles, i, axis=0)) == found for i in range(40)]
    assert np.array_equal(hit[:40], ~np.array(alone))


def test_a_surface_that_slides_leaves_no_phase_out_and_works_everywhere():
    mesh = simplex_mesh(*ball(200, 3))[0]
    told = Within(whole=figures(mesh.points, mesh.cells))
    nowhere = np.zeros(len(mesh.points), dtype=bool)
    plain, other = (run(mesh, Options(boundary="slide"), within=how) for how in (
        told, told._replace(without=("bulk",), fresh=nowhere, part=0.1)))
    assert plain.points.tobytes() == other.points.tobytes()
    assert (plain.points != mesh.points).any()
