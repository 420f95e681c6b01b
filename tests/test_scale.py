"""Units, sizes and stretch of meshes: nothing overflows, nothing is rounded on its way in."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import surface_meshes as sm
from hypothesis import given
from hypothesis import strategies as st
from strategies import DIMENSIONS, SEEDS, jittered, positive, random_delaunay

import odt_plugins
from odt_plugins.engine.topology.frame import make_frame
from odt_plugins.errors import InvalidMeshError
from odt_plugins.figures import uniformity
from odt_plugins.mesh.simplex import SimplexMesh

LOCAL = [("odt", "gauss-seidel"), ("odt", "jacobi"), ("cpt", "gauss-seidel"), ("cpt", "jacobi"),
         ("laplacian", "gauss-seidel"), ("cvt", "gauss-seidel")]
METHODS = [*LOCAL, ("odt", "global"), ("cpt", "global"), ("odt", "richardson"), ("odt", "lbfgs")]


def beside_a_large_cell(points, cells, size):
    """A mesh of a given size, and a cell of size 1 beside it."""
    n, d = points.shape
    small = (points - points.min(axis=0)) * size
    points = np.concatenate([small, np.zeros((1, d)), -np.eye(d)])
    return points, positive(points, np.concatenate([cells, [np.arange(n, n + d + 1)]]))


@given(SEEDS, st.sampled_from([-1e3, -3.0, -0.4, 0.0, 0.7, 2.0, 1e6]), st.integers(-100, 100))
def test_no_coordinate_is_rounded_on_its_way_into_the_engine(seed, shift, unit):
    rng = np.random.default_rng(seed)
    points = np.ldexp(rng.random((12, 2)) * 10.0 ** rng.uniform(-18, 0, (12, 1)) + shift, unit)
    cells = np.arange(12).reshape(4, 3)
    cells = positive(points, cells).astype(np.int32)
    frame = make_frame(SimplexMesh(points, cells, np.zeros(4, np.int32), np.zeros(12, bool)))[0]
    used = points[frame.vertices]
    for x, y, centre in zip(used.T, frame.inside(used).T, frame.centre, strict=True):
        exact = [(Fraction(a) - Fraction(centre)) * Fraction(frame.scale) for a in x.tolist()]
        assert [Fraction(a) for a in y.tolist()] == exact
    assert np.abs(frame.inside(used)).max() <= 2.0
    assert np.array_equal(frame.outside(frame.inside(used)), used)


@pytest.mark.parametrize(("method", "solver"), METHODS)
def test_cells_far_smaller_than_the_mesh_are_no_flat_ones(d, method, solver):
    points, cells = random_delaunay(d, 15, 3) if d == 2 else jittered(3, 2, 3)
    small = odt_plugins.quality((points, cells)).mean_quality
    for size in (1e-13, 1e-16, 1e-17, 1e-30):
        both = beside_a_large_cell(points, cells, size)
        result, report = odt_plugins.optimize_with_report(
            both, method=method, smoothing={"solver": solver})
        mine = result[1][(result[1] < len(points)).all(axis=1)]
        mean = odt_plugins.quality((result[0] / size, mine)).mean_quality
        assert mean > small + 0.01, report.fallback


KINDS = {
    "plane": lambda seed: random_delaunay(2, 12, seed),
    "space": lambda seed: jittered(3, 2, seed),
    "surface": lambda seed: sm.bowl(6, noise=0.2, seed=seed),
}
DENSITIES = ["keep", "uniform", "inverse-volume", "array"]


@given(
    st.sampled_from(list(KINDS)), SEEDS, st.sampled_from([-110, -37, 1, 53, 110]),
    st.sampled_from(LOCAL), st.sampled_from(DENSITIES), st.booleans(), st.booleans(),
)
def test_another_unit_changes_no_bit(kind, seed, power, method, density, finish, slide):
    points, cells = KINDS[kind](seed)
    options = {"method": method[0], "smoothing": {"solver": method[1], "rounds": 4},
               "finish": finish}
    options["density"] = density
    if density == "array":
        options["density"] = np.random.default_rng(seed).uniform(1, 9, len(points))
    if method[0] == "laplacian" and density == "inverse-volume":
        options["density"] = "uniform"
    if kind == "surface" and method[0] == "cvt":
        options["method"] = "odt"
    if kind != "plane" and slide:
        options["boundary"] = "slide"
    first = odt_plugins.optimize((points, cells), **options)
    other = odt_plugins.optimize((np.ldexp(points, power), cells), **options)
    assert np.array_equal(np.ldexp(other[0], -power), first[0])
    assert np.array_equal(other[1], first[1])


@pytest.mark.parametrize("kind", list(KINDS))
@pytest.mark.parametrize("size", [1e-320, 1e-200, 1e-60, 1e60, 1e150, 1e200, 1.7e308])
def test_units_beyond_reason_are_refused_in_one_sentence(kind, size):
    points, cells = KINDS[kind](1)
    points = points / np.abs(points).max() * size
    for function in (odt_plugins.optimize, odt_plugins.quality):
        with pytest.raises(InvalidMeshError, match=r"long; expected between 1e-40 and 1e\+40"):
            function((points, cells))


@pytest.mark.parametrize("tilt", [0.0, 0.3])
@pytest.mark.parametrize("size", [1e-200, 1e150])
def test_planes_in_space_beyond_reason_are_refused_as_well(tilt, size):
    points, cells = random_delaunay(2, 12, 5)
    space = np.column_stack([points, tilt * points[:, 0]]) * size
    for function in (odt_plugins.optimize, odt_plugins.quality):
        with pytest.raises(InvalidMeshError, match="long; expected between"):
            function((space, cells))


@pytest.mark.parametrize("size", [1e-39, 1e-20, 1e20, 1e39])
@pytest.mark.parametrize("kind", list(KINDS))
def test_units_at_the_limits_are_as_good_as_any(kind, size):
    points, cells = KINDS[kind](2)
    points = points / np.ptp(points, axis=0).max()
    plain = odt_plugins.quality(odt_plugins.optimize((points, cells)))
    scaled = odt_plugins.quality(odt_plugins.optimize((points * size, cells)))
    before = odt_plugins.quality((points, cells))
    assert scaled.mean_quality > before.mean_quality + 0.8 * (
        plain.mean_quality - before.mean_quality)
    assert scaled.uniformity == pytest.approx(plain.uniformity, rel=0.2)


@pytest.mark.parametrize("boundary", ["fixed", "slide"])
@pytest.mark.parametrize("kind", list(KINDS))
def test_vertices_of_no_cell_may_be_anywhere(kind, boundary):
    points, cells = KINDS[kind](8)
    boundary = "fixed" if kind == "plane" else boundary
    one = np.full((1, points.shape[1]), 1.7e308)
    far = np.concatenate([points, one, -one])
    plain = odt_plugins.optimize((points, cells), boundary=boundary)
    result = odt_plugins.optimize((far, cells), boundary=boundary)
    assert np.array_equal(result[0][:-2], plain[0])
    assert np.array_equal(result[1], plain[1])
    assert np.array_equal(result[0][-2:], far[-2:])


def test_cells_of_sizes_beyond_reason_are_refused(d):
    points, cells = beside_a_large_cell(*jittered(d, 2, 1), 1e-45)
    m = len(cells)
    with pytest.raises(InvalidMeshError, match=rf"\(first: cell 0\) of {m} smaller than 1e-40"):
        odt_plugins.optimize((points, cells))


@pytest.mark.parametrize("height", [1e-100, 1e-155, 1e-180, 1e-300, 1e-310])
def test_nearly_flat_cells_are_measured(height):
    triangles = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, height], [0.6, -height]])
    found = odt_plugins.quality((triangles, np.array([[0, 1, 2], [1, 0, 3]])))
    assert 0.0 <= found.min_quality <= found.mean_quality < 1e-90
    assert found.max_amips > 1e90
    assert (found.uniformity < 1.0) == (height >= 1e-300)
    assert (found.uniformity == np.inf) == (height < 1e-300)
    assert found.inverted == 0


def test_uniformity_has_no_unit():
    points, cells = random_delaunay(2, 12, 4)
    plain = uniformity(points, cells)
    assert uniformity(points, cells, 1e-250) == pytest.approx(plain, rel=1e-12)
    assert uniformity(points, cells, 1e250) == pytest.approx(plain, rel=1e-12)


@given(DIMENSIONS, st.integers(-9, 9), st.sampled_from(DENSITIES), SEEDS)
def test_stretched_meshes_are_never_worse(d, stretch, density, seed):
    points, cells = jittered(d, 4 if d == 2 else 2, seed)
    points[:, -1] *= 10.0 ** min(stretch, 9 if d == 2 else 6)
    rho = np.random.default_rng(seed).uniform(1, 9, len(points))
    spec = rho if density == "array" else density
    result = odt_plugins.optimize((points, cells), density=spec, smoothing={"rounds": 5})
    before, after = (odt_plugins.quality(m) for m in ((points, cells), result))
    for name in ("min_quality", "p1_quality", "mean_quality", "min_angle"):
        assert getattr(after, name) >= getattr(before, name) * (1 - 1e-12)
