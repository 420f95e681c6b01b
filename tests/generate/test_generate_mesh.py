"""odtmesh2d: valid meshes of the whole domain, at least as good as the paper's; bad input."""

from __future__ import annotations

import math

import numpy as np
import planar_meshes as planar
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odt_plugins import InvalidOptionError
from odt_plugins.generate import (
    SAMPLES,
    dcircle,
    ddiff,
    distmesh2d,
    dpoly,
    drectangle,
    drectangle0,
    dunion,
    hgraded,
    huniform,
    odtmesh2d,
)
from odt_plugins.generate.cleanup import clean_up
from odt_plugins.generate.domain import make_domain
from odt_plugins.generate.stages import Mesh, TooCoarseError, refine

SQUARE = [[-1, -1], [1, 1]]

SEEDS = {"graded-square": 3, "crescent": 7, "pie": 1}
"""Seeds of which the median counts; with one size everywhere there is nothing random."""

AREAS = {
    "circle": math.pi,
    "ring": math.pi * (1 - 0.4**2),
    "square": 4 - math.pi * 0.4**2,
    "graded-square": 4 - math.pi * 0.4**2,
    "crescent": math.pi / 2 * (1 - 0.55**2),
    "pie": None,
}
HOLES = {"circle": 0, "ring": 1, "square": 1, "graded-square": 1, "crescent": 0, "pie": 1}


def disk(p):
    return dcircle(p, 0, 0, 1)


def boundary_edges(cells):
    edges = np.sort(cells[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    assert count.max() <= 2
    return unique, unique[count == 1]


def check_mesh(points, cells, fd, holes=None, pfix=()):
    """Valid, on the boundary, of the right topology; returns the radius ratios."""
    assert points.dtype == np.float64
    assert cells.dtype == np.int32
    assert np.array_equal(np.unique(cells), np.arange(len(points)))
    assert (planar.areas(points, cells) > 0).all()
    edges, rim = boundary_edges(cells)
    ends, count = np.unique(rim, return_counts=True)
    assert (count == 2).all()
    assert np.abs(fd(points[ends])).max() < 1e-9
    if holes is not None:
        assert len(points) - len(edges) + len(cells) == 1 - holes
    if len(pfix):
        assert np.array_equal(points[: len(pfix)], np.asarray(pfix, dtype=float))
    return planar.shape(points, cells)[0]


def uniformity(points, cells, fh):
    """std(R/h) / mean(R/h) with h at the circumcentres, written from its definition."""
    a, b, c = (points[cells[:, k]] for k in range(3))
    u, v = b - a, c - a
    uu, vv = (u * u).sum(axis=1), (v * v).sum(axis=1)
    twice = 2 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    w = np.column_stack([v[:, 1] * uu - u[:, 1] * vv, u[:, 0] * vv - v[:, 0] * uu])
    centre = w / twice[:, None]
    ratio = np.linalg.norm(centre, axis=1) / fh(a + centre)
    return ratio.std(ddof=1) / ratio.mean()


@pytest.mark.parametrize("name", SAMPLES)
def test_the_six_domains_of_table_1_are_meshed_at_least_as_well_as_in_the_paper(name):
    s = SAMPLES[name]
    found = []
    for seed in range(1, 1 + SEEDS.get(name, 1)):
        points, cells = odtmesh2d(s.fd, s.fh, s.h0, s.bbox, s.pfix, seed=seed)
        q = check_mesh(points, cells, s.fd, HOLES[name], s.pfix)
        found.append((q.min(), q.mean(), uniformity(points, cells, s.fh)))
    least, mean, even = np.median(found, axis=0)
    assert least >= s.paper[0]
    assert mean >= s.paper[1]
    assert even <= s.paper[2]
    if AREAS[name]:
        assert planar.areas(points, cells).sum() == pytest.approx(AREAS[name], rel=4e-3)


def test_edges_are_as_long_as_asked():
    points, cells = odtmesh2d(disk, huniform, 0.1, SQUARE)
    edges, _ = boundary_edges(cells)
    length = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    assert length.mean() == pytest.approx(0.1, rel=0.08)
    size = hgraded(lambda p: np.hypot(p[:, 0] - 1, p[:, 1]), 0.2, 0.5)
    points, cells = odtmesh2d(disk, size, 0.03, SQUARE)
    edges, _ = boundary_edges(cells)
    length = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    wanted = 0.03 / 0.2 * size(points[edges].mean(axis=1))
    assert np.median(length / wanted) == pytest.approx(1.0, abs=0.08)
    assert np.quantile(np.abs(np.log(length / wanted)), 0.95) < 0.25


def test_refined_meshes_cover_the_domain_and_get_better():
    stages = []
    points, cells = odtmesh2d(
        SAMPLES["ring"].fd, huniform, 0.05, SQUARE, level=2,
        watch=lambda stage, p, t: stages.append((stage, len(p), len(t))))
    q = check_mesh(points, cells, SAMPLES["ring"].fd, holes=1)
    assert [s for s, _, _ in stages] == [
        "truss", "coarse", "refinement", "smoothing", "refinement", "smoothing", "optimization",
        "clean-up"]
    assert stages[2][2] == 4 * stages[1][2]
    assert len(points) == pytest.approx(1220, rel=0.3)
    assert q.min() > 0.6
    assert q.mean() > 0.95
    exact = AREAS["ring"]
    assert planar.areas(points, cells).sum() == pytest.approx(exact, rel=4e-3)


def test_the_same_call_gives_the_same_bits_and_leaves_its_arguments_alone():
    s = SAMPLES["crescent"]
    pfix, bbox = np.array(s.pfix), np.array(s.bbox)
    kept = pfix.copy(), bbox.copy()
    one = odtmesh2d(s.fd, s.fh, 0.02, bbox, pfix)
    two = odtmesh2d(s.fd, s.fh, 0.02, bbox, pfix)
    assert all(np.array_equal(a, b) for a, b in zip(one, two, strict=True))
    assert np.array_equal(pfix, kept[0])
    assert np.array_equal(bbox, kept[1])


def test_a_coarse_mesh_that_misses_a_small_hole_is_made_finer():
    def plate(p):
        return ddiff(drectangle(p, -1, 1, -1, 1), dcircle(p, 0.31, 0.27, 0.03))

    corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]]
    starts = []
    points, cells = odtmesh2d(plate, huniform, 0.024, SQUARE, corners, watch=lambda stage, p, t:
                              starts.append(len(p)) if stage == "truss" else None)
    assert len(starts) > 1
    assert starts[-1] > 3 * starts[0]
    check_mesh(points, cells, plate, holes=1, pfix=corners)
    with pytest.raises(InvalidOptionError, match="level=5, too coarse for this domain"):
        odtmesh2d(plate, huniform, 0.024, SQUARE, corners, level=5)


