"""Curved surfaces in a metric: what is seen is the affine image, where the surface is stays."""

from __future__ import annotations

import numpy as np
import pytest
import surface_meshes as sm

import odt_plugins
from odt_plugins.engine.cells.cost import ENERGY, Cost
from odt_plugins.engine.cells.extremes import FREELY
from odt_plugins.engine.ground.build import make_ground, make_sheet
from odt_plugins.engine.ground.features import find_features
from odt_plugins.engine.ground.position import along_line
from odt_plugins.engine.ground.sheet import LINE, Guards, Limits
from odt_plugins.engine.surface.odt import CPT, NOWHERE, ODT, Target, star_centre
from odt_plugins.engine.surface.passes import Surface, flip_all, move_all
from odt_plugins.engine.surface.rounds import surface_energy
from odt_plugins.engine.topology.star import vertex_stars
from odt_plugins.mesh.surface import surface_edges
from odt_plugins.metric.through import halved_logarithms

pytestmark = pytest.mark.usefixtures("nothing_compiled")

ROOT = np.array([[3.0, 1.0, 0.4], [1.0, 1.2, -0.1], [0.4, -0.1, 0.8]])
METRIC = ROOT @ ROOT


def build(points, cells, rows=None):
    """A surface that nothing but its own features holds, with a metric behind the coordinates."""
    cells = np.ascontiguousarray(cells, dtype=np.int32)
    edges, stars = surface_edges(cells, len(points)), vertex_stars(cells, len(points))
    found = find_features(points, cells, edges, stars, angle=40.0,
                          fixed=np.zeros(len(points), bool), slack=1e-6)
    ground = make_ground(points, cells, edges, stars, found.edges)
    sheet = make_sheet(points, cells, edges, found)
    rows = np.zeros((len(points), 0)) if rows is None else rows
    return Surface(
        sheet._replace(points=np.column_stack([points, rows])),
        Guards(ground, found.lines, Limits(1e4, 1e4, -2.0)), np.zeros(len(cells), np.int32),
        np.ascontiguousarray(rows.T))


def rows_of(points):
    return np.tile(halved_logarithms(METRIC[None]), (len(points), 1))


def tilted():
    """A jittered square in a plane that is none of the coordinates."""
    p, t = sm.bowl(12, noise=0.6)
    axes = np.linalg.qr(np.array([[1.0, 0.2, 0.5], [0.3, 1.0, -0.4], [-0.6, 0.1, 1.0]]))[0]
    return np.ascontiguousarray(p[:, :2] @ axes[:2]), t


def circumcentres(p, star):
    found = []
    for a, b, c in p[star]:
        normal = np.cross(b - a, c - a)
        right = [(b - a) @ (a + b) / 2, (c - a) @ (a + c) / 2, normal @ a]
        found.append(np.linalg.solve(np.array([b - a, c - a, normal]), right))
    return np.array(found)


def areas(p, star):
    a, b, c = (p[star[:, i]] for i in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1)


@pytest.mark.parametrize("target", [ODT, CPT])
def test_the_centre_of_a_star_in_a_constant_metric_is_that_of_the_image(target):
    p, t = sm.torus(noise=0.6)
    surface = build(p, t, rows_of(p))
    stars = surface.stars()
    for v in (3, 250):
        star = t[stars.indices[stars.indptr[v] : stars.indptr[v + 1]]]
        image = p @ ROOT
        weight = areas(image, star)
        c = p[star].mean(axis=1)
        if target == ODT:
            c = circumcentres(image, star) @ np.linalg.inv(ROOT)
        found = star_centre(surface.sheet, stars, v,
                            Target(target, np.ones(len(p)), False, 1.0, NOWHERE))
        expected = (weight[:, None] * c).sum(axis=0) / weight.sum()
        np.testing.assert_allclose(p[v] + found, expected, atol=1e-9)


