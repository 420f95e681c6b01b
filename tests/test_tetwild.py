"""tetrahedralize(): pytetwild's own call with ODT behind it, and sizing fields as densities."""

from __future__ import annotations

import inspect
import math
import pickle
import warnings
from pathlib import Path

import contract
import meshio
import numpy as np
import pytest
import tet_meshes

import odt_plugins
from odt_plugins import tetwild
from odt_plugins.engine.run import plan
from odt_plugins.errors import (
    InvalidMeshError,
    InvalidOptionError,
    MissingDependencyError,
    NotFilledWarning,
    UnsupportedMeshError,
)
from odt_plugins.options import OPTIONS

STORED = Path(__file__).parent / "data" / "tetwild_bunny.vtu"
CUBE = np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
FACES = np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))], dtype=np.int32)


@pytest.fixture
def stored(monkeypatch):
    """TetWild replaced by a stored mesh, since it gives another one every time."""
    mesh = meshio.read(STORED)
    made = (mesh.points, mesh.cells[0].data.astype(np.int32))
    calls = []
    monkeypatch.setattr(tetwild, "run_tetwild", lambda given: calls.append(given) or made)
    monkeypatch.setattr(tetwild, "compare_with_surface", lambda *_: None)
    return made, calls


def background(function, n=5):
    """Points, tetrahedra and values of a sizing field on a grid around the unit cube."""
    points, cells, _ = contract.grid(3, n)
    points = 1.5 * points - 0.25
    return points, cells.astype(np.int32), function(points)


def test_the_signature_is_that_of_pytetwild():
    pytetwild = pytest.importorskip("pytetwild")
    theirs = inspect.signature(pytetwild.tetrahedralize).parameters
    ours = inspect.signature(odt_plugins.tetrahedralize).parameters
    of_files = ("target", "levels", "edge_length", "bodies", "file_format", "binary")
    sizes = ("size", "scale", "cells", "growth")
    assert list(ours) == [*theirs, "odt", *sizes, *of_files, *OPTIONS]
    usual = {n: p.default for n, p in theirs.items()} | {"faces": None}
    assert usual == {n: ours[n].default for n in theirs}


def test_tetwild_and_odt_in_one_call_leave_nothing_behind(tmp_path, monkeypatch):
    pytest.importorskip("pytetwild")
    monkeypatch.chdir(tmp_path)
    old = CUBE.copy()
    for ordering in (False, True):
        points, cells = odt_plugins.tetrahedralize(
            CUBE, FACES, edge_length_fac=0.15, epsilon=1e-2, vtk_ordering=ordering)
        assert (points.dtype, cells.dtype) == (np.float64, np.int32)
        size = np.linalg.det(points[cells][:, 1:] - points[cells][:, :1])
        assert (size > 0).all() if ordering else (size < 0).all()
        assert np.abs(size).sum() / 6 == pytest.approx(1.0, rel=0.05)
    assert list(tmp_path.iterdir()) == []
    assert np.array_equal(CUBE, old)


def test_odt_is_what_optimize_does_and_can_be_left_out(stored):
    (points, cells), calls = stored
    alone = odt_plugins.tetrahedralize(CUBE, FACES, odt=False)
    assert alone[0] is points
    first = {"smoothing": {"rounds": 2, "exponent": 3.0}}
    second = {"density": "uniform", "smoothing": {"cycles": 1}}
    for given, options in (({}, {}), ({"odt": {}}, {}), (first, first), ({"odt": first}, first),
                           ({"odt": {"density": "uniform"}, "smoothing": {"cycles": 1}}, second)):
        out = odt_plugins.tetrahedralize(CUBE, FACES, **given)
        truth = odt_plugins.optimize((points, cells), **options)
        assert out[0].tobytes() == truth[0].tobytes()
        assert np.array_equal(out[1], truth[1])
    assert np.array_equal(calls[0]["faces"], FACES)
    assert not {"odt", "options", "smoothing"} & set().union(*calls)


