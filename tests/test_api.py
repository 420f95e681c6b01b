"""The public functions: one set of options, one result whatever the wrapping."""

from __future__ import annotations

import doctest
import inspect
import re
from dataclasses import fields
from itertools import pairwise, product
from pathlib import Path
from typing import Any, get_args, get_type_hints

import contract
import meshio
import numpy as np
import option_table
import pytest
import surface_meshes as sm
import tet_meshes as tm
from scipy.spatial import Delaunay

import odt_plugins
from odt_plugins import api
from odt_plugins.carrying import roundtrip
from odt_plugins.carrying.sources import in_input_order
from odt_plugins.engine.odt import rounds
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.run import plan
from odt_plugins.engine.surface import driver as surface_driver
from odt_plugins.engine.surface import rounds as surface_rounds
from odt_plugins.errors import InvalidMeshError, InvalidOptionError
from odt_plugins.hosts import filter_table, open3d_filters, pyvista_accessor
from odt_plugins.keywords import OptionKeywords
from odt_plugins.mesh.plane import plane_frame
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.options import (
    DENSITIES,
    FIGURES,
    OPTIONS,
    SMOOTHING,
    SOLVERS,
    Method,
    Options,
    Smoothing,
    Solver,
    make_options,
)

DATA = Path(__file__).parent / "data"


def test_options_are_the_keywords_of_every_public_function():
    options = {f.name: f.default for f in fields(Options)}
    for function in (odt_plugins.optimize, odt_plugins.optimize_with_report):
        parameters = inspect.signature(function).parameters.values()
        keywords = {p.name: p.default for p in parameters if p.kind is p.KEYWORD_ONLY}
        own = ("target", "file_format", "binary", "blocks", "block_rounds", "workers", "client")
        assert [keywords.pop(name) for name in own] == [None, None, None, None, 3, 0, None]
        assert keywords == options
        assert list(keywords) == list(options)


def test_the_verbs_are_few_and_those_that_give_a_mesh_have_a_twin_with_a_report():
    functions = {name for name in odt_plugins.__all__
                 if inspect.isfunction(getattr(odt_plugins, name))}
    verbs = {name for name in functions if not name.endswith("_with_report")}
    arrays = {"metric_from_field"}
    assert len(verbs - arrays) <= 8
    assert len(OPTIONS) <= 20
    plain = {"quality", "register", "run_filter_script", *arrays}
    assert functions - verbs == {f"{name}_with_report" for name in verbs - plain}


def test_the_types_of_keywords_are_those_of_options():
    keywords, of_options = get_type_hints(OptionKeywords), get_type_hints(Options)
    assert list(keywords) == list(of_options) == list(OPTIONS)
    for name, kind in keywords.items():
        assert of_options[name] in (kind, Any, *get_args(kind)), name


def test_hosts_show_the_keywords_that_they_take():
    named = set(OPTIONS)
    for function, without in (
        (open3d_filters.optimize_odt, set()),
        (open3d_filters.filter_smooth_cpt,
         {"method", "finish", "objective", "insert"}),
        (pyvista_accessor.OdtAccessor.optimize, set()),
        (odt_plugins.refine_with_report, set()),
        (odt_plugins.tetrahedralize, set()),
    ):
        parameters = inspect.signature(function).parameters
        assert set(parameters) & named == named - without, function
        assert "options" not in parameters
        assert ("odt" in parameters) == (function is odt_plugins.tetrahedralize)


def test_the_parameters_for_meshlab_are_those_of_options():
    table = filter_table
    for parameter, name in ((table.ROUNDS, "rounds"), (table.ITERATIONS, "cycles"),
                            (table.DENSITY, "density"), (table.ANGLE, "feature_angle")):
        assert parameter.default == (OPTIONS | SMOOTHING)[name].default
    assert table.ENVELOPE.default == pytest.approx(100.0 * Options.envelope)
    assert table.DENSITY.choices == DENSITIES
    assert table.DENSITY.help == OPTIONS["density"].metadata["help"]


