"""Densities: what each choice means, where it is evaluated, what is refused."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import reference as ref
from hypothesis import given
from hypothesis import strategies as st
from strategies import SCALES, SEEDS, jittered, lattice, meshes, random_delaunay

from odt_plugins.engine.odt.density import (
    RANGE,
    cell_density,
    inverse_volume_density,
    make_density,
    size_field,
)
from odt_plugins.errors import InvalidOptionError


def slow_size_field(points, cells, passes):
    """Star means of |tau|^(1/d), then log h from vertices to cells and back, by loops."""
    d = points.shape[1]
    sizes = ref.volumes(points, cells) ** (1 / d)
    stars = [ref.star(cells, i) for i in range(len(points))]
    log_h = np.log([sizes[mine].mean() for mine in stars])
    log_h -= np.log(np.exp(log_h).mean())
    for _ in range(passes):
        of_cells = np.array([log_h[cell].mean() for cell in cells])
        log_h = np.array([of_cells[mine].mean() for mine in stars])
    return np.exp(log_h)


def barycentric(corners, x):
    inner = np.linalg.solve((corners[1:] - corners[0]).T, x - corners[0])
    return np.concatenate([[1 - inner.sum()], inner])


def slow_value(field, points, cells, x):
    """P1 interpolation by trying every cell."""
    best, value = -np.inf, None
    for cell in cells:
        shares = barycentric(points[cell], x)
        if shares.min() > best:
            best, value = shares.min(), shares @ field[cell]
    assert best > -1e-9
    return value


@given(meshes(), st.integers(0, 4))
def test_size_field_equals_the_loop(mesh, passes):
    points, cells = mesh
    assert size_field(points, cells, passes) == pytest.approx(
        slow_size_field(points, cells, passes), rel=1e-9
    )


def test_cells_that_are_all_flat_are_of_one_size():
    points = np.array([[0.0, -0.4, 0.0], [0.0, -0.1, 0.0], [0.0, 0.4, 0.0], [1.0, 0.0, 0.0]])
    flat, sound = [1, 2, 0], [0, 1, 3]
    assert size_field(points, np.array([flat], np.int32)).tolist() == [1.0] * 4
    assert inverse_volume_density(points, np.array([flat], np.int32)).tolist() == [1.0]
    found = inverse_volume_density(points, np.array([flat, sound], np.int32))
    assert found == pytest.approx([1e100, 0.5])


@given(meshes(), SCALES)
def test_keep_has_no_scale(mesh, scale):
    points, cells = mesh
    rho = make_density("keep", None, points, cells).at(points)
    scaled = make_density("keep", None, points * scale, cells).at(points * scale)
    assert scaled == pytest.approx(rho, rel=1e-8)


@pytest.mark.parametrize(("exponent", "power"), [(None, None), (2, 2), (3.0, 3)])
def test_keep_is_the_size_to_the_power(d, exponent, power):
    points, cells = jittered(d, 4, 1)
    rho = make_density("keep", exponent, points, cells).at(points)
    expected = size_field(points, cells) ** -(d + 2 if power is None else power)
    assert rho == pytest.approx(expected, rel=1e-12)


@given(meshes(), SEEDS)
def test_moved_vertices_read_the_field_where_they_are(mesh, seed):
    points, cells = mesh
    rng = np.random.default_rng(seed)
    field = rng.uniform(1, 5, len(points))
    density = make_density(field, None, points, cells)
    far = points[rng.permutation(len(points))]
    inside = 0.98 * far + 0.02 * points.mean(axis=0)
    scaled = field / field.mean()
    values = density.at(inside)
    for i in range(0, len(points), 9):
        exact = slow_value(scaled, points, cells, inside[i])
        assert values[i] == pytest.approx(exact, rel=1e-7)


def test_linear_fields_are_reproduced_and_clamped_outside(d):
    points, cells = random_delaunay(d, 80, 2)
    slope = np.array([0.2, -0.1, 0.15])[:d]
    field = 1.0 + points @ slope
    density = make_density(field, None, points, cells)
    inside = 0.5 * points
    assert density.at(inside) * field.mean() == pytest.approx(1.0 + inside @ slope, rel=1e-12)
    outside = density.at(3.0 * points) * field.mean()
    assert np.all((outside >= field.min() - 1e-12) & (outside <= field.max() + 1e-12))


def test_points_beyond_the_input_vertices_are_found(d):
    points, cells = random_delaunay(d, 80, 3)
    density = make_density(1.0 + points[:, 0] ** 2, None, points, cells)
    more = np.concatenate([points, points[::-1]])
    values = density.at(more)
    assert values[len(points) :] == pytest.approx(values[: len(points)][::-1], rel=1e-9)


def test_cell_values_go_to_vertices_by_volume(d):
    points, cells = jittered(d, 3, 4)
    rho = np.random.default_rng(5).uniform(1, 9, len(cells))
    result = make_density(rho, None, points, cells).at(points)
    volumes = ref.volumes(points, cells)
    nodal = np.array([
        volumes[mine] @ rho[mine] / volumes[mine].sum()
        for mine in (ref.star(cells, i) for i in range(len(points)))
    ])
    assert result == pytest.approx(nodal / nodal.mean(), rel=1e-12)


def test_functions_are_asked_at_the_present_points(d):
    points, cells = lattice(d, 3)
    density = make_density(lambda x: 1.0 + x[:, 0] ** 2, None, points, cells)
    found = density.at(points + 1.0) / density.at(points)[0]
    expected = (1.0 + (points[:, 0] + 1.0) ** 2) / (1.0 + points[0, 0] ** 2)
    assert found == pytest.approx(expected, rel=1e-15)


def test_functions_cannot_change_the_mesh(d):
    points, cells = lattice(d, 2)

    def greedy(x):
        x *= 0.0
        return np.ones(len(x))

    before = points.copy()
    make_density(greedy, None, points, cells).at(points)
    assert np.array_equal(points, before)


@pytest.mark.parametrize("exponent", [0.01, 1, 5, 60, 300, 1e6, 1e300])
def test_large_exponents_on_stretched_meshes_overflow_nothing(d, exponent):
    points, cells = lattice(d, 6)
    for stretch in (1.0, 1e6, 1e-6):
        graded = 10.0 ** (8.0 * (points - 1.0))
        graded[:, 0] *= stretch
        size = size_field(graded, cells)
        rho = make_density("keep", exponent, graded, cells).at(graded)
        assert np.isfinite(rho).all()
        assert rho.min() >= 0.99 / RANGE
        assert rho.max() <= 1.01 * RANGE
        plain = np.abs(np.log(size)) * exponent < 200
        assert np.log(rho[plain]) == pytest.approx(-exponent * np.log(size[plain]), rel=1e-6)
        assert (rho[size < size.mean()].min() >= rho[size >= size.mean()].max() * (1 - 1e-9))


@pytest.mark.parametrize("factor", [1e-300, 1e-150, 3.0, 1e150, 1e300])
def test_a_constant_factor_changes_nothing(d, factor):
    points, cells = jittered(d, 3, 13)
    rho = np.random.default_rng(14).uniform(1, 9, len(points))
    for spec in (lambda x, unit: unit * (1.0 + x[:, 0] ** 2), lambda x, unit: unit * rho):
        plain, other = (make_density(lambda x, unit=unit: spec(x, unit), None, points, cells)  # noqa: B023
                        .at(points) for unit in (1.0, factor))
        assert other / other[0] == pytest.approx(plain / plain[0], rel=1e-12)
        assert 1e-3 < other.mean() < 1e3
    plain, other = (make_density(unit * rho, None, points, cells).at(points)
                    for unit in (1.0, factor))
    assert other == pytest.approx(plain, rel=1e-12)


def test_densities_that_differ_by_more_than_numbers_can_stay_positive(d):
    points, cells = jittered(d, 3, 15)
    for size in (len(points), len(cells)):
        rho = 10.0 ** np.linspace(-300, 300, size)
        for spec in (rho, lambda x: 10.0 ** np.linspace(300, -300, len(x))):
            found = make_density(spec, None, points, cells).at(points)
            assert np.isfinite(found).all()
            assert found.min() >= 0.99 / RANGE


def test_uniform_and_inverse_volume(d):
    points, cells = jittered(d, 3, 6)
    for name in ("uniform", "inverse-volume"):
        density = make_density(name, None, points, cells)
        assert np.array_equal(density.at(points), np.ones(len(points)))
        assert density.inverse_volume == (name == "inverse-volume")
    volumes = ref.volumes(points, cells)
    weights = inverse_volume_density(points, cells) * volumes
    assert weights == pytest.approx(np.full(len(cells), volumes.mean()), rel=1e-9)


def test_cell_density_is_the_vertex_mean(d):
    points, cells = jittered(d, 3, 7)
    rho = np.random.default_rng(8).uniform(1, 2, len(points))
    expected = [rho[cell].mean() for cell in cells]
    assert cell_density(cells, rho) == pytest.approx(expected, rel=1e-14)


def test_unused_vertices_do_no_harm(d):
    points, cells = jittered(d, 3, 9)
    more = np.concatenate([points, np.full((1, d), 7.0)])
    field = size_field(more, cells)
    assert field[:-1] == pytest.approx(size_field(points, cells), rel=1e-12)
    assert field[-1] == 1.0
    assert np.isfinite(make_density("keep", None, more, cells).at(more)).all()


def test_asking_changes_nothing_and_travels(d):
    points, cells = jittered(d, 3, 10)
    density = make_density("keep", None, points, cells)
    moved = 0.9 * points + 0.05
    first = density.at(moved)
    density.at(points)
    assert np.array_equal(density.at(moved), first)
    assert np.array_equal(pickle.loads(pickle.dumps(density)).at(moved), first)
    walk = density.walk_start(len(points))
    assert np.array_equal(density.at(moved, None, walk), first)
    assert density.at(moved, None, walk) == pytest.approx(first, rel=1e-12)
    for c, x in zip(walk, moved, strict=True):
        assert barycentric(points[cells[c]], x).min() > -1e-9
    assert np.array_equal(density.at(moved), first)
    points *= 0.0
    assert np.array_equal(density.at(moved), first)


def bad(values, index, value):
    values = np.array(values, dtype=float)
    values[index] = value
    return values


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_bad_values_are_counted_and_named(d, value):
    points, cells = lattice(d, 3)
    for size in (len(points), len(cells)):
        spec = bad(np.ones(size), [4, 6], value)
        with pytest.raises(InvalidOptionError, match=r"at index 4 \(2 of them\)"):
            make_density(spec, None, points, cells)
    with pytest.raises(InvalidOptionError, match=r"at index 4 \(2 of them\)"):
        make_density(lambda x: bad(np.ones(len(x)), [4, 6], value), None, points, cells)
    density = make_density(lambda x: bad(np.ones(len(x)), [4, 6], value if x.any() else 1.0), None,
                           0.0 * points, cells)
    with pytest.raises(InvalidOptionError, match=r"at index 4 \(2 of them\)"):
        density.at(points)


@pytest.mark.parametrize(
    ("spec", "text"),
    [
        ("smooth", "'smooth'"),
        (np.ones(5), r"shape \(5,\)"),
        (np.ones((3, 3)), r"shape \(3, 3\)"),
        (2.0, r"shape \(\)"),
        (None, "shape|NoneType"),
        ([object()], "list"),
        (lambda x: np.ones(3), r"shape \(3,\)"),
        (lambda x: ["a"] * len(x), "list"),
        (lambda x: np.ones(len(x)) + 1j, "dtype complex128 that is no array of real numbers"),
        (np.array(["1.0", "2.0"]), "dtype <U3 that is no array of real numbers"),
    ],
)
def test_wrong_specifications_are_refused(d, spec, text):
    points, cells = lattice(d, 3)
    with pytest.raises(InvalidOptionError, match=text):
        make_density(spec, None, points, cells).at(points)


def test_arrays_that_could_mean_both_are_refused():
    points = np.concatenate([np.zeros((1, 2)), [[1, 0], [0, 1], [-1, 0], [0, -1]], [[9.0, 9.0]]])
    cells = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]], dtype=np.int32)
    make_density(np.ones(6), None, points, cells)
    with pytest.raises(InvalidOptionError, match="not ambiguous"):
        make_density(np.ones(4), None, points[:4], cells)


def test_exponents_without_sizes_are_refused(d):
    points, cells = lattice(d, 2)
    with pytest.raises(InvalidOptionError, match="exponent 3"):
        make_density("uniform", 3, points, cells)
    with pytest.raises(InvalidOptionError, match="exponent nan"):
        make_density("keep", float("nan"), points, cells)