def test_a_round_on_a_plane_is_that_of_the_image():
    p, t = tilted()
    seen, image = build(p, t, rows_of(p)), build(p @ ROOT, t)
    for surface in (seen, image):
        m = len(surface.triangles)
        assert flip_all(surface, Cost(ENERGY, 1.0), FREELY, np.ones(m, bool), np.zeros(m, bool))
        move_all(surface, Target(ODT, np.ones(len(p)), False, 1.0, NOWHERE), FREELY)
    assert np.array_equal(seen.triangles, image.triangles)
    np.testing.assert_allclose(seen.points[:, :3] @ ROOT, image.points, atol=1e-9)
    rho = np.ones(len(p))
    assert np.isclose(surface_energy(seen, rho), surface_energy(image, rho), rtol=1e-9)


def test_a_step_along_a_line_goes_where_the_image_goes():
    p, t = tilted()
    surface = build(p, t, rows_of(p))
    v = int(np.flatnonzero(surface.sheet.kind == LINE)[0])
    lines = surface.guards.lines
    slot = lines.slot[v]
    along = p[lines.nodes[slot + 1]] - p[lines.nodes[slot - 1]]
    step = np.array([0.3, -0.2, 0.1])
    shift = ROOT @ along / np.linalg.norm(along)
    nearest = np.linalg.lstsq(shift[:, None], ROOT @ step, rcond=None)[0][0]
    assert along_line(surface.sheet, lines, v, *step) == pytest.approx(nearest, abs=1e-12)


def test_a_moved_vertex_takes_the_metric_of_its_foot():
    p, t = sm.torus(noise=0.4)
    rows = p @ np.arange(18.0).reshape(3, 6) / 20.0
    surface = build(p, t, rows)
    move_all(surface, Target(CPT, np.ones(len(p)), False, 1.0, NOWHERE), FREELY)
    assert (surface.points[:, 3:] == rows).all()
    surface.resample()
    moved = surface.points[:, :3] @ np.arange(18.0).reshape(3, 6) / 20.0
    np.testing.assert_allclose(surface.points[:, 3:], moved, atol=1e-9)


@pytest.mark.parametrize(("points", "cells"), [sm.sphere(3, 0.2), sm.bowl(15, noise=0.8)])
def test_a_stretched_surface_becomes_as_good_as_its_twin_was(points, cells):
    back = np.linalg.inv(ROOT)
    how = {"envelope": 3e-3, "feature_angle": 100.0, "free": "layers"}
    _, twin = odt_plugins.optimize_with_report((points, cells), **how)
    (p, t), report = odt_plugins.optimize_with_report(
        (points @ back, cells), metric=lambda x: np.broadcast_to(METRIC, (len(x), 3, 3)), **how)
    image = odt_plugins.quality((p @ ROOT, t))
    before = odt_plugins.quality((points, cells))
    for name in ("mean_quality", "min_quality", "p1_quality", "min_angle", "max_angle"):
        assert np.isclose(getattr(report.after, name), getattr(image, name), atol=1e-9)
        assert np.isclose(getattr(report.before, name), getattr(before, name), atol=1e-9)
    assert image.mean_quality > twin.after.mean_quality - 0.01
    assert image.min_quality >= before.min_quality
    assert image.min_angle >= before.min_angle - 1e-9
    assert odt_plugins.quality((p, t)).mean_quality < 0.75
    assert max(report.surface["forward"], report.surface["backward"]) <= report.surface["envelope"]


def test_a_surface_that_is_stretched_stays_so_in_its_own_metric(many_threads):
    points, cells = sm.sphere(2, 0.2)
    stretch = np.array([8.0, 1.0, 1.0])
    found = [odt_plugins.optimize((points * stretch, cells), metric="input", envelope=5e-3,
                                  feature_angle=100.0, free="layers", threads=k) for k in (1, 3)]
    assert all(np.array_equal(*pair) for pair in zip(*found, strict=True))
    p, t = found[0]
    before, after = (odt_plugins.quality(m) for m in ((points, cells), (p / stretch, t)))
    assert after.mean_quality > before.mean_quality + 0.05
    assert odt_plugins.quality((p, t)).mean_quality < 0.6