def test_every_option_is_documented():
    text = " ".join(Options.__doc__.split())
    for name, about in OPTIONS.items():
        assert f"{name} : " in text
        assert about.metadata["help"].endswith(".")
        for part in ("help", "python"):
            assert about.metadata[part] in text, name


def test_the_table_of_options_on_the_page_is_that_of_the_package():
    page = option_table.PAGE.read_text(encoding="utf-8")
    assert option_table.on_page(page) == option_table.table(), (
        "run python tests/helpers/option_table.py")


@pytest.mark.parametrize("name", ["method", "boundary"])
def test_every_named_choice_is_accepted(name):
    for choice in OPTIONS[name].metadata["choices"]:
        assert getattr(make_options(**{name: choice}), name) == choice


@pytest.mark.parametrize("name", ["solver", "connectivity"])
def test_every_named_choice_of_smoothing_is_accepted_and_told(name):
    for choice in SMOOTHING[name].metadata["choices"]:
        assert getattr(make_options(smoothing={name: choice}).smoothing, name) == choice
        assert choice in OPTIONS["smoothing"].metadata["help"]


PAIRS = list(product(get_args(Method), get_args(Solver)))


def test_every_pair_of_method_and_solver_that_there_is_has_its_step():
    made = {(method, solver) for method, solvers in SOLVERS.items() for solver in solvers}
    assert made == set(rounds.STEPS)
    assert set(surface_rounds.STEPS) < made
    for method, solver in PAIRS:
        if (method, solver) in made:
            found = Options(method=method, smoothing={"solver": solver})
            assert found.smoothing.solver == solver
            continue
        message = (f"got method='{method}', smoothing={{'solver': '{solver}'}}; expected one of .* "
                   "as the solver of this method, try smoothing={'solver': 'gauss-seidel'}")
        with pytest.raises(InvalidOptionError, match=message):
            Options(method=method, smoothing={"solver": solver})


@pytest.mark.parametrize(("options", "message"), [
    ({"smoothing": {"cycles": 2}, "finish": False},
     "got smoothing={'cycles': 2}; expected 1 without finishing"),
    ({"smoothing": {"cycles": 0}, "finish": False},
     "got smoothing={'cycles': 0}; expected 1 without finishing"),
    ({"method": "laplacian", "density": "inverse-volume"},
     "got density='inverse-volume'; expected 'uniform' for the method 'laplacian'"),
])
def test_options_without_effect_are_refused(options, message):
    with pytest.raises(InvalidOptionError, match=message):
        Options(**options)


def test_omega_may_be_what_it_is_unless_it_is_given():
    for value in (POLICY.stirred, POLICY.overrelaxed, POLICY.damped):
        assert Options(smoothing={"omega": value}).smoothing.omega == value
    for value in (0.0, 3.01):
        with pytest.raises(InvalidOptionError, match="above 0 and at most 3"):
            Options(smoothing={"omega": value})


@pytest.mark.parametrize("name", [n for n in odt_plugins.__all__ if n != "__version__"])
def test_every_parameter_is_documented(name):
    """Where a docstring lists parameters, none is missing, neither one that help() leaves out."""
    function = getattr(odt_plugins, name)
    text = inspect.getdoc(function) or ""
    if not inspect.isfunction(function) or "Parameters\n---" not in text:
        return
    listed = text.partition("Parameters\n")[2].partition("\n\n")[0]
    code = function.__code__
    own = () if ", ..., " in listed else code.co_varnames[:code.co_argcount
                                                           + code.co_kwonlyargcount]
    assert [name for name in own if not re.search(rf"\b{name}\b", listed)] == []


def test_options_cannot_be_made_wrong_by_hand_either():
    with pytest.raises(InvalidOptionError, match=r"got smoothing={'rounds': -3}"):
        Options(smoothing={"rounds": -3})