def test_a_polygon_keeps_its_corners_and_interior_fixed_points():
    pv = np.array([[-0.4, -0.5], [0.4, -0.2], [0.4, -0.7], [1.5, -0.4], [0.9, 0.1], [1.6, 0.8],
                   [0.5, 0.5], [0.2, 1], [0.1, 0.4], [-0.7, 0.7]])
    fixed = np.concatenate([pv, [[0.5, 0.1], [0.0, 0.0]]])
    points, cells = odtmesh2d(lambda p: dpoly(p, pv), huniform, 0.07, [[-1, -1], [2, 1]], fixed)
    q = check_mesh(points, cells, lambda p: dpoly(p, pv), holes=0, pfix=fixed)
    x, y = pv.T
    area = 0.5 * abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
    assert planar.areas(points, cells).sum() == pytest.approx(area, rel=1e-9)
    assert q.min() > 0.3


def test_an_implicit_function_that_is_no_distance_serves_too():
    points, cells = odtmesh2d(lambda p: (p**4).sum(axis=1) - 1, huniform, 0.08, SQUARE)
    q = check_mesh(points, cells, lambda p: (p**4).sum(axis=1) - 1, holes=0)
    assert q.min() > 0.7
    exact = math.gamma(1.25) ** 2 / math.gamma(1.5) * 4
    assert planar.areas(points, cells).sum() == pytest.approx(exact, rel=2e-3)


