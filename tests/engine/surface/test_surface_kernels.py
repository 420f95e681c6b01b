"""Moves, flips and guards of curved surfaces, against slow code and closed forms."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import surface_meshes as sm
from planar_meshes import MEASURES as PLANAR

from odt_plugins.engine.cells.cost import ENERGY, Cost
from odt_plugins.engine.cells.extremes import FREELY
from odt_plugins.engine.cells.measures import QUALITY, star_terms_2d
from odt_plugins.engine.finish import descent
from odt_plugins.engine.finish.phases import Phase
from odt_plugins.engine.ground.build import ground_values, make_ground, make_sheet
from odt_plugins.engine.ground.features import find_features
from odt_plugins.engine.ground.pair import edge_is_free
from odt_plugins.engine.ground.sheet import LOCKED, Guards, Limits, claim, make_work
from odt_plugins.engine.ground.trace import End, edge_is_near
from odt_plugins.engine.sliding.flips import sheet_triangle
from odt_plugins.engine.surface import passes
from odt_plugins.engine.surface.odt import CPT, GIVEN, LAPLACIAN, NOWHERE, ODT, Target, star_centre
from odt_plugins.engine.surface.passes import Surface, SurfaceDescent, flip_all
from odt_plugins.engine.surface.rounds import surface_energy
from odt_plugins.engine.topology.star import vertex_stars
from odt_plugins.errors import EndlessWalkError
from odt_plugins.figures import angles, radius_ratio
from odt_plugins.mesh.chunks import Pool
from odt_plugins.mesh.surface import surface_edges

pytestmark = pytest.mark.usefixtures("nothing_compiled")

ENERGY_ONLY = Cost(ENERGY, 1.0)


def build(p, t, envelope=1e-2, cosine=0.5, slack=1e-6, **options):
    t = np.ascontiguousarray(t, dtype=np.int32)
    edges, stars = surface_edges(t, len(p)), vertex_stars(t, len(p))
    found = find_features(p, t, edges, stars, angle=40.0, fixed=np.zeros(len(p), bool),
                          slack=slack)
    size = sm.diagonal(p)
    limits = Limits((envelope * size) ** 2, (slack * size) ** 2, cosine)
    guards = Guards(make_ground(p, t, edges, stars, found.edges), found.lines, limits)
    return Surface(make_sheet(p, t, edges, found), guards, np.zeros(len(t), np.int32), **options)


def finish_phase(surface, phase):
    work = SurfaceDescent(surface, phase, FREELY)
    return work.compound(), *descent.finish_phase(work, phase)


def move_all(surface, centre, rho=None, vectors=NOWHERE):
    rho = np.ones(len(surface.points)) if rho is None else rho
    return passes.move_all(surface, Target(centre, rho, False, 1.0, vectors), FREELY)


def improve(surface, rounds=4):
    """Both stages, in short."""
    m = len(surface.triangles)
    rho = np.ones(len(surface.points))
    for _ in range(rounds):
        flip_all(surface, ENERGY_ONLY, FREELY, np.ones(m, bool), np.zeros(m, bool))
        move_all(surface, ODT, rho)
    finish_phase(surface, Phase(2.0, 1.0, 4, 2, 2))
    finish_phase(surface, Phase(8.0, 0.1, 4, 2))


MESHES = {
    "sphere": lambda: sm.sphere(3, 0.15),
    "torus": lambda: sm.torus(noise=0.7),
    "bowl": lambda: sm.bowl(noise=0.8),
    "cube": lambda: sm.cube(7, 0.8),
    "cylinder": lambda: sm.cylinder(noise=0.7),
}


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("envelope", [2e-3, 1e-2])
def test_the_surface_stays_in_its_envelope_and_keeps_its_topology(name, envelope):
    p, t = MESHES[name]()
    p = sm.turned(p)
    surface = build(p, t, envelope)
    improve(surface)
    assert max(sm.two_sided(p, t, surface.points, surface.triangles)) <= (
        envelope * sm.diagonal(p) * (1 + 1e-9))
    assert sm.topology(surface.triangles) == sm.topology(t)
    before, after = radius_ratio(p, t), radius_ratio(surface.points, surface.triangles)
    assert after.mean() > before.mean() + 0.01
    held = surface.sheet.kind == LOCKED
    assert np.array_equal(surface.points[held], p[held])
    assert np.array_equal(surface.guards.ground.points, p)


@pytest.mark.parametrize("name", MESHES)
def test_neighbours_numbers_and_lists_stay_sound(name):
    p, t = MESHES[name]()
    surface = build(p, t)
    improve(surface)
    sheet = surface.sheet
    edges = surface_edges(sheet.triangles, len(p))
    assert np.array_equal(edges.neighbors, sheet.neighbors)
    assert (edges.degree[edges.of_cell] != 2).tolist() == (
        (sheet.neighbors < 0).tolist())
    for e in range(len(sheet.edges.cell)):
        assert e in sheet.edges.of_cell[sheet.edges.cell[e]]
    ways = np.bincount(edges.of_cell.ravel(), edges.forward.ravel())
    assert (ways[edges.degree == 2] == 1).all()
    covered = []
    for c in range(len(t)):
        v = sheet.first[c]
        while v >= 0:
            covered.append(v)
            v = sheet.following[v]
    assert sorted(covered) == list(range(len(p)))
    feet = surface.guards.ground.triangles[sheet.foot]
    off = [sm.distances(x[None], p, f[None])[0]
           for x, f in zip(surface.points, feet, strict=True)]
    assert max(off) < 1e-12


def test_sharp_edges_of_a_cube_stay_while_their_vertices_slide():
    p, t = sm.cube(8, 0.9)
    p = sm.turned(p)
    surface = build(p, t)
    improve(surface)
    assert max(sm.two_sided(p, t, surface.points, surface.triangles, 3)) < 1e-12
    moved = (surface.points != p).any(axis=1)
    assert moved[surface.guards.lines.slot >= 0].mean() > 0.95
    assert sm.edge_set(surface.triangles).keys() >= {
        tuple(sorted((int(a), int(b)))) for a, b in pairwise(surface.guards.lines.nodes)
        if surface.guards.lines.slot[a] >= 0 or surface.guards.lines.slot[b] >= 0}


def test_lines_slide_within_their_slack():
    p, t = sm.cylinder(40, 10, 4, noise=0.7)
    rim = np.unique([v for v in range(len(p)) if abs(np.hypot(*p[v, :2]) - 1) < 1e-12
                     and p[v, 2] in (0.0, 2.0)])
    turn = np.arctan2(p[rim, 1], p[rim, 0])
    shift = turn + 0.3 * 2 * np.pi / 40 * np.sin(3 * turn)
    p[rim, 0], p[rim, 1] = np.cos(shift), np.sin(shift)
    surface = build(p, t, 5e-3, slack=5e-3)
    improve(surface)
    moved = np.linalg.norm(surface.points - p, axis=1)
    assert (moved[rim] > 1e-3).sum() > 40
    line = 5e-3 * sm.diagonal(p)
    for height in (0.0, 2.0):
        ring = rim[p[rim, 2] == height]
        ring = ring[np.argsort(np.arctan2(p[ring, 1], p[ring, 0]))]
        closed = np.stack([ring, np.roll(ring, -1), ring], axis=1)
        old, new = sm.samples(p, closed), sm.samples(surface.points, closed)
        assert sm.distances(new, p, closed).max() < line * (1 + 1e-9)
        assert sm.distances(old, surface.points, closed).max() < line * (1 + 1e-9)
    assert np.allclose(surface.points[rim, 2], p[rim, 2], atol=1e-12)


def test_normals_stay_within_the_stated_angle():
    p, t = sm.torus()
    surface = build(p, t, 0.2, cosine=np.cos(np.radians(20.0)))
    shake = 0.3 * np.random.default_rng(14).standard_normal((3, *p.shape))
    for vectors in shake:
        move_all(surface, GIVEN, vectors=vectors)
    x, c = surface.points, surface.triangles
    centre = x[c].mean(axis=1)
    flat = centre * [1, 1, 0]
    exact = centre - flat / np.linalg.norm(flat, axis=1)[:, None]
    exact /= np.linalg.norm(exact, axis=1)[:, None]
    normal = np.cross(x[c[:, 1]] - x[c[:, 0]], x[c[:, 2]] - x[c[:, 0]])
    cosine = (normal * exact).sum(axis=1) / np.linalg.norm(normal, axis=1)
    # one step around the torus turns its normal by 22.5 degrees
    assert np.degrees(np.arccos(cosine.min())) < 20 + 22.5
    assert np.linalg.norm(x - p, axis=1).mean() > 0.02


def test_flat_surfaces_become_delaunay():
    p, t = sm.bowl(12, noise=0.9)
    p[:, 2] = 0.0
    p = sm.turned(p)
    surface = build(p, t)
    m = len(t)
    energy = surface_energy(surface, np.ones(len(p)))
    assert flip_all(surface, ENERGY_ONLY, FREELY, np.ones(m, bool), np.zeros(m, bool)) > 10
    assert surface_energy(surface, np.ones(len(p))) < energy
    angle = angles(p, surface.triangles)
    for c in range(m):
        for i in range(3):
            near = surface.sheet.neighbors[c, i]
            if near >= 0:
                j = surface.sheet.neighbors[near].tolist().index(c)
                assert angle[c, i] + angle[near, j] < 180 + 1e-6


def test_no_flip_makes_an_edge_twice():
    # an octahedron: every flip would join two vertices that are joined already, or leave it
    p = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 0.3], [0, 0, -0.3]])
    t = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4],
                  [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    surface = build(p, t, 10.0, cosine=-2.0)
    surface.sheet.locked[:] = False
    for cost in (ENERGY_ONLY, Cost(QUALITY, 1.0), Cost(QUALITY, 4.0)):
        flip_all(surface, cost, FREELY, np.ones(8, bool), np.zeros(8, bool))
        assert set(sm.edge_set(surface.triangles).values()) == {2}
        assert len(sm.edge_set(surface.triangles)) == 12


def wheel(around=12):
    """A pyramid, its apex vertex 0 and the first corner of every triangle."""
    angle = np.arange(around) * 2 * np.pi / around
    rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    i = np.arange(around)
    return (np.concatenate([[[0.0, 0.0, 0.3]], rim]),
            np.stack([0 * i, 1 + i, 1 + (i + 1) % around], axis=1))


@pytest.mark.parametrize("walk", [
    lambda sheet: edge_is_free(sheet, 0, 0, 0, 99),
    lambda sheet: sheet_triangle(sheet, 0, 0, 99)[0] >= 0,
])
def test_a_walk_that_never_comes_back_to_where_it_began_ends_and_is_named(walk):
    surface = build(*wheel())
    walk(surface.sheet)
    surface.sheet.check()
    following = surface.sheet.neighbors[:, 1]
    following[following[following[0]]] = following[0]
    assert not walk(surface.sheet)
    with pytest.raises(EndlessWalkError, match="vertex 0 "):
        surface.sheet.check()


def test_a_list_of_covered_vertices_that_bites_its_tail_ends_and_is_named():
    surface = build(*wheel())
    work = make_work(surface.guards.ground)
    work.cells[0] = 4
    assert claim(surface.sheet, surface.guards.ground, 1, 1.0, work) >= 1
    v = surface.sheet.first[4]
    surface.sheet.following[v] = v
    assert claim(surface.sheet, surface.guards.ground, 1, 1.0, work) == -1
    with pytest.raises(EndlessWalkError, match=f"vertex {v} "):
        surface.sheet.check()


def test_a_walk_that_did_not_end_ends_the_pass():
    surface = build(*wheel())
    surface.sheet.lost[0] = 5
    m = len(surface.triangles)
    with pytest.raises(EndlessWalkError):
        flip_all(surface, Cost(QUALITY, 1.0), FREELY, np.ones(m, bool), np.zeros(m, bool))
    with pytest.raises(EndlessWalkError):
        move_all(surface, ODT)


def unfolded(p, t):
    """Triangles of space laid out side by side in the plane: points and cells."""
    a, b, c = (p[t[:, k]] for k in range(3))
    length = np.linalg.norm(b - a, axis=1)
    along = ((b - a) * (c - a)).sum(axis=1) / length
    height = np.linalg.norm(np.cross(b - a, c - a), axis=1) / length
    zero = np.zeros(len(t))
    flat = np.stack([np.stack(x, axis=1) for x in ((zero, zero), (length, zero), (along, height))],
                    axis=1)
    return flat.reshape(-1, 2), np.arange(3 * len(t)).reshape(-1, 3)


@pytest.mark.parametrize("objective", PLANAR,
                         ids=["radius ratio", "mean ratio", "angle", "step"])
@pytest.mark.parametrize("power", [0.5, 2.0, 8.0])
def test_derivatives_of_the_cost_are_those_of_finite_differences(power, objective):
    p, t = sm.torus(noise=0.6)
    t = t.astype(np.int32)
    stars = vertex_stars(t, len(p))
    rng = np.random.default_rng(4)
    for v in (0, 77, 301):
        e, _ = np.linalg.qr(rng.standard_normal((3, 2)))
        e = np.ascontiguousarray(e.T)
        out = np.empty(5)

        def cost(a, b, v=v, e=e):
            q = p.copy()
            q[v] += a * e[0] + b * e[1]
            star = t[stars.indices[stars.indptr[v] : stars.indptr[v + 1]]]
            return (PLANAR[objective](*unfolded(q, star)) ** -power).sum()

        around = stars.indices[stars.indptr[v] : stars.indptr[v + 1]]
        value = star_terms_2d(p, t, around, v, Cost(objective, power), e, out)
        assert value == pytest.approx(cost(0, 0), rel=1e-12)
        h = 3e-5
        first = [(cost(h, 0) - cost(-h, 0)) / 2 / h, (cost(0, h) - cost(0, -h)) / 2 / h]
        second = [
            (cost(h, 0) - 2 * value + cost(-h, 0)) / h**2,
            (cost(h, h) - cost(h, -h) - cost(-h, h) + cost(-h, -h)) / 4 / h**2,
            (cost(0, h) - 2 * value + cost(0, -h)) / h**2,
        ]
        size = max(np.abs(second))
        assert out[:2] == pytest.approx(first, rel=1e-4, abs=1e-4 * max(np.abs(first)))
        assert out[2:] == pytest.approx(second, rel=1e-3, abs=1e-3 * size)


@pytest.mark.parametrize("name", ["torus", "bowl"])
def test_compound_moves_lower_the_sum_where_single_moves_are_stuck(name):
    p, t = MESHES[name]()
    surface = build(p.copy(), t, 2e-2)
    improve(surface)
    phase = Phase(2.0, 1.0, 20, 2)
    for _ in range(4):
        finish_phase(surface, phase)
    stuck = radius_ratio(surface.points, surface.triangles)
    taken, _, _ = finish_phase(surface, replace(phase, power=4.0, rounds=0, compound=1))
    found = radius_ratio(surface.points, surface.triangles)
    assert taken > 5
    assert (found**-4.0).sum() < (stuck**-4.0).sum() - 0.03 * taken
    locked = surface.sheet.kind == LOCKED
    np.testing.assert_array_equal(surface.points[locked], p[locked])


def test_a_compound_move_that_the_guards_refuse_leaves_no_trace():
    p, t = MESHES["torus"]()
    surface = build(p.copy(), t, 2e-2)
    improve(surface, rounds=1)
    narrow = surface.guards._replace(limits=surface.guards.limits._replace(cosine=2.0))
    hindered = replace(surface, guards=narrow)
    now = (*hindered.copy(), surface.triangles, surface.sheet.neighbors,
           surface.sheet.edges.of_cell)
    before = [a.copy() for a in now]
    assert finish_phase(hindered, Phase(4.0, 1.0, 0, 2, 1))[0] == 0
    for was, a in zip(before, (*hindered.copy(), *now[-3:]), strict=True):
        np.testing.assert_array_equal(a, was)


def centres(p, star):
    """Circumcentres by the two bisector planes and the plane of each triangle."""
    found = []
    for a, b, c in p[star]:
        normal = np.cross(b - a, c - a)
        matrix = np.array([b - a, c - a, normal])
        right = [(b - a) @ (a + b) / 2, (c - a) @ (a + c) / 2, normal @ a]
        found.append(np.linalg.solve(matrix, right))
    return np.array(found)


@pytest.mark.usefixtures("kernels_in_python")
@pytest.mark.parametrize(("target", "weights"), [
    (ODT, "rho"), (CPT, "rho"), (ODT, "equal"), (CPT, "equal"), (LAPLACIAN, "equal")])
def test_the_mean_centre_of_a_star(target, weights):
    p, t = sm.torus(noise=0.6)
    surface = build(p, t)
    stars = surface.stars()
    rho = np.random.default_rng(6).uniform(0.5, 2.0, len(p))
    for v in (3, 250):
        star = t[stars.indices[stars.indptr[v] : stars.indptr[v + 1]]]
        area = np.linalg.norm(np.cross(p[star[:, 1]] - p[star[:, 0]],
                                       p[star[:, 2]] - p[star[:, 0]]), axis=1)
        w = area * rho[star].mean(axis=1) if weights == "rho" else np.ones(len(star))
        if target == LAPLACIAN:
            ring = np.setdiff1d(star, [v])
            expected = p[ring].mean(axis=0)
        else:
            c = centres(p, star) if target == ODT else p[star].mean(axis=1)
            expected = (w[:, None] * c).sum(axis=0) / w.sum()
        found = star_centre(surface.sheet, stars, v,
                            Target(target, rho, weights == "equal", 1.0, NOWHERE))
        assert p[v] + found == pytest.approx(expected, abs=1e-10)


@pytest.mark.usefixtures("kernels_in_python")
def test_an_edge_over_a_sphere_is_as_far_as_its_sagitta():
    p, t = sm.sphere(5)
    surface = build(p, t)
    ground = surface.guards.ground
    foot = surface.sheet.foot
    for b in (40, 200, 1234):
        half = np.linalg.norm(p[b] - p[0]) / 2
        if half > 0.5:
            continue
        sagitta = 1 - np.sqrt(1 - half**2)
        for factor, near in ((0.9, False), (1.1, True)):
            limit = (factor * sagitta + 1e-3 * (factor - 1)) ** 2
            assert edge_is_near(
                End(*p[0], foot[0], True), End(*p[b], foot[b], True), ground, limit) is near


def test_an_edge_between_two_lines_is_held_against_what_it_crosses():
    # the two triangles of a roof over the edge from one eave to the other
    for ridge in (0.0, 0.5):
        p = np.array([[-1.0, 0, 0], [ridge, -1, 0.1], [ridge, 1, 0.1], [1, 0, 0]])
        surface = build(p, np.array([[0, 1, 2], [3, 2, 1]]), 10.0)
        foot = surface.sheet.foot
        for factor, near in ((0.98, False), (1.02, True)):
            assert edge_is_near(
                End(*p[0], foot[0], False), End(*p[3], foot[3], False), surface.guards.ground,
                (factor * 0.1) ** 2) is near


def test_given_vectors_are_followed_as_far_as_the_guards_allow():
    p, t = sm.sphere(3)
    surface = build(p, t, 2e-2)
    axis = np.array([0.0, 0.0, 1.0])
    vectors = 0.02 * np.cross(axis, p)
    move_all(surface, GIVEN, vectors=vectors)
    turned = np.linalg.norm(surface.points - p - vectors, axis=1)
    assert np.median(turned) < 2e-3
    assert np.abs(np.linalg.norm(surface.points, axis=1) - 1).max() < 1e-2


def test_values_are_interpolated_linearly_at_the_feet():
    p, t = sm.torus(noise=0.4)
    surface = build(p, t, 1e-2)
    improve(surface, 2)
    values = p @ [1.0, -2.0, 0.5] + 3
    out = np.zeros(len(p))
    ground_values(surface.guards.ground, values, surface.points, surface.sheet.foot, out)
    assert out == pytest.approx(surface.points @ [1.0, -2.0, 0.5] + 3, abs=1e-9)


def test_threads_do_not_change_a_bit():
    p, t = sm.torus(80, 40, noise=0.7)
    alone = build(p, t, 2e-3)
    improve(alone, 2)
    with Pool(3) as pool:
        many = build(p, t, 2e-3, pool=pool, threads=3)
        improve(many, 2)
    assert np.array_equal(alone.points, many.points)
    assert np.array_equal(alone.triangles, many.triangles)