def test_truths_of_numpy_are_taken_as_those_of_python():
    given = contract.HOSTS["arrays-tet"].make()
    report = odt_plugins.optimize_with_report(
        given, finish=np.bool_(False), insert=np.bool_(False), progress=np.bool_(False))[1]
    assert report.options["finish"] is False
    odt_plugins.untangle(given, partial=np.bool_(True))
    assert len(odt_plugins.refine(given, 1, optimize=np.bool_(False))[1]) == 8 * len(given[1])


@pytest.mark.parametrize("name", ["nope", ["pyvista"], None])
def test_what_is_no_name_of_a_toolkit_is_refused(name):
    with pytest.raises(InvalidOptionError, match=r"got the toolkit .*; expected one of"):
        odt_plugins.register(name)


def test_the_doctests_hold():
    for module in (api, odt_plugins):
        result = doctest.testmod(module)
        assert result.failed == 0
    assert doctest.testmod(api).attempted >= 8


def test_optimize_and_the_report_give_the_same_mesh():
    mesh = contract.HOSTS["meshio-tet"].make()
    view = contract.HOSTS["meshio-tet"].view
    alone = odt_plugins.optimize(mesh)
    both, report = odt_plugins.optimize_with_report(mesh)
    assert contract.same_bits(view(alone), view(both))
    assert isinstance(report, odt_plugins.Report)
    assert report.after == odt_plugins.quality(both)
    assert report.before == odt_plugins.quality(mesh)
    for name in FIGURES:
        sign = -1.0 if name == "max_angle" else 1.0
        assert sign * getattr(report.after, name) >= sign * getattr(report.before, name) - 1e-12


def test_the_wrapping_does_not_decide_the_result():
    pyvista = pytest.importorskip("pyvista")
    mesh = meshio.read(DATA / "tetwild_bunny.vtu")
    points, cells = mesh.points, mesh.cells[0].data
    assert (contract.volumes(points, cells) < 0).all()
    short = {"smoothing": {"rounds": 2, "cycles": 1}}
    a, b = odt_plugins.optimize((points, cells.astype(np.int32)), **short)
    assert (contract.volumes(a, b) < 0).all()
    turned = cells[:, [0, 1, 3, 2]]
    grid = odt_plugins.optimize(pyvista.UnstructuredGrid({10: turned}, points), **short)
    assert grid.points.tobytes() == a.tobytes()
    assert np.array_equal(grid.cells_dict[10][:, [0, 1, 3, 2]], b)
    for other in (mesh, DATA / "tetwild_bunny.vtu"):
        out = odt_plugins.optimize(other, **short)
        assert out.points.tobytes() == a.tobytes()
        assert np.array_equal(out.cells[0].data, b)


def test_a_plane_in_space_gives_what_the_plane_gives():
    points, cells, labels = contract.grid(2, 6)
    flat, _, _ = odt_plugins.optimize((points, cells, labels))
    for axis in range(3):
        space = np.insert(points, axis, -1.0 / 3.0, axis=1)
        out, _, _ = odt_plugins.optimize((space, cells, labels))
        assert np.delete(out, axis, axis=1).tobytes() == flat.tobytes()
        assert (out[:, axis] == -1.0 / 3.0).all()
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    space = points @ turn[:2]
    out, out_cells, out_labels = odt_plugins.optimize((space, cells, labels))
    view = contract.View(space, cells, {}, {"marker": labels}, {})
    held = np.unique([list(f) for f in contract.facets(cells, labels)])
    assert out[held].tobytes() == view.points[held].tobytes()
    assert (out @ turn[2]) == pytest.approx(np.zeros(len(out)), abs=1e-14)
    back = out @ turn[:2].T
    assert (contract.volumes(back, out_cells) > 0).all()
    assert contract.facets(out_cells, out_labels) == contract.facets(cells, labels)
    assert not np.array_equal(out, space)