@given(st.integers(0, 2**20))
@settings(max_examples=8, deadline=None)
def test_random_unions_and_holes_give_valid_meshes_or_a_sentence(seed):
    rng = np.random.default_rng(seed)
    disks = [(*rng.uniform(-0.5, 0.5, 2), rng.uniform(0.2, 0.5)) for _ in range(3)]
    hole = (*rng.uniform(-0.5, 0.5, 2), rng.uniform(0.05, 0.3))

    def fd(p):
        return ddiff(dunion(*(dcircle(p, *d) for d in disks)), dcircle(p, *hole))

    try:
        points, cells = odtmesh2d(fd, huniform, 0.06, SQUARE)
    except InvalidOptionError as exc:
        assert "too coarse" in str(exc)  # noqa: PT017
    else:
        check_mesh(points, cells, fd)
        grid = np.random.default_rng(1).uniform(-1, 1, (40_000, 2))
        inside = 4 * (fd(grid) < 0).mean()
        assert planar.areas(points, cells).sum() == pytest.approx(inside, abs=0.05)


def test_points_are_projected_to_the_boundary():
    domain = make_domain(lambda p: (p**2).sum(axis=1) - 1, huniform, SQUARE)
    x = np.random.default_rng(3).uniform(-0.9, 0.9, (50, 2))
    x = x[np.linalg.norm(x, axis=1) > 0.3]
    assert np.allclose(np.linalg.norm(domain.project(x), axis=1), 1, atol=1e-10)


def test_refinement_puts_new_boundary_vertices_on_the_boundary():
    turn = np.arange(12) * math.pi / 6
    points = np.concatenate([[[0, 0]], np.column_stack([np.cos(turn), np.sin(turn)])])
    cells = np.array([(0, 1 + k, 1 + (k + 1) % 12) for k in range(12)], dtype=np.int32)
    mesh = refine(Mesh(points, cells, 1), make_domain(disk, huniform, SQUARE))
    assert np.array_equal(mesh.points[0], [0, 0])
    check_mesh(mesh.points, mesh.cells, disk, holes=0)
    hexagon = np.concatenate([[0], 1 + np.arange(0, 12, 4)])
    triangle = np.array([(0, 1, 2), (0, 2, 3), (0, 3, 1)], dtype=np.int32)
    with pytest.raises(TooCoarseError, match="far from the boundary"):
        refine(Mesh(0.2 * points[hexagon], triangle, 0), make_domain(disk, huniform, SQUARE))


def test_clean_up_takes_out_vertices_of_few_triangles():
    hexagon = np.array([(math.cos(k * math.pi / 3), math.sin(k * math.pi / 3)) for k in range(6)])
    points = np.concatenate([hexagon, [[0, 0], [0.45, 0.27]]])
    cells = np.array([(6, k, (k + 1) % 6) for k in range(1, 6)]
                     + [(6, 0, 7), (0, 1, 7), (1, 6, 7)], dtype=np.int32)
    keep = np.zeros(8, dtype=bool)
    new, tri, old = clean_up(points, cells, keep)
    assert old.tolist() == [0, 1, 2, 3, 4, 5, 6]
    assert planar.shape(new, tri)[0] == pytest.approx(1.0)
    keep[7] = True
    assert len(clean_up(points, cells, keep)[0]) == 8


def test_the_truss_alone_meshes_the_circle():
    points, cells = distmesh2d(disk, huniform, 0.2, SQUARE, steps=200)
    assert (planar.areas(points, cells) > 0).all()
    assert planar.shape(points, cells)[0].mean() > 0.93
    with pytest.raises(InvalidOptionError, match="no triangle is inside"):
        distmesh2d(disk, huniform, 5.0, SQUARE)


def with_value(value, name="fd"):
    def function(p):
        out = disk(p) if name == "fd" else huniform(p)
        out[p[:, 0] > 0.5] = value
        return out

    return function


