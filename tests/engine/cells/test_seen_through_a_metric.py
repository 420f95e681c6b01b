"""Measures in a metric: those of the affine image, with derivatives by finite differences."""

import itertools

import numpy as np
import pytest

from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.cells.measures import MEASURES, make_room, star_terms, star_terms_2d
from odt_plugins.engine.cells.sphere import circumsphere, inside_sphere
from odt_plugins.engine.moves.newton2d import newton_vertex_2d
from odt_plugins.engine.moves.newton3d import newton_vertex
from odt_plugins.engine.odt.sweeps import gauss_seidel_sweep
from odt_plugins.engine.odt.total_energy import total_energy
from odt_plugins.engine.record.figures import cell_shapes
from odt_plugins.engine.topology.stencil import make_topology
from odt_plugins.mesh.seen import as_seen, in_unit
from odt_plugins.metric.through import halved_logarithms

pytestmark = pytest.mark.usefixtures("nothing_compiled")

TETS = np.array([[0, 1, 2, 3], [0, 2, 1, 4]], dtype=np.int32)
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)


def root(rng, d):
    """A random symmetric positive definite matrix, stretched by up to e^3."""
    axes = np.linalg.qr(rng.normal(size=(d, d)))[0]
    return axes @ np.diag(np.exp(rng.uniform(-1.5, 1.5, d))) @ axes.T


def rows_of(s, n):
    return np.tile(halved_logarithms((s @ s)[None]), (n, 1))


def tets(rng):
    points = rng.normal(size=(5, 3))
    cells = TETS.copy()
    for c in cells:
        if np.linalg.det(points[c[1:]] - points[c[0]]) < 0:
            c[[1, 3]] = c[[3, 1]]
    return points, cells


def triangles(d):
    points = np.zeros((4, d))
    points[:, :2] = [[0.1, -0.1], [2, 0.2], [0.3, 2.2], [-1.4, -0.1]]
    if d == 3:
        points[1:, 2] = [0.3, -0.2, 0.1]
    return points, TRIANGLES


def central(f, x, directions, h=1e-5):
    return np.array([(f(x + h * e) - f(x - h * e)) / (2 * h) for e in directions])


@pytest.mark.parametrize("kind", ["tets", "plane", "surface"])
def test_shapes_in_a_constant_metric_are_those_of_the_image(kind):
    rng = np.random.default_rng(3)
    points, cells = tets(rng) if kind == "tets" else triangles(2 if kind == "plane" else 3)
    s = root(rng, points.shape[1])
    seen = np.column_stack([points, rows_of(s, len(points))])
    image = np.ascontiguousarray(points @ s)
    np.testing.assert_allclose(cell_shapes(seen, cells), cell_shapes(image, cells), atol=1e-12)
    exploded = as_seen(points, cells, rows_of(s, len(points)))
    np.testing.assert_allclose(cell_shapes(*exploded), cell_shapes(image, cells), atol=1e-12)


@pytest.mark.parametrize("objective", MEASURES.values())
def test_derivatives_of_a_star_of_tetrahedra(objective):
    rng = np.random.default_rng(5)
    points, cells = tets(rng)
    rows = rows_of(root(rng, 3), 5) * (1 + 0.3 * rng.normal(size=(5, 1)))
    room, star = make_room(), np.array([0, 1], dtype=np.int32)

    def terms(x):
        moved = np.column_stack([points, rows])
        moved[0, :3] = x
        assert star_terms(moved, cells, star, 0, 2, 0, Cost(objective, 2.0), room)
        return room.star.copy()

    found = terms(points[0])
    slope = central(lambda x: terms(x)[0], points[0], np.eye(3))
    bend = central(lambda x: terms(x)[1:4], points[0], np.eye(3))
    xx, xy, xz, yy, yz, zz = found[4:]
    np.testing.assert_allclose(found[1:4], slope, rtol=1e-6, atol=1e-6 * np.abs(slope).max())
    np.testing.assert_allclose([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], bend,
                               atol=1e-6 * np.abs(bend).max())


@pytest.mark.parametrize("objective", MEASURES.values())
@pytest.mark.parametrize("d", [2, 3])
def test_derivatives_of_a_star_of_triangles(objective, d):
    rng = np.random.default_rng(7)
    points, cells = triangles(d)
    rows = rows_of(root(rng, d), 4) * (1 + 0.3 * rng.normal(size=(4, 1)))
    axes = np.eye(2) if d == 2 else np.ascontiguousarray(np.linalg.qr(rng.normal(size=(3, 2)))[0].T)
    star, out = np.array([0, 1], dtype=np.int32), np.empty(5)

    def terms(x):
        moved = np.column_stack([points, rows])
        moved[0, :d] = x
        value = star_terms_2d(moved, cells, star, 0, Cost(objective, 2.0), axes, out)
        return np.array([value, *out])

    found = terms(points[0])
    slope = central(lambda x: terms(x)[0], points[0], axes)
    bend = central(lambda x: terms(x)[1:3], points[0], axes)
    np.testing.assert_allclose(found[1:3], slope, atol=1e-6 * np.abs(slope).max())
    np.testing.assert_allclose([[found[3], found[4]], [found[4], found[5]]], bend,
                               atol=1e-6 * np.abs(bend).max())