def test_measure_counts_flat_and_inverted_cells():
    points = np.array([[0.0, 0], [1, 0], [0, 1], [1, 1], [0.5, 0.0]])
    summary = odt_plugins.quality((points, np.array([[0, 1, 2], [1, 2, 3], [0, 1, 4], [1, 3, 2]])))
    assert summary.inverted == 2
    assert summary.n_cells == 4
    turned = odt_plugins.quality((points, np.array([[0, 2, 1], [1, 2, 3]])))
    assert turned.inverted == 0
    assert turned.volume == pytest.approx(1.0)
    inradius, circumradius = 1.0 - np.sqrt(0.5), np.sqrt(0.5)
    assert turned.min_quality == pytest.approx(2.0 * inradius / circumradius, rel=1e-12)


def test_measure_refuses_what_is_no_mesh():
    with pytest.raises(InvalidMeshError, match="no cells"):
        odt_plugins.quality((np.zeros((3, 2)), np.zeros((0, 3), dtype=int)))


def test_progress_and_options_reach_the_engine(monkeypatch):
    seen = []

    def run(mesh, options, leaving):
        seen.append(options)
        return plan.Outcome(mesh.points, mesh.cells, mesh.regions)

    told = []

    def progress(stage, fraction):
        told.append((stage, fraction))

    monkeypatch.setattr(plan, "run", run)
    points, cells, _ = contract.grid(2, 2)
    given = {"method": "cpt", "smoothing": {"rounds": 3, "exponent": 3.0}, "threads": 2,
             "progress": progress}
    odt_plugins.optimize((points, cells), **given)
    seen[0].progress("smoothing", 0.5)
    assert told[-1] == ("smoothing", 1.0), "what came to its end does not go back"
    assert {**{name: getattr(seen[0], name) for name in given},
            "progress": progress} == given | {"smoothing": Smoothing(rounds=3, exponent=3.0)}


def test_a_single_figure_to_keep_is_a_word():
    points, cells, _ = contract.grid(2, 5)
    assert make_options(keep="mean_quality").keep == ("mean_quality",)
    one, two = (odt_plugins.optimize((points, cells), keep=keep)
                for keep in ("min_quality", ("min_quality",)))
    assert np.array_equal(one[0], two[0])
    with pytest.raises(odt_plugins.InvalidOptionError, match="got keep='quality'; expected some"):
        odt_plugins.optimize((points, cells), keep="quality")


@pytest.mark.parametrize("kind", [list, tuple])
def test_lists_of_rows_are_arrays_too_and_come_back_as_lists(kind, tmp_path):
    points, cells, labels = contract.grid(2, 5)
    arrays = (points, cells, labels)
    rows = kind([points.tolist(), [tuple(cell) for cell in cells.tolist()], labels.tolist()])
    before = repr(rows)
    for k in (2, 3):
        assert odt_plugins.quality(rows[:k]) == odt_plugins.quality(arrays[:k])
        out = odt_plugins.optimize(rows[:k])
        assert type(out) is kind
        assert list(out) == [part.tolist() for part in odt_plugins.optimize(arrays[:k])]
    assert repr(rows) == before
    mixed = odt_plugins.optimize((points, cells.tolist()))
    assert (type(mixed[0]), type(mixed[1])) == (np.ndarray, list)
    assert odt_plugins.quality([[[0, 0], [2, 0], [0, 1]], [[0, 1, 2]]]).area == 1.0
    meshio.Mesh(points, [("triangle", cells)]).write(tmp_path / "in.vtu")
    assert odt_plugins.quality(tmp_path / "in.vtu").n_cells == len(cells)
    for bad in ([[0.0], [1.0, 2.0]], [["a", "b"]]):
        with pytest.raises(odt_plugins.InvalidMeshError, match="points that are no rows of num"):
            odt_plugins.quality((bad, [[0, 1, 2]]))


@pytest.mark.parametrize("k", [3, 4])
def test_a_cell_that_comes_back_the_other_way_round_keeps_its_new_row(k):
    points = np.vstack([np.zeros(k - 1), np.eye(k - 1)])
    cells = np.arange(k, dtype=np.int32)[None]
    labels = np.zeros(1, dtype=np.int32)
    before = SimplexMesh(points, cells, labels, np.zeros(k, dtype=bool))
    mirrored = points.copy()
    mirrored[:, 0] *= -1.0
    turned = cells[:, [1, 0, *range(2, k)]]
    assert np.array_equal(in_input_order(before, mirrored, turned, labels)[0], turned)
    rotated = cells[:, [1, 2, 0, *range(3, k)]]
    assert np.array_equal(in_input_order(before, points, rotated, labels)[0], cells)