def test_options_are_checked_before_tetwild_runs(monkeypatch):
    monkeypatch.setattr(tetwild, "run_tetwild", lambda given: pytest.fail("TetWild ran"))
    for given, message in (
        ({"odt": {"repai": 3}}, "did you mean 'repair'"),
        ({"smoothing": {"rounds": -1}}, r"smoothing={'rounds': -1}"),
        ({"solver": "global"}, r"unknown keywords \['solver'\].*, try smoothing={'solver': "),
        ({"regios": 3}, "did you mean 'regions'"),
        ({"odt": "yes"}, "got odt='yes'; expected a dict"),
        ({"fixed": [0, 1]}, "got fixed of type list for a surface, whose vertices and faces"),
        ({"odt": {"metric": np.ones((8, 6))}}, "got metric of type ndarray for a surface"),
        ({"regions": np.ones(12, int), "size": 0.2}, "got regions of type ndarray for a surface"),
        ({"odt": False, "smoothing": {"rounds": 3}}, r"TetWild alone, and options \['smoothing'\]"),
        ({"odt": {"smoothing": {"rounds": 2}}, "smoothing": {"rounds": 3}},
         r"\['smoothing'\] as keywords and in odt="),
    ):
        with pytest.raises(InvalidOptionError, match=message):
            odt_plugins.tetrahedralize(CUBE, FACES, **given)


@pytest.fixture
def seen(monkeypatch):
    """The arguments that TetWild gets, in whose place a stored mesh comes."""
    mesh, arguments = meshio.read(STORED), []

    def run(folder, *_):
        arguments.append(pickle.loads((folder / "arguments").read_bytes()))
        (folder / "result").write_bytes(pickle.dumps((mesh.points, mesh.cells[0].data)))
        return 0, ""

    monkeypatch.setattr(tetwild, "_run", run)
    return arguments


@pytest.mark.parametrize("power", [-30, -120, 0, 12, 120])
def test_tetwild_gets_surfaces_of_usual_size(seen, power):
    mesh = meshio.read(STORED)
    grid, tets, values = background(lambda x: 0.1 + 0.0 * x[:, 0])
    for by in (0, power):
        points, _ = odt_plugins.tetrahedralize(
            np.ldexp(CUBE, by), FACES, edge_length_abs=math.ldexp(0.3, by), odt=False,
            bg_vertices=np.ldexp(grid, by), bg_tets=tets, bg_values=np.ldexp(values, by))
    usual, other = seen
    back = 1 if abs(power) > 20 else -power
    for name in ("vertices", "edge_length_abs", "bg_vertices", "bg_values"):
        assert np.array_equal(np.ldexp(other[name], back), usual[name])
    assert np.array_equal(points, np.ldexp(mesh.points, power + back))


def test_vertices_in_whole_numbers_are_taken_as_tetwild_takes_them(monkeypatch):
    mesh = meshio.read(STORED)
    made = mesh.points, mesh.cells[0].data
    monkeypatch.setattr(tetwild, "run_tetwild", lambda given: made)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotFilledWarning)
        whole, same = (odt_plugins.tetrahedralize(np.rint(3 * CUBE).astype(kind), FACES)
                       for kind in (np.int64, np.float64))
    assert np.array_equal(whole[0], same[0])
    assert np.array_equal(whole[1], same[1])


@pytest.mark.parametrize("kind", [np.uint8, np.uint32, np.uint64])
def test_faces_may_be_of_unsigned_numbers(stored, kind):
    odt_plugins.tetrahedralize(CUBE, FACES.astype(kind))
    np.testing.assert_array_equal(stored[1][0]["faces"], FACES)


def test_tetwild_gets_surfaces_far_from_the_origin_as_if_they_were_there(seen):
    mesh = meshio.read(STORED)
    grid, tets, values = background(lambda x: 0.1 + 0.0 * x[:, 0])
    away = np.array([5e5, -4.6e6, 3.0])
    points, _ = odt_plugins.tetrahedralize(CUBE + away, FACES, odt=False, bg_vertices=grid + away,
                                           bg_tets=tets, bg_values=values)
    left = np.array([0.0, -1.0, 3.0])
    assert np.array_equal(seen[0]["vertices"], CUBE + left)
    assert np.allclose(seen[0]["bg_vertices"], grid + left, atol=1e-9)
    assert np.array_equal(points, mesh.points + (away - left))


def test_a_small_surface_is_filled():
    scale = 1e-35
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        points, cells = odt_plugins.tetrahedralize(scale * CUBE, FACES, edge_length_fac=0.2)
    size = np.linalg.det((points / scale)[cells][:, 1:] - (points / scale)[cells][:, :1])
    assert np.abs(size).sum() / 6 == pytest.approx(1.0, rel=0.05)