GOOD = {"fd": disk, "fh": huniform, "h0": 0.2, "bbox": SQUARE, "pfix": None}
WRONG = {
    "beyond": ({"fd": lambda p: disk(p) - 0.5},
               r"fd = -0\.5 at \(.*\) on the rim of bbox, .* beyond bbox; .* larger bbox"),
    "turned": ({"fd": lambda p: -disk(p)}, r"on the rim of bbox, .* try a larger bbox, or -fd$"),
    "positive": ({"fd": lambda p: disk(p) + 2}, r"fd without a negative value at \d+ points"),
    "fd nan": ({"fd": with_value(np.nan)}, r"got fd = nan at the point \("),
    "fd inf": ({"fd": with_value(np.inf)}, r"got fd = inf .* finite values"),
    "fd shape": ({"fd": lambda p: p}, r"got shape \(\d+, 2\) from fd"),
    "fd words": ({"fd": lambda p: "inside"}, "no array of numbers"),
    "fd none": ({"fd": None}, "got fd of type NoneType; expected a function"),
    "fh zero": ({"fh": with_value(0.0, "fh")}, r"got fh = 0\.0 at .* sizes above 0"),
    "fh nan": ({"fh": with_value(np.nan, "fh")}, "got fh = nan"),
    "fh scalar": ({"fh": lambda p: 1.0}, r"got shape \(\) from fh"),
    "h0 zero": ({"h0": 0}, "got h0=0; expected an edge length above 0"),
    "h0 nan": ({"h0": math.nan}, "got h0=nan"),
    "h0 text": ({"h0": "small"}, "got h0='small'"),
    "h0 small": ({"h0": 1e-5}, r"about 3\.6\de\+10 points, more than 10000000; try h0=0\.000"),
    "h0 large": ({"h0": 9}, "got h0=9, which gives about 0 points .* try h0="),
    "h0 coarse": ({"h0": 1.9}, "got h0=1.9, too coarse for this domain"),
    "bbox reversed": ({"bbox": [[1, 1], [-1, -1]]}, "xmin < xmax and ymin < ymax"),
    "bbox flat": ({"bbox": [-1, -1, 1, 1]}, r"bbox of shape \(4,\); expected \(2, 2\)"),
    "bbox 3-D": ({"bbox": [[0, 0, 0], [1, 1, 1]]}, r"bbox of shape \(2, 3\)"),
    "bbox nan": ({"bbox": [[-1, -1], [1, math.nan]]}, "finite numbers"),
    "pfix shape": ({"pfix": [1, 2, 3]}, r"pfix of shape \(3,\); expected \(f, 2\)"),
    "pfix outside": ({"pfix": [[0, 0], [0.8, 0.9]]},
                     r"fixed point \[0\.8, 0\.9\] at index 1 \(1 of them\)"),
    "pfix nan": ({"pfix": [[0, math.nan]]}, "expected finite coordinates"),
    "level": ({"level": -1}, "got level=-1; expected a whole number"),
    "seed": ({"seed": 0.5}, r"got seed=0\.5"),
    "most": ({"most_points": 10}, "about 90.* points, more than 10"),
}


@pytest.mark.parametrize("name", WRONG)
def test_bad_input_is_refused_in_one_sentence(name):
    wrong, sentence = WRONG[name]
    with pytest.raises(InvalidOptionError, match=sentence) as caught:
        odtmesh2d(**(GOOD | wrong))
    assert "\n" not in str(caught.value)


def test_lattices_too_large_to_choose_from_are_refused():
    size = hgraded(lambda p: np.hypot(p[:, 0], p[:, 1]), 1e-5, 0.3)
    with pytest.raises(InvalidOptionError, match=r"a lattice of .* points to choose from"):
        odtmesh2d(lambda p: drectangle0(p, -1, 1, -1, 1), size, 1e-5, SQUARE, [[0, 0]])


@pytest.mark.parametrize("h0", [0.3, 0.1, 0.05])
def test_one_fixed_point_on_a_smooth_boundary_is_a_vertex(h0):
    turn = np.linspace(0.0, 2.0 * np.pi, 7)[:-1]
    for point in np.stack([np.cos(turn), np.sin(turn)], axis=1):
        points, cells = odtmesh2d(
            lambda p: dcircle(p, 0, 0, 1), huniform, h0, [[-1, -1], [1, 1]],
            [point])
        assert np.array_equal(points[0], point)
        assert (cells == 0).any()
        assert np.linalg.norm(points[1:] - point, axis=1).min() > 0.5 * h0


def test_a_fixed_point_outside_is_told_by_its_own_index_where_others_are_repeated():
    with pytest.raises(InvalidOptionError, match=r"\[2.0, 0.0\] at index 2 \(1 of them\)"):
        odtmesh2d(lambda p: dcircle(p, 0, 0, 1), huniform, 0.2, [[-3, -3], [3, 3]],
                  [[1, 0], [1, 0], [2, 0]])
