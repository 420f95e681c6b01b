"""Meshes that are optimised and remeshed in a metric."""

import itertools

import numpy as np
import pytest
from scipy.spatial import Delaunay

import odt_plugins
from odt_plugins.engine.remesh import volume
from odt_plugins.engine.retile import passes
from odt_plugins.errors import InvalidOptionError

STRETCHED = np.array([400.0, 0.0, 25.0])


def square(n=12, seed=0):
    """Points of a jittered grid on the unit square, and their triangles."""
    g = np.stack(np.meshgrid(*[np.linspace(0, 1, n)] * 2, indexing="ij"), -1).reshape(-1, 2)
    inner = ((g > 0) & (g < 1)).all(axis=1)
    g[inner] += np.random.default_rng(seed).uniform(-0.3 / n, 0.3 / n, (inner.sum(), 2))
    return g, Delaunay(g).simplices


def cube(n=6):
    """Points of a jittered grid on the unit cube, and its tetrahedra, six a box."""
    at = np.arange(n**3).reshape(n, n, n)
    rows = []
    for order in itertools.permutations(range(3)):
        path = [np.zeros(3, int)]
        for axis in order:
            path.append(path[-1] + np.eye(3, dtype=int)[axis])
        rows.append(np.stack(
            [at[o[0]:n - 1 + o[0], o[1]:n - 1 + o[1], o[2]:n - 1 + o[2]].ravel() for o in path], 1))
    t = np.concatenate(rows)
    g = np.stack(np.meshgrid(*[np.linspace(0, 1, n)] * 3, indexing="ij"), -1).reshape(-1, 3)
    inner = ((g > 0) & (g < 1)).all(axis=1)
    g[inner] += np.random.default_rng(1).uniform(-0.1 / n, 0.1 / n, (inner.sum(), 3))
    flip = np.linalg.det(g[t[:, 1:]] - g[t[:, :1]]) < 0
    t[flip] = t[flip][:, [1, 0, 2, 3]]
    return g, t


def test_resizing_ends_where_little_changes_or_collapses_undo_what_splits_did(monkeypatch):
    turns = []
    smooth = volume._smooth
    monkeypatch.setattr(volume, "_smooth", lambda *given: turns.append(smooth(*given)))
    mesh = cube(4)
    options = {"free": "periodic", "keep": (), "finish": False}
    odt_plugins.remesh(mesh, metric=np.tile(np.eye(3) / 0.3**2, (64, 1, 1)), **options)
    assert 2 <= len(turns) < volume.ROUNDS
    turns.clear()
    monkeypatch.setattr(volume, "SETTLED", 0.0)
    odt_plugins.remesh(mesh, 0.3, **options)
    assert len(turns) == volume.ROUNDS
    turns.clear()
    monkeypatch.setattr(volume, "SETTLED", 1.0)
    odt_plugins.remesh(mesh, 0.3, **options)
    assert len(turns) == volume.RELENTING + 2


def test_cells_that_stay_are_not_made_by_way_of_many_more(monkeypatch):
    counts = []
    collapse = volume._collapse

    def counted(work, *limits):
        counts.append(len(work.body.tets.live()))
        return collapse(work, *limits)

    monkeypatch.setattr(volume, "_collapse", counted)
    mesh = cube(4)
    tensor = np.diag([100.0**2, 2.0**2, 2.0**2])
    _, cells = odt_plugins.remesh(
        mesh, metric=np.tile(tensor, (64, 1, 1)), free="periodic", keep=(), finish=False)
    assert max(counts) < 8 * len(cells)


@pytest.mark.parametrize("bent", [False, True])
def test_triangles_that_stay_are_not_made_by_way_of_many_more(monkeypatch, bent):
    counts = []
    split = passes.split_edges

    def counted(net, *given):
        done = split(net, *given)
        counts.append(int(net.count[1]))
        return done

    monkeypatch.setattr(passes, "split_edges", counted)
    points, cells = square()
    tensor = np.diag([400.0**2, 2.0**2])
    if bent:
        points = np.column_stack([points, points[:, 1] ** 2])
        tensor = np.diag([400.0**2, 2.0**2, 2.0**2])
    _, cells = odt_plugins.remesh((points, cells), metric=np.tile(tensor, (144, 1, 1)))
    assert max(counts) < 5 * len(cells)