def test_cells_turned_on_the_way_out_are_never_returned(monkeypatch):
    points, cells = tm.ball(200, 3)

    def turned(before, points, cells, regions, threads):
        turn = [0, 1, 2, 3] if np.array_equal(points, before.points) else [1, 0, 2, 3]
        return cells[:, turn], regions, np.arange(len(cells), dtype=np.int32)

    monkeypatch.setattr(roundtrip, "in_input_order", turned)
    (new_points, new_cells), report = odt_plugins.optimize_with_report((points, cells))
    assert new_points.tobytes() == points.tobytes()
    assert np.array_equal(new_cells, cells)
    assert "not positive" in report.fallback


def judged_and_left(monkeypatch, place, mesh, **options):
    """The meshes that the engine judged, the last of them its result, and what the caller got."""
    judged = []
    real = place.faults

    def sees(before, *given):
        judged.append(next((points, cells) for points, cells in pairwise(given)
                           if isinstance(points, np.ndarray)))
        return real(before, *given)

    monkeypatch.setattr(place, "faults", sees)
    out = odt_plugins.optimize(mesh, **options)
    return judged, out


@pytest.mark.parametrize("shape", ["space", "plane", "tilted plane", "surface"])
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_the_engine_judges_exactly_what_leaves(shape, kind, monkeypatch):
    place, turn = plan, None
    if shape == "space":
        points, cells = tm.ball(150, 2)
    elif shape == "surface":
        place = surface_driver
        points, cells = sm.sphere(2)
        points = points + 0.02 * np.random.default_rng(0).normal(size=points.shape)
    else:
        points, cells, _ = contract.grid(2, 6)
        if shape == "tilted plane":
            turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
            points = points @ turn[:2]
    points = points.astype(kind)
    judged, (new, new_cells) = judged_and_left(monkeypatch, place, (points, cells))
    assert len(judged) == 1
    assert new.dtype == kind
    assert (new != points).any()
    read = new.astype(np.float64)
    if turn is not None:
        frame = plane_frame(points.astype(np.float64), cells)
        read = frame.to_plane(read)
    assert judged[0][0].tobytes() == read.tobytes()
    assert np.array_equal(judged[0][1], new_cells)


@pytest.mark.parametrize("seed", range(6))
def test_no_cell_of_the_result_is_turned_over(seed):
    points, cells = tm.ball(400, seed)
    new_points, new_cells = odt_plugins.optimize((points, cells), smoothing={"cycles": 1})
    assert (tm.signed_volumes(new_points, new_cells) > 0).all()


@pytest.mark.parametrize("tilted", [False, True])
def test_places_of_triangles_in_a_plane_of_space_are_told_in_space(tilted):
    flat = np.random.default_rng(2).random((60, 2))
    cells = Delaunay(flat).simplices
    points = np.array([30.0, 10.0, 20.0]) + np.insert(flat, 0, 0.0, axis=1)
    if tilted:
        points = points @ np.linalg.qr(np.arange(9.0).reshape(3, 3) ** 2 + np.eye(3))[0]
    _, report = odt_plugins.remesh_with_report((points, cells), cells=400, boundary="fixed")
    with pytest.raises(InvalidOptionError, match="index 0") as told:
        odt_plugins.remesh((points, cells), lambda x: np.zeros(len(x)))
    for text, known in ((report.notes[-1], points), (str(told.value), points[:1])):
        place = np.array(re.search(r"(?:near|at) \((.*?)\)", text)[1].split(","), float)
        assert len(place) == 3
        assert np.abs(known - place).max(axis=1).min() < (0.3 if len(known) > 1 else 1e-3)