def test_what_pytetwild_refuses_comes_through():
    pytest.importorskip("pytetwild")
    with pytest.raises(ValueError, match="Edge length factor must be between"):
        odt_plugins.tetrahedralize(CUBE, FACES, edge_length_fac=7.0)
    with pytest.raises(TypeError, match="must be a numpy array"):
        odt_plugins.tetrahedralize(CUBE.tolist(), FACES)
    with pytest.raises(InvalidMeshError, match="no tetrahedra inside the surface: it gave an empt"):
        odt_plugins.tetrahedralize(CUBE[:4], FACES[:1])


@pytest.mark.parametrize(("package", "name", "hint"), [
    ("pyvista", "Cube", r"mesh\.odt\.tetrahedralize\(\)"),
    ("trimesh.creation", "box", r"mesh\.vertices, mesh\.faces"),
    ("numpy", "array", "those of the mesh"),
])
def test_a_mesh_of_a_toolkit_in_place_of_arrays_is_refused(package, name, hint):
    mesh = getattr(pytest.importorskip(package), name)(*[CUBE] * (package == "numpy"))
    for call in (odt_plugins.tetrahedralize, odt_plugins.tetrahedralize_with_report):
        with pytest.raises(
            UnsupportedMeshError, match=f"as vertices, without faces; expected arrays.*{hint}$",
        ):
            call(mesh)


def test_vectors_of_a_toolkit_are_refused_with_what_makes_arrays_of_them(stored):
    open3d = pytest.importorskip("open3d")
    mesh = open3d.geometry.TriangleMesh(open3d.utility.Vector3dVector(CUBE),
                                        open3d.utility.Vector3iVector(FACES))
    for vertices, faces, name in ((mesh.vertices, mesh.triangles, "vertices"),
                                  (CUBE, mesh.triangles, "triangles"), (mesh, FACES, "vertices")):
        with pytest.raises(UnsupportedMeshError, match=rf"such as numpy.asarray\(mesh.{name}\)$"):
            odt_plugins.tetrahedralize(vertices, faces)
    odt_plugins.tetrahedralize(np.asarray(mesh.vertices), np.asarray(mesh.triangles))
    np.testing.assert_array_equal(stored[1][0]["faces"], FACES)


@pytest.mark.parametrize("call", [
    odt_plugins.tetrahedralize, odt_plugins.tetrahedralize_with_report,
    lambda *given: odt_plugins.tetrahedralize(*given, odt=False)])
def test_vertices_of_no_face_change_no_lengths(stored, call):
    far = np.full((1, 3), 99.0)
    call(np.concatenate([far, CUBE, far]), FACES + 1)
    (given,) = stored[1]
    np.testing.assert_array_equal(given["vertices"], CUBE)
    np.testing.assert_array_equal(given["faces"], FACES)


@pytest.mark.parametrize(("spoil", "message"), [
    (lambda v, f: (v * np.nan, f), r"8 points \(first: point 0\) with NaN"),
    (lambda v, f: (v, f + 100), r"12 faces \(first: face 0\) with vertex indices out of range"),
    (lambda v, f: (v, f[:0]), r"the surface has no faces \(8 vertices\); .* one triangle$"),
    (lambda v, f: (v[:, :2], f), r"vertices have shape \(8, 2\); expected \(n, 3\)"),
    (lambda v, f: (v, f.ravel()), r"faces have shape \(36,\); expected \(m, 3\)"),
    (lambda v, f: (v + 0j, f), r"vertices have dtype complex128; expected real numbers"),
    (lambda v, f: (np.ma.masked_less(v, 0.5), f), r"vertices has 12 masked values"),
    (lambda v, f: (v, np.ma.masked_equal(f, 1)), r"faces has \d+ masked values"),
])
def test_surfaces_that_would_end_tetwild_are_refused(spoil, message, monkeypatch):
    monkeypatch.setattr(tetwild, "run_tetwild", lambda given: pytest.fail("TetWild ran"))
    with pytest.raises(InvalidMeshError, match=message):
        odt_plugins.tetrahedralize(*spoil(CUBE, FACES))


def test_a_process_that_dies_is_one_sentence(monkeypatch):
    pytest.importorskip("pytetwild")
    monkeypatch.setattr(tetwild, "PROGRAM", "import os; os.abort()")
    with pytest.raises(InvalidMeshError, match=r"by SIGABRT; expected a closed surface"):
        odt_plugins.tetrahedralize(CUBE, FACES)
    monkeypatch.setattr("odt_plugins.errors.find_spec", lambda name: None)
    with pytest.raises(MissingDependencyError, match=r'pip install "odt-plugins\[pytetwild\]"'):
        odt_plugins.tetrahedralize(CUBE, FACES)