def seen_edges(points, cells, tensor):
    corners = itertools.combinations(range(cells.shape[1]), 2)
    pairs = np.concatenate([cells[:, list(c)] for c in corners])
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    e = points[pairs[:, 1]] - points[pairs[:, 0]]
    return np.sqrt(np.einsum("ni,ij,nj->n", e, tensor, e))


def test_triangles_get_the_lengths_of_a_metric():
    points, cells = square()
    tensor = np.array([[400.0, 0.0], [0.0, 25.0]])
    (p, t), report = odt_plugins.remesh_with_report(
        (points, cells), metric=np.tile(STRETCHED, (144, 1)))
    length = seen_edges(p, t, tensor)
    assert ((length > 0.7) & (length < 1.42)).mean() > 0.97
    image = odt_plugins.quality((p @ np.diag([20.0, 5.0]), t))
    assert image.mean_quality > 0.93
    assert np.isclose(report.after.mean_quality, image.mean_quality, atol=1e-9)
    assert np.isclose(report.after.volume, 1.0)
    assert np.isclose(odt_plugins.quality((p, t)).volume, 1.0)


def test_tetrahedra_get_the_lengths_of_a_metric():
    points, cells = cube()
    tensor = np.diag([1 / 0.12**2, 1 / 0.3**2, 1 / 0.3**2])
    (p, t), report = odt_plugins.remesh_with_report(
        (points, cells), metric=lambda x: np.broadcast_to(tensor, (len(x), 3, 3)), free="periodic")
    length = seen_edges(p, t, tensor)
    assert ((length > 0.7) & (length < 1.42)).mean() > 0.9
    image = odt_plugins.quality((p @ np.sqrt(tensor), t))
    assert image.mean_quality > 0.85
    assert np.isclose(report.after.min_quality, image.min_quality, atol=1e-9)
    assert np.isclose(odt_plugins.quality((p, t)).volume, 1.0, atol=3e-3)


@pytest.mark.parametrize("make", [square, cube])
def test_a_stretched_mesh_is_improved_in_its_own_metric_and_stays_stretched(make):
    points, cells = make()
    d = points.shape[1]
    shape = np.diag([1.0, 0.1, 0.1][:d])
    stretched = points @ shape
    better, t = odt_plugins.optimize((stretched, cells), metric="input", free="layers")
    before, after = (odt_plugins.quality((x @ np.linalg.inv(shape), c)) for x, c in (
        (stretched, cells), (better, t)))
    assert after.mean_quality > before.mean_quality + 0.005
    assert after.min_quality >= before.min_quality - 0.05
    isotropic = odt_plugins.quality((better, t))
    assert isotropic.mean_quality < 0.6
    boundary = ((points == 0) | (points == 1)).any(axis=1)
    assert (better[boundary] == stretched[boundary]).all()


def test_a_constant_multiple_of_the_identity_counts_cells():
    points, cells = square()
    _, t = odt_plugins.remesh((points, cells), metric=np.tile([1.0, 0, 1.0], (144, 1)), cells=300)
    assert abs(len(t) - 300) < 40


def test_the_same_bits_for_any_number_of_threads(many_threads):
    points, cells = cube(5)
    tensor = np.diag([40.0, 10.0, 10.0])
    found = [odt_plugins.remesh((points, cells), metric=np.tile(tensor, (125, 1, 1)), threads=k,
                                free="periodic") for k in (1, 3)]
    assert np.array_equal(found[0][0], found[1][0])
    assert np.array_equal(found[0][1], found[1][1])


@pytest.mark.parametrize(("options", "said"), [
    ({"metric": np.eye(2)}, "metric of shape"),
    ({"metric": np.tile([1.0, 0, -1.0], (144, 1))}, "at vertex 0"),
    ({"metric": "nothing"}, "expected 'input', or the name"),
    ({"metric": "input", "smoothing": {"solver": "global"}}, "solver"),
    ({"metric": "input", "density": np.ones(144)}, "density"),
    ({"metric": "input", "smoothing": {"connectivity": "delaunay"}}, "connectivity"),
    ({"metric": "input", "insert": True}, "insert"),
])
def test_what_goes_with_no_metric_is_refused_in_a_sentence(options, said):
    with pytest.raises(InvalidOptionError, match=said):
        odt_plugins.optimize(square(), **options)