def test_the_sphere_is_that_of_the_image():
    rng = np.random.default_rng(9)
    points, cells = tets(rng)
    s = root(rng, 3)
    seen = np.column_stack([points, rows_of(s, 5)])
    image = np.ascontiguousarray(points @ s)
    for x in rng.normal(size=(40, 3)):
        seen[4, :3], image[4] = x, x @ s
        told = [inside_sphere(p, cells, 0, 4, *circumsphere(p, *cells[0])) for p in (seen, image)]
        assert told[0] == told[1]


@pytest.mark.parametrize("d", [2, 3])
def test_a_sweep_and_its_energy_are_those_of_the_image(d):
    from scipy.spatial import Delaunay

    rng = np.random.default_rng(11)
    points = rng.random((60, d))
    s = root(rng, d)
    image = np.ascontiguousarray(points @ s)
    cells = Delaunay(image).simplices.astype(np.int32)
    e = image[cells[:, 1:]] - image[cells[:, :1]]
    volume = np.linalg.det(e)
    cells = cells[np.abs(volume) > 1e-6 * np.abs(volume).max()]
    swap = np.linalg.det(image[cells[:, 1:]] - image[cells[:, :1]]) < 0
    cells[swap] = cells[swap][:, [1, 0, *range(2, d + 1)]]
    movable = np.zeros(60, dtype=bool)
    movable[: 20] = True
    boundary = ~movable
    seen = np.column_stack([points, rows_of(s, 60)])
    topology = make_topology(cells, movable, boundary)
    moved, _ = gauss_seidel_sweep(seen, topology)
    there, _ = gauss_seidel_sweep(image, topology)
    np.testing.assert_allclose(moved[:, :d] @ s, there, atol=1e-10)
    assert (moved[:, d:] == seen[:, d:]).all()
    rho = np.ones(60)
    assert np.isclose(total_energy(seen, cells, rho), total_energy(image, cells, rho), rtol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_a_vertex_moves_to_the_mean_of_centres_weighted_by_matrices(d):
    """Of a star whose vertices have metrics of their own; centres by linear equations."""
    from scipy.linalg import expm, logm

    rng = np.random.default_rng(17)
    points = np.vstack([np.full(d, 0.04), np.eye(d), -np.eye(d)])
    other = [np.arange(1, d + 1) + d * np.array(side) for side in np.ndindex((2,) * d)]
    cells = np.array([[0, *row] for row in other], dtype=np.int32)
    swap = np.linalg.det(points[cells[:, 1:]] - points[0]) < 0
    cells[swap] = cells[swap][:, [1, 0, *range(2, d + 1)]]
    roots = [root(rng, d) for _ in points]
    rows = np.vstack([rows_of(s, 1) for s in roots])
    logs = [logm(s) for s in roots]
    total, pull = np.zeros((d, d)), np.zeros(d)
    for cell in cells:
        s = expm((sum(logs[v] for v in cell) + logs[0]) / (d + 2))
        e = (points[cell[1:]] - points[cell[0]]) @ s
        centre = points[cell[0]] + np.linalg.solve(s, np.linalg.solve(2 * e, (e * e).sum(axis=1)))
        weight = abs(np.linalg.det(e)) * s @ s
        total, pull = total + weight, pull + weight @ (centre - points[0])
    movable = np.arange(len(points)) == 0
    topology = make_topology(cells, movable, np.zeros(len(points), dtype=bool))
    moved, stats = gauss_seidel_sweep(np.column_stack([points, rows]), topology, omega=0.01)
    assert stats.reduced == 0
    step = moved[0, :d] - points[0]
    np.testing.assert_allclose(step, 0.01 * np.linalg.solve(total, pull), rtol=1e-9)


def star_of_the_best_lattice(d):
    """A vertex and its cells in the lattice of equilateral triangles, or the body-centred one."""
    from scipy.spatial import Delaunay

    axes = np.array([[1, 0], [0.5, 0.75**0.5]] if d == 2 else [[-1, 1, 1], [1, -1, 1], [1, 1, -1]])
    points = np.array(list(itertools.product(range(-2, 3), repeat=d))) @ axes
    points = points[np.argsort(np.linalg.norm(points, axis=1), kind="stable")]
    shaken = points + 1e-9 * np.random.default_rng(1).normal(size=points.shape)
    cells = Delaunay(shaken).simplices.astype(np.int32)
    cells = cells[(cells == 0).any(axis=1)]
    swap = np.linalg.det(points[cells[:, 1:]] - points[cells[:, :1]]) < 0
    cells[swap] = cells[swap][:, [1, 0, *range(2, d + 1)]]
    used, cells = np.unique(cells, return_inverse=True)
    return points[used], cells.reshape(-1, d + 1).astype(np.int32)


@pytest.mark.parametrize("kind", ["one length", "all lengths", "axes"])
@pytest.mark.parametrize("d", [2, 3])
def test_a_vertex_between_cells_of_their_sizes_stays(d, kind):
    """The image of a lattice under a map, in the metric that sees it as it was.

    Lengths along n grow by e^g along n, by a map of the line, or all lengths, by a conformal map;
    or a layer along a circle, whose cells are stretched by 100, bends by g. The step as it is seen
    is then of the order g^3, where other weights, and S of the centre of each cell, give g / 10.
    """
    lattice, cells = star_of_the_best_lattice(d)
    turn = np.eye(d)
    turn[:2, :2] = [[0.6, 0.8], [-0.8, 0.6]]
    lattice = lattice @ turn
    n, stretched = np.eye(d)[0], np.ones(d)
    for g in (0.02, 0.04):
        y = lattice[:, :1]
        logs = -g * y[:, :, None] * (np.eye(d) if kind == "all lengths" else np.outer(n, n))
        if kind == "one length":
            points = lattice + (np.expm1(g * y) / g - y) * n
        elif kind == "all lengths":
            points = lattice + 0.5 * g * (2 * y * lattice - (lattice**2).sum(1)[:, None] * n)
        else:
            stretched[0] = 0.01
            points, turned = stretched * lattice, 0.01 * g * lattice[:, 1]
            c, s = np.cos(turned), np.sin(turned)
            points[:, 0], points[:, 1] = ((100 / g + points[:, 0]) * x for x in (c, s))
            points[:, 0] -= 100 / g
            axes = np.tile(np.eye(d), (len(points), 1, 1))
            axes[:, :2, :2] = np.moveaxis(np.array([[c, -s], [s, c]]), 2, 0)
            logs = -axes @ np.diag(np.log(stretched)) @ axes.swapaxes(1, 2)
        upper = np.triu_indices(d)
        rows = np.column_stack([points, logs[:, upper[0], upper[1]]])
        inner = np.arange(len(points)) == 0
        topology = make_topology(cells, inner, np.zeros(len(points), dtype=bool))
        step = gauss_seidel_sweep(rows, topology)[0][0, :d] - points[0]
        assert np.linalg.norm(step / stretched) < g**3


def test_units_of_a_metric():
    rows = rows_of(np.diag([2.0, 3.0, 5.0]), 1)
    np.testing.assert_allclose(in_unit(rows, 4.0), rows_of(np.diag([0.5, 0.75, 1.25]), 1))


@pytest.mark.usefixtures("kernels_in_python")
@pytest.mark.parametrize("kind", ["tets", "plane", "surface"])
def test_a_newton_step_is_that_of_the_image(kind):
    rng = np.random.default_rng(13)
    points, cells = tets(rng) if kind == "tets" else triangles(2 if kind == "plane" else 3)
    d, n = points.shape[1], len(points)
    points[0] += 0.05
    axes = np.linalg.qr(rng.normal(size=(d, d)))[0]
    s = axes @ np.diag([30.0, 1.0, 0.5][:d]) @ axes.T
    if kind == "surface":
        points[:, 2] = 0.0
        s[2, :2] = s[:2, 2] = 0.0
        s[:2, :2], s[2, 2] = np.diag([30.0, 1.0]), 1.0
    seen, image = np.column_stack([points, rows_of(s, n)]), np.ascontiguousarray(points @ s)
    star = np.array([0, 1], dtype=np.int32)
    free, cost = Extremes(-1.0, 1.0, -1.0), Cost(1, 2.0)
    for p in (seen, image):
        if kind == "tets":
            newton_vertex(p, cells, star, 0, 2, 0, cost, free, make_room())
        else:
            newton_vertex_2d(p, cells, star, 0, cost, free, np.empty(5), np.eye(2, d))
    assert not np.allclose(seen[0, :d], points[0])
    np.testing.assert_allclose(seen[0, :d] @ s, image[0], atol=1e-9)