def test_only_arguments_that_differ_from_the_defaults_are_passed(monkeypatch):
    monkeypatch.setattr(tetwild, "PROGRAM", """
import pickle
names = sorted(pickle.load(open("arguments", "rb")))
pickle.dump(ValueError(" ".join(names)), open("result", "wb"))
""")
    monkeypatch.setattr("odt_plugins.errors.find_spec", lambda name: True)
    with pytest.raises(ValueError, match=r"^edge_length_fac faces stop_energy vertices$"):
        odt_plugins.tetrahedralize(CUBE, FACES, edge_length_fac=0.2, stop_energy=9.0, coarsen=False)


def test_sizes_are_linear_on_the_background_and_ideal_outside():
    def linear(x):
        return 2.0 + x @ [0.5, -0.25, 1.0]

    points, cells, values = background(linear)
    x = np.random.default_rng(1).uniform(-0.5, 1.5, (500, 3))
    inside = ((x >= -0.25) & (x <= 1.25)).all(axis=1)
    assert 50 < inside.sum() < 450
    for turned in (cells, contract.negative(cells)):
        sizes = tetwild.background_sizes(x, points, turned, values, outside=7.0)
        assert sizes[inside] == pytest.approx(linear(x[inside]), rel=1e-12)
        assert (sizes[~inside] == 7.0).all()
    at = tetwild.background_sizes(points, points, cells, values, outside=7.0)
    assert at == pytest.approx(values, rel=1e-12)
    rough = np.random.default_rng(2).uniform(1.0, 2.0, len(points))
    middle = points[cells].mean(axis=1)
    assert tetwild.background_sizes(middle, points, cells, rough, outside=7.0) == pytest.approx(
        rough[cells].mean(axis=1), rel=1e-12)
    nothing = tetwild.background_sizes(x, points, cells[:0], values, outside=7.0)
    assert nothing.tolist() == [7.0] * 500
    flat = np.vstack([cells, [[0, 1, 2, 3]]])
    assert tetwild.background_sizes(points, points, flat, values, outside=7.0) == pytest.approx(at)


@pytest.mark.parametrize("exponent", [None, 3.0])
def test_a_sizing_field_is_the_density(stored, monkeypatch, exponent):
    (points, _), _ = stored
    low, high = points.min(axis=0), points.max(axis=0)
    unit = (points - low) / (high - low).max()

    def size(x):
        return 0.1 + 0.3 * x[:, 0]

    grid, cells, values = background(size, n=3)
    field = {"bg_vertices": low + grid * (high - low).max(), "bg_tets": cells, "bg_values": values}
    seen = []
    monkeypatch.setattr(plan, "run", lambda mesh, options, _: (
        seen.append(options) or plan.Outcome(mesh.points, mesh.cells, mesh.regions)))
    group = {} if exponent is None else {"smoothing": {"exponent": exponent}}
    odt_plugins.tetrahedralize(CUBE, FACES, **group, **field)
    power, ideal = -(exponent or 5.0), 0.05 * np.sqrt(3.0)
    assert seen[0].density == pytest.approx((size(unit) / ideal) ** power, rel=1e-9)
    odt_plugins.tetrahedralize(CUBE, FACES, density="uniform", **field)
    assert seen[1].density == "uniform"
    shift = np.array([0.76, 0.0, 0.0])
    field["bg_vertices"] = field["bg_vertices"] + shift * (high - low).max()
    within = unit[:, 0] > 0.51
    assert 0 < within.sum() < len(within)
    for lengths, ideal in (({}, 0.05 * np.sqrt(3.0)), ({"edge_length_fac": 0.2}, 0.2 * np.sqrt(3)),
                           ({"edge_length_abs": 0.3}, 0.3)):
        odt_plugins.tetrahedralize(CUBE, FACES, **group, **field, **lengths)
        rho = (size(unit - shift) / ideal) ** power
        assert seen[-1].density == pytest.approx(np.where(within, rho, 1.0), rel=1e-9)