def test_a_size_beside_a_metric_is_refused():
    with pytest.raises(InvalidOptionError, match="one of them"):
        odt_plugins.remesh(square(), 0.1, metric="input")


@pytest.mark.parametrize("make", [square, cube])
def test_a_boundary_that_slides_is_seen_as_all_else(make):
    points, cells = make()
    d, step = points.shape[1], 0.4 / len(points) ** (1 / points.shape[1])
    on = (points == 0) | (points == 1)
    shift = np.random.default_rng(2).uniform(-step, step, points.shape) * ~on
    points = np.where(on.any(axis=1)[:, None], points + shift, points)
    root = np.array([[5.0, 1.0, 0.2], [1.0, 1.0, 0.1], [0.2, 0.1, 1.2]])[:d, :d]
    (p, t), report = odt_plugins.optimize_with_report(
        (points @ np.linalg.inv(root), cells), metric=np.tile(root @ root, (len(points), 1, 1)),
        boundary="slide", free=("layers", "periodic"))
    before, image = odt_plugins.quality((points, cells)), odt_plugins.quality((p @ root, t))
    for name in ("mean_quality", "min_quality", "min_angle", "max_angle"):
        assert np.isclose(getattr(report.before, name), getattr(before, name), atol=1e-9)
        assert np.isclose(getattr(report.after, name), getattr(image, name), atol=1e-9)
    assert image.mean_quality > before.mean_quality + 0.02
    assert image.min_quality >= before.min_quality
    moved = (p != points @ np.linalg.inv(root)).any(axis=1)
    assert moved[on.any(axis=1)].any()
    corners = on.sum(axis=1) == d
    assert not moved[corners].any()
    assert np.isclose(image.volume, 1.0, rtol=2e-3)


def test_an_inverted_mesh_is_seen_before_and_after():
    points, cells = square()
    points[5 * 12 + 5] = points[7 * 12 + 7] + 0.01
    root = np.diag([6.0, 1.0])
    (p, t), report = odt_plugins.optimize_with_report(
        (points @ np.linalg.inv(root), cells), metric=np.tile(root @ root, (144, 1, 1)))
    before, image = odt_plugins.quality((points, cells)), odt_plugins.quality((p @ root, t))
    assert before.min_quality < 0 < image.min_quality
    assert np.isclose(report.before.min_quality, before.min_quality, atol=1e-9)
    assert np.isclose(report.after.min_quality, image.min_quality, atol=1e-9)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_a_run_in_a_constant_metric_is_that_of_the_image(d, seed):
    """The same cells, and vertices that differ by what rounding becomes in some hundred steps."""
    rng = np.random.default_rng(seed)
    image = rng.normal(size=(300, d))
    image /= np.maximum(1.0, np.linalg.norm(image, axis=1))[:, None]
    cells = Delaunay(image).simplices
    volume = np.linalg.det(image[cells[:, 1:]] - image[cells[:, :1]])
    cells[volume < 0, :2] = cells[volume < 0, 1::-1]
    cells = cells[np.abs(volume) > 1e-6]
    axes = np.linalg.qr(rng.normal(size=(d, d)))[0]
    s = axes @ np.diag([0.3, 2.0, 1.0][:d]) @ axes.T
    points, found = odt_plugins.optimize(
        (image @ np.linalg.inv(s), cells), metric=np.tile(s @ s, (300, 1, 1)))
    wanted = odt_plugins.optimize(
        (image, cells), density="uniform", smoothing={"connectivity": "flips"})
    assert len({*map(frozenset, found.tolist())} ^ {*map(frozenset, wanted[1].tolist())}) == 0
    np.testing.assert_allclose(points @ s, wanted[0], atol=1e-10)
    assert np.abs(wanted[0] - image).max() > 0.1
