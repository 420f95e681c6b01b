"""Whole runs on curved surfaces: the promise, options, bad input, what the report says."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, pairwise
from typing import get_args

import meshio
import numpy as np
import pytest
import surface_meshes as sm
from crossings import new_crossings
from hypothesis import given, settings
from hypothesis import strategies as st
from policies import set_policy
from scipy.spatial import cKDTree
from strategies import SEEDS

import odt_plugins
from odt_plugins.cli import main as cli
from odt_plugins.engine.record.figures import amips_energies, figures
from odt_plugins.engine.surface import driver
from odt_plugins.errors import EndlessWalkError, InvalidMeshError, InvalidOptionError
from odt_plugins.figures import angles, radius_ratio, summarize
from odt_plugins.hosts.filter_table import OBJECTIVE
from odt_plugins.mesh.surface import surface_edges, surface_mesh
from odt_plugins.objectives import AIMS, Objective

MESHES = {
    "sphere": lambda: sm.sphere(4, 0.2),
    "torus": lambda: sm.torus(60, 24, noise=0.7),
    "bowl": lambda: sm.bowl(noise=0.8),
    "cube": lambda: sm.cube(7, 0.8),
    "cylinder": lambda: sm.cylinder(noise=0.7),
}


FIGURES = ("min_quality", "p1_quality", "mean_quality", "min_angle")


def improved(mesh, envelope=1e-3, keep=FIGURES, **options):
    """The result, held against everything that every result must keep."""
    p, t = mesh
    (x, c), report = odt_plugins.optimize_with_report(mesh, envelope=envelope, keep=keep, **options)
    assert (x.dtype, c.dtype, x.shape, c.shape) == (p.dtype, t.dtype, p.shape, t.shape)
    limit = envelope * sm.diagonal(p[np.unique(t)])
    there, back = sm.two_sided(p, t, x, c, 2)
    facts = report.surface
    assert there <= facts["forward"] * (1 + 1e-9) + 1e-15
    assert back <= facts["backward"] * (1 + 1e-9) + 1e-15
    assert max(facts["forward"], facts["backward"]) <= limit * (1 + 1e-12)
    assert facts["envelope"] == pytest.approx(limit)
    assert sm.topology(c) == sm.topology(t)
    assert len(new_crossings(p, t, x, c)) == 0
    before, after = summarize(p, t), summarize(x, c)
    for name in keep:
        assert getattr(after, name) >= getattr(before, name) - 1e-12
    return x, c, report


@pytest.mark.parametrize("name", MESHES)
def test_surfaces_get_better_within_their_envelope(name):
    p, t = MESHES[name]()
    x, c, report = improved((sm.turned(p), t))
    assert radius_ratio(x, c).mean() > radius_ratio(p, t).mean() + 0.05
    assert report.fallback is None


NAMED = {
    "min_dihedral": lambda p, t: angles(p, t).min(),
    "amips": lambda p, t: -amips_energies(p, t.astype(np.int32)).mean(),
    "time_step": lambda p, t: figures(p, t.astype(np.int32)).min_altitude,
}
"""What every other objective raises."""


@pytest.mark.parametrize("make", [MESHES["sphere"], lambda: sm.torus(noise=0.6)],
                         ids=["sphere", "torus"])
def test_surfaces_take_every_objective(make):
    p, t = make()
    p = sm.turned(p)
    plain = improved((p, t))[:2]
    for objective, figure in NAMED.items():
        x, c, report = improved((p, t), objective=objective)
        assert report.fallback is None
        assert figure(x, c) > figure(*plain) > figure(p, t)


def test_objectives_of_surfaces_on_the_command_line_and_in_hosts(tmp_path):
    p, t = MESHES["bowl"]()
    assert tuple(AIMS) == get_args(Objective) == OBJECTIVE.choices
    meshio.write(tmp_path / "in.vtu", meshio.Mesh(p, [("triangle", t)]))
    files = [str(tmp_path / name) for name in ("in.vtu", "out.vtu")]
    assert cli.main(["optimize", *files, "--objective", "min_dihedral"]) == 0
    out = meshio.read(files[1])
    x, c = odt_plugins.optimize((p, t), objective="min_dihedral")
    assert np.array_equal(out.points, x)
    assert np.array_equal(out.cells[0].data, c)


def saddle(n, height):
    """A lattice of right triangles, bent."""
    g = np.linspace(0, 1, n)
    x, y = (a.ravel() for a in np.meshgrid(g, g))
    a = (np.arange(n - 1) + n * np.arange(n - 1)[:, None]).ravel()
    cells = np.concatenate([np.stack([a, a + 1, a + n + 1], 1), np.stack([a, a + n + 1, a + n], 1)])
    return np.stack([x, y, height * (x * x - y * y)], axis=1), cells.astype(np.int32)


def test_triangles_that_are_all_alike_gain_within_their_extremes():
    p, t = saddle(16, 0.3)
    x, c, report = improved((p, t))
    assert radius_ratio(p, t).mean() < 0.87
    assert radius_ratio(x, c).mean() > 0.91
    assert report.counts["repairs"] >= 1
    assert report.fallback is None


def test_where_extremes_bind_the_report_tells_what_that_costs():
    p, t = sm.cube(6, 0.0)
    x, _, report = improved((p, t))
    assert np.array_equal(x, p)
    assert "nothing better kept the promise (min_quality would be worse" in report.fallback
    assert "worse) at a mean quality of 0.9" in str(report)
    x, c, report = improved((p, t), keep=("mean_quality",))
    assert radius_ratio(x, c).mean() > 0.92
    assert report.fallback is None


def test_a_sphere_stays_round():
    p, t = sm.sphere(4, 0.2)
    x, _, _ = improved((p, t))
    # the vertices lie on the facets of the input, whose own depth is that of their sagitta
    depth = 1 - sm.distances(np.zeros((1, 3)), p, t)[0]
    radius = np.linalg.norm(x, axis=1)
    assert radius.max() <= 1 + 1e-12
    assert radius.min() >= 1 - depth - 1e-12


def test_sharp_edges_and_corners_stay_exactly():
    p, t = sm.cube(7, 0.8)
    x, c, report = improved((p, t))
    assert report.surface["corners"] == 8
    assert report.surface["feature_edges"] == 84
    assert report.surface["on_lines"] == 72
    assert max(sm.two_sided(p, t, x, c, 2)) < 1e-12
    p, t = sm.cylinder(noise=0.7)
    x, c, report = improved((p, t))
    rim = (np.abs(np.hypot(p[:, 0], p[:, 1]) - 1) < 1e-12) & np.isin(p[:, 2], (0.0, 2.0))
    assert np.array_equal(x[rim], p[rim])
    assert report.surface["feature_edges"] == 64
    assert (np.isin(p[:, 2], (0.0, 2.0)) <= (np.abs(x[:, 2] - p[:, 2]) < 1e-12)).all()


def test_an_open_surface_keeps_its_rim_and_a_mechanical_part_its_edges():
    p, t = sm.bowl(noise=0.8)
    x, _, _ = improved((p, t))
    rim = np.unique([v for e, d in sm.edge_set(t).items() if d == 1 for v in e])
    assert np.array_equal(x[rim], p[rim])
    p, t = sm.cube(6, 0.7)
    q, u = sm.cylinder(36, 8, 4, noise=0.7)
    part = np.concatenate([p, 0.3 * q + [0.5, 0.5, 1.5]])
    mesh = (part, np.concatenate([t, u + len(p)]))
    _, _, report = improved(mesh)
    assert report.surface["feature_edges"] == 12 * 6 + 2 * 36
    assert report.after.p1_quality > report.before.p1_quality + 0.1


def test_surfaces_whose_triangles_fold_stay_in_their_envelope():
    p, t = sm.sphere(3, 0.4)
    _, _, report = improved((p, t))
    assert report.fallback.startswith("some vertices stay where they are, since a run")
    assert report.after.mean_quality > report.before.mean_quality + 0.02


def test_flat_triangles_are_improved():
    p, t = sm.sphere(4, 0.1)
    worst = int(np.argmin(radius_ratio(p, t)))
    a, b, c = t[worst]
    p[a] = 0.5 * (p[b] + p[c])
    assert radius_ratio(p, t).min() < 1e-12
    _, _, report = improved((p, t), 2e-3)
    assert report.before.min_quality < 1e-12
    assert report.after.min_quality > 0.3
    p, t = sm.bowl(15, noise=0.3)
    p[7 * 15 + 7] = p[7 * 15 + 8]
    _, _, report = improved((p, t), 2e-3)
    assert report.after.min_quality > 0.1


@pytest.mark.parametrize("options", [
    {"method": "cpt"}, {"method": "laplacian"},
    {"smoothing": {"solver": "jacobi"}}, {"smoothing": {"solver": "global"}},
    {"method": "cpt", "smoothing": {"solver": "global", "linear_solver": "amg"}},
    {"density": "uniform"},
    {"density": "curvature"}, {"density": "inverse-volume"}, {"smoothing": {"exponent": 2.0}},
    {"smoothing": {"omega": 1.5}},
    {"density": lambda x: np.exp(x[:, 2])}, {"smoothing": {"cycles": 2}}, {"finish": False},
    {"smoothing": {"connectivity": "none"}}, {"threads": 3}, {"keep": ()}, {"boundary": "slide"},
], ids=lambda o: "-".join(map(str, o)) or "nothing")
def test_options(options, many_threads):
    p, t = sm.torus(24, 10, noise=0.5)
    _, c, report = improved((p, t), 6e-3, **options)
    assert report.after.mean_quality > report.before.mean_quality + 0.03
    if options.get("smoothing") == {"connectivity": "none"}:
        assert np.array_equal(c, t)


def test_smoothing_alone_lowers_the_energy_and_keeps_every_triangle():
    p, t = sm.torus(60, 24, noise=0.5)
    _, c, report = improved((p, t), 3e-3, finish=False,
                            smoothing={"rounds": 5, "connectivity": "none"})
    energy = [e for _, e in report.energy]
    assert len(energy) == 5
    assert energy == sorted(energy, reverse=True)
    assert np.array_equal(c, t)


def test_the_global_step_lowers_the_energy_like_many_sweeps():
    p, t = sm.sphere(4, 0.15)
    mesh = (p, t)
    ends = {}
    for solver in ("gauss-seidel", "global"):
        _, report = odt_plugins.optimize_with_report(
            mesh, smoothing={"solver": solver}, finish=False, keep=(), envelope=1e-2,
            density="uniform")
        ends[solver] = report.energy[-1][1] / report.energy[0][1]
        assert report.energy[-1][1] < report.energy[0][1]
    assert ends["global"] < 1.0


@pytest.mark.parametrize("linear_solver", ["direct", "amg"])
def test_the_global_step_bears_a_vertex_among_flat_triangles(linear_solver):
    p, t = sm.sheet(8, lambda x, y: 0.3 * np.sin(x) + 0.2 * np.cos(y))
    v = int(np.bincount(t.ravel()).argmax())
    around = np.setdiff1d(t[(t == v).any(axis=1)], v)
    p[around] = p[around[0]]
    _, _, report = improved(
        (p, t), smoothing={"solver": "global", "linear_solver": linear_solver}, boundary="fixed")
    assert report.after.mean_quality > report.before.mean_quality + 0.01


@pytest.mark.parametrize("kind", ["vertices", "cells", "function"])
def test_a_density_of_any_form_grades_the_surface(kind):
    p, t = sm.sphere(3)
    rho = {"vertices": np.exp(3 * p[:, 2]), "cells": np.exp(3 * p[t].mean(axis=1)[:, 2]),
           "function": lambda x: np.exp(3 * x[:, 2])}[kind]
    x, c, _ = improved((p, t), 5e-3, density=rho, smoothing={"rounds": 60}, keep=())
    area = np.linalg.norm(np.cross(x[c[:, 1]] - x[c[:, 0]], x[c[:, 2]] - x[c[:, 0]]), axis=1)
    high = x[c].mean(axis=1)[:, 2] > 0.6
    low = x[c].mean(axis=1)[:, 2] < -0.6
    assert area[high].mean() < 0.75 * area[low].mean()


def test_curvature_puts_triangles_where_the_surface_bends():
    p, t = sm.torus(80, 32)
    x, c, _ = improved((p, t), 5e-3, density="curvature", smoothing={"rounds": 60}, keep=())
    area = np.linalg.norm(np.cross(x[c[:, 1]] - x[c[:, 0]], x[c[:, 2]] - x[c[:, 0]]), axis=1)
    flat = np.abs(x[c].mean(axis=1)[:, 2]) > 0.37
    assert area[~flat].mean() < area[flat].mean()


def test_fixed_vertices_selections_and_labels_stay():
    p, t = sm.torus(60, 24, noise=0.6)
    x, _, _ = improved((p, t), fixed=np.arange(0, len(p), 5))
    assert np.array_equal(x[::5], p[::5])
    chosen = p[t].mean(axis=1)[:, 0] > 0
    x, c, report = improved((p, t), selection=chosen)
    assert report.fallback is None
    assert report.after.mean_quality > report.before.mean_quality + 0.03
    assert {tuple(r) for r in t[~chosen].tolist()} <= {tuple(r) for r in c.tolist()}
    assert np.array_equal(x[t[~chosen]], p[t[~chosen]])
    label = (p[t].mean(axis=1)[:, 1] > 0).astype(int)
    (x, c, new), _ = odt_plugins.optimize_with_report((p, t, label))

    def border(cells, labels):
        owners = {}
        for cell, mark in zip(cells.tolist(), labels.tolist(), strict=True):
            for i in range(3):
                owners.setdefault(frozenset((cell[i], cell[i - 1])), set()).add(mark)
        return {e for e, marks in owners.items() if len(marks) == 2}

    assert border(c, new) == border(t, label)
    assert sorted(new) == sorted(label)


def test_marked_edges_are_kept():
    pyvista = pytest.importorskip("pyvista")
    p, t = sm.sphere(3, 0.15)
    line = [0, *t[np.isin(t, 0).any(axis=1)][0][1:2].tolist()]
    mesh = pyvista.PolyData.from_regular_faces(p, t)
    mesh.lines = [2, *line]
    out = odt_plugins.optimize(mesh, envelope=5e-3)
    assert tuple(sorted(line)) in sm.edge_set(out.regular_faces)
    assert out.lines.tolist() == [2, *line]


def test_single_precision_coordinates_keep_the_promise():
    p, t = sm.torus(60, 24, noise=0.6)
    x, _, report = improved((p.astype(np.float32), t.astype(np.int64)))
    assert x.dtype == np.float32
    assert report.after.mean_quality > report.before.mean_quality + 0.05


def test_scale_place_and_threads_do_not_matter(many_threads):
    p, t = sm.torus(60, 24, noise=0.6)
    x, c = odt_plugins.optimize((p, t))
    y, d = odt_plugins.optimize((p * 1024.0, t), threads=4)
    assert np.array_equal(c, d)
    assert np.array_equal(x * 1024.0, y)
    z, e = odt_plugins.optimize((p * 1e-12 + 3e-10, t))
    assert radius_ratio(z, e).mean() == pytest.approx(radius_ratio(x, c).mean(), abs=5e-3)


def test_sheets_that_meet_stay_joined():
    p, t = sm.cube(5, 0.6)
    top = np.flatnonzero((p[:, 2] == 1) & (p[:, 1] == 1))
    top = top[np.argsort(p[top, 0])]
    n = len(p)
    q = np.concatenate([p, p[top] + [0, 0.1, 0.15], p[top] + [0, 0.3, 0.3]])
    rows = [top, n + np.arange(len(top)), n + len(top) + np.arange(len(top))]
    wing = []
    for low, high in pairwise(rows):
        for i in range(len(top) - 1):
            wing += [(low[i], low[i + 1], high[i]), (low[i + 1], high[i + 1], high[i])]
    _, c, report = improved((q, np.concatenate([t, wing])))
    degree = sm.edge_set(c)
    assert sum(d == 3 for d in degree.values()) == 5
    assert report.after.mean_quality > report.before.mean_quality


def pages(count, seed, k=5, width=3):
    """Strips of triangles that meet in a line, each oriented either way."""
    rng = np.random.default_rng(seed)
    points = [np.stack([0 * np.arange(k), 0 * np.arange(k), np.arange(k)], axis=1)]
    cells = []
    for page in range(count):
        angle = 2 * np.pi * (page + 0.2 * rng.uniform()) / count
        out = np.arange(1, width + 1)[:, None] + rng.uniform(-0.2, 0.2, (width, k))
        up = np.arange(k) + rng.uniform(-0.2, 0.2, (width, k))
        new = np.stack([np.cos(angle) * out, np.sin(angle) * out, up], axis=2)
        number = sum(map(len, points)) + np.arange(width * k).reshape(width, k)
        number = np.concatenate([np.arange(k)[None], number])
        a, b, c, d = (x.ravel() for x in (number[:-1, :-1], number[:-1, 1:], number[1:, :-1],
                                          number[1:, 1:]))
        strip = np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])
        cells.append(strip[:, :: rng.choice([1, -1])])
        points.append(new.reshape(-1, 3))
    return np.concatenate(points).astype(float), np.concatenate(cells)


@settings(max_examples=10)
@given(SEEDS, st.integers(3, 5), st.booleans())
def test_a_selection_may_leave_any_of_the_triangles_that_meet_in_an_edge(seed, count, whole):
    p, t = pages(count, seed)
    rng = np.random.default_rng(seed)
    page = np.arange(len(t)) * count // len(t)
    chosen = rng.permutation(count)[page] < 2 if whole else rng.random(len(t)) < 0.7
    x, c, report = improved((p, t), selection=chosen)
    assert sm.edge_set(c)[0, 1] == count
    assert {tuple(r) for r in t[~chosen].tolist()} <= {tuple(r) for r in c.tolist()}
    assert np.array_equal(x[t[~chosen]], p[t[~chosen]])
    if whole:
        assert report.after.mean_quality > report.before.mean_quality
        assert report.fallback is None


def test_two_triangles_of_three_that_run_the_same_way_through_an_edge():
    points = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0.5], [-0.5, 0.9, 0.5], [-0.5, -0.9, 0.5],
                       [0.6, 0.5, -0.8]])
    cells = np.array([[0, 2, 5], [0, 1, 2], [0, 1, 3], [1, 0, 4]])
    x, c, _ = improved((points, cells), selection=np.array([0, 1, 2]))
    assert np.array_equal(x, points)
    assert np.array_equal(c, cells)


def test_a_walk_that_does_not_end_names_the_callers_vertex(monkeypatch):
    points = np.array([[9, 9, 9], [0, 0, 0], [0, 0, 1], [1, 0, 0.5], [-0.5, 0.9, 0.5],
                       [-0.5, -0.9, 0.5], [0.6, 0.5, -0.8]])
    cells = np.array([[0, 2, 5], [0, 1, 2], [0, 1, 3], [1, 0, 4]]) + 1
    monkeypatch.setattr(driver, "_inner_edges", lambda mesh, frame, triangles: surface_edges(
        triangles, len(frame.vertices)))
    with pytest.raises(EndlessWalkError, match="around vertex 1 "):
        odt_plugins.optimize((points, cells), selection=np.array([0, 1, 2]))


def test_fans_that_meet_in_a_vertex_stay_joined():
    p, t = sm.sphere(3, 0.15)
    q = np.concatenate([p, 2 * p[0] - p[1:]])
    other = np.where(t == 0, 0, t + len(p) - 1)[:, [0, 2, 1]]
    x, c, _ = improved((q, np.concatenate([t, other])))
    assert np.array_equal(x[0], p[0])
    assert np.isin(c, 0).any()


def test_unused_vertices_stay_where_they_are():
    p, t = sm.sphere(3, 0.15)
    q = np.concatenate([p, [[9.0, 9, 9]]])
    x, _, _ = improved((q, t))
    assert np.array_equal(x[-1], q[-1])


def test_orientation_is_put_right_on_demand_only():
    p, t = sm.torus(30, 12, noise=0.4)
    mixed = t.copy()
    mixed[::7] = t[::7][:, [0, 2, 1]]
    with pytest.raises(InvalidMeshError, match=r"disagree about the outside.*repair='orient'"):
        odt_plugins.optimize((p, mixed))
    (_, c), _ = odt_plugins.optimize_with_report((p, mixed), repair="orient")
    assert sm.topology(c) == sm.topology(t)
    points, strip = sm.moebius()
    _, report = odt_plugins.optimize_with_report((points, strip), repair="orient")
    assert "disagree about the outside" in str(report)
    assert "and stay there; try removing them" in str(report)
    strip[::7] = strip[::7, [0, 2, 1]]
    with pytest.raises(InvalidMeshError, match="Moebius strip, non-orientable; expected two sides"):
        odt_plugins.optimize((points, strip), repair="orient")


@pytest.mark.parametrize(("options", "message"), [
    ({"envelope": 0.0}, r"envelope=0\.0; expected a part of the diagonal"),
    ({"envelope": -1e-3}, "envelope=-0.001"),
    ({"envelope": float("nan")}, "envelope=nan"),
    ({"feature_angle": 0}, "feature_angle=0"),
    ({"smoothing": {"solver": "lbfgs"}},
     r"smoothing={'solver': 'lbfgs'} for a curved surface; expected one of"),
    ({"method": "cvt"}, r"method='cvt' for a curved surface"),
    ({"smoothing": {"connectivity": "delaunay"}},
     r"smoothing={'connectivity': 'delaunay'} for a curved surface"),
    ({"density": "curved"}, "density='curved'"),
    ({"density": np.ones(7)}, r"density of shape \(7,\)"),
    ({"density": -1.0 * np.ones(642)}, r"density -1\.0 at index 0"),
])
def test_options_that_make_no_sense_on_a_surface(options, message):
    with pytest.raises(InvalidOptionError, match=message):
        odt_plugins.optimize(sm.sphere(3), **options)


def test_rims_and_lines_slide_on_demand():
    p, t = sm.cylinder(60, 14, 6, noise=0.6)
    rim = (np.abs(np.hypot(p[:, 0], p[:, 1]) - 1) < 1e-12) & np.isin(p[:, 2], (0.0, 2.0))
    turn = np.arctan2(p[rim, 1], p[rim, 0])
    turn += 0.4 * 2 * np.pi / 60 * np.sin(5 * turn)
    p[rim, :2] = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    still, _, fixed = improved((p, t), 3e-3)
    x, _, slid = improved((p, t), 3e-3, boundary="slide")
    assert np.array_equal(still[rim], p[rim])
    assert (x[rim] != p[rim]).any(axis=1).sum() > 40
    assert np.array_equal(x[rim, 2], p[rim, 2])
    assert slid.surface["on_lines"] > 40
    assert fixed.after.mean_quality > 0.97
    better, worse = (np.array([r.after.mean_quality, r.after.p1_quality, r.after.min_quality])
                     for r in (slid, fixed))
    assert (better > worse - [1e-3, 0.0, 0.0]).all()
    assert (better - worse) @ [1.0, 0.5, 0.25] > 0.0


def test_nothing_to_do():
    p, t = sm.sphere(2)
    (x, c), report = odt_plugins.optimize_with_report((p, t), selection=[])
    assert np.array_equal(x, p)
    assert np.array_equal(c, t)
    assert report.stop_reason == "no triangle may change"
    (x, c), report = odt_plugins.optimize_with_report((p, t), fixed=np.arange(len(p)))
    assert np.array_equal(x, p)


def globe(around=30, along=30):
    """A sphere of meridians and parallels: thin triangles at its poles."""
    turn = 2 * np.pi * np.arange(around) / around
    tilt = np.pi * np.arange(1, along - 1) / (along - 1)
    ring = np.stack([np.outer(np.sin(tilt), np.cos(turn)), np.outer(np.sin(tilt), np.sin(turn)),
                     np.outer(np.cos(tilt), np.ones(around))], axis=2)
    n = (along - 2) * around
    rows = sm.grid(around, along - 2, wrap_u=True) % (along - 2) * around + (
        sm.grid(around, along - 2, wrap_u=True) // (along - 2))
    i = np.arange(around)
    caps = [np.stack([np.full(around, n), i, (i + 1) % around], axis=1),
            np.stack([np.full(around, n + 1), n - around + (i + 1) % around, n - around + i],
                     axis=1)]
    points = np.concatenate([ring.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    return points, np.concatenate([rows[:, ::-1], *caps])


def test_a_few_triangles_beyond_the_extremes_of_the_input_are_left_alone(monkeypatch):
    mesh = globe()
    before = summarize(*mesh)
    (x, c), report = odt_plugins.optimize_with_report(mesh)
    assert angles(x, c).max() <= before.max_angle + 1e-9
    assert max(sm.two_sided(*mesh, x, c, 2)) <= 1e-3 * sm.diagonal(mesh[0])
    reached = report.after.mean_quality
    assert reached > before.mean_quality + 0.15
    set_policy(monkeypatch, driver, surface_spoiled=0.0)
    _, without = odt_plugins.optimize_with_report(mesh)
    assert reached > without.after.mean_quality + 0.02


def test_the_schedule_leaves_local_minima(monkeypatch):
    mesh = MESHES["torus"]()
    reached = odt_plugins.optimize_with_report(mesh, envelope=3e-3)[1].after
    monkeypatch.setattr(driver, "COMPOUND", replace(driver.COMPOUND, compound=0))
    single = odt_plugins.optimize_with_report(mesh, envelope=3e-3)[1].after
    assert reached.mean_quality > single.mean_quality + 0.008
    assert reached.p1_quality > single.p1_quality + 0.01


def test_a_state_that_breaks_the_promise_is_never_returned(monkeypatch):
    p, t = sm.sphere(3, 0.15)
    set_policy(monkeypatch, driver, surface_guard=3.0, surface_attempts=1)
    x, c, report = improved((p, t), 2e-4)
    assert np.array_equal(x, p)
    assert np.array_equal(c, t)
    assert "beyond the envelope" in report.fallback
    assert report.surface["forward"] == 0.0


def test_the_report_tells_of_features_distances_and_what_binds():
    p, t = sm.cube(6, 0.7)
    _, _, report = improved((p, t))
    text = str(report)
    assert "72 edges with 8 corners; 60 vertices slide along them, 8 are held" in text
    assert "to the input" in text
    assert report.to_dict()["surface"]["corners"] == 8
    assert report.n_movable == len(p) - 8
    reasons = {cell.reason for cell in report.binding}
    assert any("within the envelope" in r or "are held" in r for r in reasons)


def test_measure_takes_curved_surfaces():
    p, t = sm.sphere(3, 0.2)
    found = odt_plugins.quality((p, t))
    assert found.mean_quality == pytest.approx(radius_ratio(p, t).mean())
    assert found.min_angle == pytest.approx(angles(p, t).min())
    assert found.dim == 2


def test_progress_is_told():
    told = []
    odt_plugins.optimize(sm.sphere(3, 0.2), progress=lambda *a: told.append(a))
    assert told[-1] == ("finishing", 1.0)
    assert {stage for stage, _ in told} == {"preparing", "smoothing", "finishing"}


def test_progress_never_goes_back_when_a_run_is_repeated():
    told = []
    _, report = odt_plugins.optimize_with_report(
        sm.sphere(3, 0.4), progress=lambda *a: told.append(a))
    assert report.fallback.startswith("some vertices stay where they are, since a run")
    shares = [share for _, share in told]
    assert shares == sorted(shares)
    assert shares[0] < 0.1
    assert shares[-1] == 1.0


def test_a_run_is_a_pure_function():
    p, t = sm.sphere(3, 0.2)
    mesh = surface_mesh(p, t)
    options = odt_plugins.Options()
    first, second = driver.run_surface(mesh, options), driver.run_surface(mesh, options)
    assert np.array_equal(first.points, second.points)
    assert np.array_equal(first.cells, second.cells)
    assert np.array_equal(mesh.points, p)


def is_drawn(points, edges, a, b):
    """Whether the segment ab is a path of edges of a mesh."""
    along = (points - a) @ (b - a) / ((b - a) @ (b - a))
    off = np.linalg.norm(points - a - along[:, None] * (b - a), axis=1)
    on = np.flatnonzero((off < 1e-12) & (along > -1e-12) & (along < 1 + 1e-12))
    place = np.round(along[on], 9)
    steps = {frozenset((u, v)) for u, v in pairwise(np.unique(place).tolist())}
    at = dict(zip(on.tolist(), place.tolist(), strict=True))
    drawn = {frozenset((at[i], at[j])) for i, j in edges if i in at and j in at}
    return {place.min(), place.max()} == {0.0, 1.0} and steps <= drawn


def test_a_block_with_a_hole_keeps_its_edges_corners_faces_and_genus():
    pymeshlab = pytest.importorskip("pymeshlab")
    meshes = pymeshlab.MeshSet()
    zero = pymeshlab.PureValue(0)
    meshes.create_cube(size=2.0)
    meshes.meshing_surface_subdivision_midpoint(iterations=2, threshold=zero)
    meshes.create_cone(r0=0.5, r1=0.5, h=4, subdiv=24)
    meshes.generate_boolean_difference(first_mesh=0, second_mesh=1)
    meshes.meshing_surface_subdivision_midpoint(iterations=1, threshold=zero)
    p, t = meshes.current_mesh().vertex_matrix(), meshes.current_mesh().face_matrix()
    assert sm.topology(t)[0] == 0
    x, c, report = improved((p, t), envelope=5e-3)
    assert report.after.mean_quality > report.before.mean_quality + 0.1
    flat = np.abs(np.abs(p) - 1.0) < 1e-12
    # corners of the block, and of the two circles; of several at the same place one stays
    stays = (flat.sum(axis=1) == 3) | ((flat.sum(axis=1) == 1) & (
        np.abs(np.hypot(p[:, 0], p[:, 2]) - 0.5) < 1e-9) & flat[:, 1])
    assert (flat.sum(axis=1) == 3).sum() == 8
    assert stays.sum() >= 8 + 2 * 24
    assert cKDTree(x).query(p[stays])[0].max() < 1e-15
    assert np.abs(x[flat] - p[flat]).max() < 1e-12
    corners = np.array([[i, j, k] for i in (-1.0, 1) for j in (-1.0, 1) for k in (-1.0, 1)])
    block = [(a, b) for a, b in combinations(corners, 2) if (a != b).sum() == 1]
    turn = 2 * np.pi * np.arange(25) / 24
    circles = [np.stack([0.5 * np.cos(turn), np.full(25, y), 0.5 * np.sin(turn)], axis=1)
               for y in (-1.0, 1.0)]
    edges = sm.edge_set(c)
    assert all(is_drawn(x, edges, a, b) for a, b in block)
    assert all(is_drawn(x, edges, a, b) for circle in circles for a, b in pairwise(circle))