def test_cells_take_the_sizes_that_a_field_asks_for(monkeypatch):
    """Theorem 2.8: |tau| goes like rho^(-3/5), so the size of a cell goes like h^(r/5).

    Cells of one size in a ball come near that as far as the boundary, which stays, allows.
    """
    points, cells = tet_meshes.ball(1200, seed=3)
    monkeypatch.setattr(tetwild, "run_tetwild", lambda given: (points, cells))
    monkeypatch.setattr(tetwild, "compare_with_surface", lambda *_: None)

    def size(x):
        return 1.0 + 0.5 * x[:, 0]

    grid, tets, _ = background(size, n=3)
    grid = 2.0 * grid - 1.0
    slope = {}
    for r in (5.0, 3.0, None):
        odt = {"density": "uniform"} if r is None else {"smoothing": {"exponent": r}}
        p, t = odt_plugins.tetrahedralize(CUBE, FACES, bg_vertices=grid, bg_tets=tets,
                                          bg_values=size(grid), odt=odt)
        volume = np.abs(contract.volumes(p, t)) / 6
        wanted = np.log(size(p[t].mean(axis=1)))
        slope[r] = np.polyfit(wanted, np.log(volume) / 3, 1)[0]
    assert 0.65 < slope[5.0] < 1.0
    assert slope[3.0] == pytest.approx(0.6 * slope[5.0], abs=0.1)
    assert slope[None] == pytest.approx(0.0, abs=0.05)


def test_a_mesh_with_as_many_vertices_as_cells_gets_a_function(monkeypatch):
    points, cells, _ = contract.grid(3, 1)
    cells = np.vstack([cells, cells[:2]])
    monkeypatch.setattr(tetwild, "run_tetwild", lambda given: (points, cells))
    seen = []
    monkeypatch.setattr(tetwild, "compare_with_surface", lambda *_: None)
    monkeypatch.setattr(tetwild, "optimize_mesh", lambda mesh, **options: seen.append(options))
    grid, tets, values = background(lambda x: 1.0 + x[:, 2])
    odt_plugins.tetrahedralize(CUBE, FACES, bg_vertices=grid, bg_tets=tets, bg_values=values)
    ideal = 0.05 * np.sqrt(3.0)
    assert seen[0]["density"](points) == pytest.approx(((1.0 + points[:, 2]) / ideal) ** -5.0)
    odt_plugins.tetrahedralize(CUBE, FACES, bg_vertices=grid, bg_tets=tets,
                               bg_values=1e-30 * values, edge_length_abs=1e-30,
                               odt={"smoothing": {"exponent": 40.0}})
    assert seen[1]["density"](points) == pytest.approx((1.0 + points[:, 2]) ** -40.0)


@pytest.mark.parametrize("ordering", [False, True])
def test_the_surface_is_compared_with_the_boundary_and_turned_on_request(monkeypatch, ordering):
    aside = np.array([3.0, 0.0, 0.0])
    surface = np.concatenate([CUBE, CUBE + aside]), np.concatenate([FACES, FACES[:, ::-1] + 8])
    points, cells, _ = contract.grid(3, 3)
    cells = cells if ordering else cells[:, [0, 1, 3, 2]]
    both = (np.concatenate([points, points + aside]),
            np.concatenate([cells, cells + len(points)]))

    def run_tetwild(given):
        inside = np.linalg.det(given["vertices"][given["faces"]]).sum() / 6
        return both if inside > 1.5 else (points, cells)

    monkeypatch.setattr(tetwild, "run_tetwild", run_tetwild)
    options = {"vtk_ordering": ordering, "smoothing": {"rounds": 1}}
    with pytest.warns(NotFilledWarning, match=r"50.0% of the area of.*try repair='orient'"):
        _, report = odt_plugins.tetrahedralize_with_report(*surface, **options)
    assert report.filled.missing == pytest.approx(0.5)
    assert report.filled.elsewhere == 0.0
    assert report.filled.missing_at[0].low == pytest.approx((3, 0, 0))
    with pytest.warns(NotFilledWarning, match="50.0%"):
        odt_plugins.tetrahedralize(*surface, **options)
    out = odt_plugins.tetrahedralize(*surface, repair="orient", **options)
    assert np.abs(contract.volumes(*out)).sum() / 6 == pytest.approx(2)
    assert np.array_equal(surface[1][12:], FACES[:, ::-1] + 8)
    odt_plugins.tetrahedralize(*surface, odt=False)


@pytest.mark.parametrize("how", [
    {"edge_length_fac": 0}, {"edge_length_fac": "a"}, {"edge_length_abs": -1.0},
    {"epsilon": -1.0}, {"epsilon": float("nan")}, {"stop_energy": None}])
def test_lengths_that_are_none_are_refused_before_tetwild_runs(how):
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    name, value = next(iter(how.items()))
    said = f"got {name}={value!r}; expected a number above 0"
    with pytest.raises(InvalidOptionError, match=said):
        odt_plugins.tetrahedralize(points, faces, **how)
