"""The report says what happened, in text, JSON and a figure."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import tet_meshes

import odt_plugins
from odt_plugins.engine.run.outcome import Outcome
from odt_plugins.errors import MeshFileError, MissingDependencyError
from odt_plugins.figures import CellFigures, cell_figures, radius_ratio
from odt_plugins.mesh.simplex import SimplexMesh, simplex_mesh
from odt_plugins.options import Options
from odt_plugins.report import binding, plotting
from odt_plugins.report.binding import best_quality_on, binding_cells
from odt_plugins.report.report import BINS, Report, histogram, make_report
from odt_plugins.table import ROWS, table_html, table_lines

STORED = Path(__file__).parents[1] / "data" / "tetwild_bunny.vtu"


def fan(height: float = 0.4) -> SimplexMesh:
    """Four tetrahedra around one inner vertex."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.2, 0.2, height * 0.5]])
    cells = np.array([[0, 1, 2, 4], [0, 1, 3, 4], [0, 2, 3, 4], [1, 2, 3, 4]])
    return simplex_mesh(points, cells)[0]


def outcome(mesh: SimplexMesh, **changes: object) -> Outcome:
    plain = Outcome(mesh.points, mesh.cells, mesh.regions, energy=[("start", 2.0), ("odt", 1.5)],
                    times={"smoothing": 0.25}, stop_reason="the energy settled",
                    counts={"flips": 3})
    return replace(plain, **changes)


@pytest.fixture
def report() -> Report:
    mesh = fan()
    moved = mesh.points.copy()
    moved[4] = 0.21
    return make_report(mesh, outcome(mesh, points=moved), Options(threads=2))


def test_the_text_holds_both_columns_and_the_story(report: Report) -> None:
    text = str(report)
    for part in (f"{report.before.min_quality:.4f}", f"{report.after.min_quality:.4f}",
                 "smallest dihedral", "1 of 5 vertices may move (20 %)", "energy 2 -> 1.5",
                 "smoothing 0.25 s", "flips 3", "the energy settled", "what binds the minimum"):
        assert part in text
    assert "fell back" not in text
    assert max(map(len, text.splitlines())) < 120


def test_columns_stay_apart_and_narrow_when_figures_are_huge(report: Report) -> None:
    flat = replace(report.before, mean_amips=1939365536099.3213, max_amips=np.inf, uniformity=-3e7)
    lines = table_lines({"before": flat, "after": flat})
    assert all(len(line) == 40 for line in lines)
    found = {line[:20].strip(): line[20:].split() for line in lines[1:]}
    assert all(len(cells) == 2 and cells[0] == cells[1] for cells in found.values())
    assert found["mean AMIPS energy"][0] == "1.94e+12"
    assert found["max AMIPS energy"][0] == "inf"
    assert found["uniformity"][0] == "-3e+07"
    many = table_lines({"a.vtu": replace(flat, n_cells=12345678901)})
    assert len(many[-1]) == len(many[0]) == 33


def test_figures_and_reports_print_as_tables_and_have_html_for_notebooks(report: Report) -> None:
    assert report.before.turned > 0
    assert report.after.turned == 0
    rows = [line for line in str(report).splitlines()[1 : len(ROWS) + 1] if "turned" not in line]
    assert [line.split() for line in str(report.after).splitlines()] == [
        [*line[:20].split(), line.split()[-1]] for line in rows]
    page = table_html({"<a>": report.before, "b": report.after})
    assert page.startswith("<table><tr><th></th><th>&lt;a&gt;</th><th>b</th></tr>")
    assert page.count("<tr>") == len(ROWS) + 1
    assert page.count("<td>") == 2 * len(ROWS)
    single = report.after._repr_html_()
    assert single.startswith("<table><tr><th>min quality</th><td>")
    assert single.count("<td>") == len(ROWS) - 1
    whole = report._repr_html_()
    assert f"<td>{report.after.min_quality:.4f}</td>" in whole
    assert "what binds the minimum" in whole
    ElementTree.fromstring(f"<div>{whole}</div>")


def test_the_volume_of_triangles_is_called_their_area(report: Report) -> None:
    flat = odt_plugins.quality((np.array([[0.0, 0], [2, 0], [0, 1]]), np.array([[0, 1, 2]])))
    assert flat.area == flat.volume == flat.to_dict()["area"] == 1.0
    assert "volume" not in flat.to_dict()
    assert "area" in str(flat)
    assert "volume" not in str(flat) + flat._repr_html_()
    solid = report.before
    assert solid.to_dict()["volume"] == solid.volume
    assert "volume" in str(solid)
    assert "area" not in str(solid)
    with pytest.raises(AttributeError, match="expected triangles, try volume"):
        _ = solid.area


def test_a_report_in_a_list_is_one_line(report: Report) -> None:
    assert "\n" not in repr(report)
    assert len(repr(report)) < 120
    assert f"{report.after.min_quality:.4f}" in repr(report)


def test_a_fallback_is_said() -> None:
    mesh = fan()
    text = str(make_report(mesh, outcome(mesh, fallback="the input: a cell inverted"), Options()))
    assert "fell back: the input: a cell inverted" in text


def test_json_is_strict_and_complete(report: Report) -> None:
    data = json.loads(report.to_json(), parse_constant=pytest.fail)
    assert {f.name for f in fields(Report)} - set(data) == {
        "cell_origin", "meshes", "metrics", "carrying", "plane"}
    assert data == report.to_dict()
    assert data["movable_share"] == 0.2
    assert data["before"]["mean_quality"] == report.before.mean_quality
    assert data["options"]["threads"] == 2
    assert data["versions"]["odt-plugins"]


def test_json_without_nan_where_a_figure_is_infinite() -> None:
    mesh = fan()
    flat = mesh.points.copy()
    flat[4] = [0.2, 0.2, 0.0]
    bad = make_report(mesh, outcome(mesh, points=flat, energy=[("start", float("nan"))]), Options())
    data = json.loads(bad.to_json(), parse_constant=pytest.fail)
    assert data["after"]["uniformity"] is None
    assert data["energy"] == [["start", None]]


def test_options_are_told_as_plain_values() -> None:
    def rho(x: np.ndarray) -> np.ndarray:
        return x[:, 0]

    mesh = fan()
    told = make_report(mesh, outcome(mesh), Options(density=rho, fixed=np.arange(3))).options
    assert told["density"] == "function rho"
    assert told["fixed"] == "int64 array of shape (3,)"
    assert "progress" not in told
    for names in (["body", "part"], ("body", "part")):
        options = Options(regions=names)
        assert make_report(mesh, outcome(mesh), options).options["regions"] == ["body", "part"]
    assert set(told) == {f.name for f in fields(Options)} - {"progress"}


def test_histogram_has_the_bins_of_the_paper_and_loses_no_cell() -> None:
    assert np.allclose(BINS, 0.02 * np.arange(51))
    values = np.array([-0.5, 0.0, 0.019, 0.021, 0.5, 0.999, 1.0, 1.0 + 1e-15])
    counts = histogram(values)
    assert sum(counts) == len(values)
    assert (counts[0], counts[1], counts[49]) == (3, 1, 3)


def test_table_sets_any_number_of_meshes_side_by_side(report: Report) -> None:
    lines = table_lines({"one.vtu": report.before, "two.vtu": report.after, "3": report.after})
    assert lines[0].split() == ["one.vtu", "two.vtu", "3"]
    assert len({len(line) for line in lines}) == 1


def test_best_quality_on_a_triangle_in_closed_form() -> None:
    """On an equilateral triangle the regular tetrahedron; never less than a sampled apex."""
    assert best_quality_on(np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 0.75**0.5, 0]])) == \
        pytest.approx(1.0, abs=1e-6)
    rng = np.random.default_rng(827)
    for _ in range(5):
        triangle = rng.normal(size=(3, 3))
        limit = best_quality_on(triangle)
        size = np.linalg.norm(triangle - triangle.mean(axis=0), axis=1).max()
        apex = triangle.mean(axis=0) + size * rng.normal(size=(20000, 3))
        cells = np.column_stack([np.tile([0, 1, 2], (20000, 1)), np.arange(3, 20003)])
        sampled = np.abs(radius_ratio(np.vstack([triangle, apex]), cells)).max()
        assert sampled <= limit + 1e-9
        assert limit <= sampled + 0.05
        assert best_quality_on(1e9 * triangle + 5) == pytest.approx(limit, abs=1e-6)
    assert best_quality_on(np.zeros((3, 3))) == 0.0


def bind(mesh: SimplexMesh, movable: list[int]) -> dict[int, binding.BindingCell]:
    mask = np.isin(np.arange(len(mesh.points)), movable)
    figures = cell_figures(mesh.points, mesh.cells)
    return {b.cell: b for b in binding_cells(mesh.points, mesh.cells, mesh.regions, mask, figures)}


def test_binding_all_vertices_fixed() -> None:
    reasons = {b.reason for b in bind(fan(), []).values()}
    assert reasons == {"all its 4 vertices are fixed"}


def test_what_binds_names_the_option_that_frees_it() -> None:
    mesh = fan()
    n = len(mesh.points)
    mask = np.zeros(n, bool)
    figures = cell_figures(mesh.points, mesh.cells)
    first = np.zeros(n, bool)
    first[mesh.cells[0]] = True
    freeing = binding.Freeing({'boundary="slide"': np.ones(n, bool), "regions=None": first},
                              "insert=True", "envelope=0.002")
    given = (mesh.points, mesh.cells, mesh.regions)
    found = {b.cell: b for b in binding_cells(*given, mask, figures, freeing)}
    assert found[0].hint == 'boundary="slide" and regions=None and insert=True'
    assert str(found[0]).endswith("are fixed; try " + found[0].hint)
    moving = binding_cells(*given, ~mask, figures, freeing)
    assert {b.hint for b in moving} == {"insert=True and envelope=0.002"}
    assert {b.hint for b in binding_cells(*given, mask, figures)} == {""}


@pytest.mark.parametrize(("given", "names", "said"), [
    ((), ("layers",), 'free="layers"'), ((), ("inside", "layers"), 'free=("inside", "layers")'),
    (("periodic",), ("layers",), 'free=("periodic", "layers")'), (("periodic",), (), ""),
])
def test_words_of_free_are_one_option_with_those_that_were_given(
    given: Any, names: Any, said: str
) -> None:
    mesh = fan()
    held = {f'free="{name}"': np.ones(len(mesh.points), bool) for name in names}
    cells = binding_cells(
        mesh.points, mesh.cells, mesh.regions, np.zeros(len(mesh.points), bool),
        cell_figures(mesh.points, mesh.cells), binding.Freeing(held, free=given))
    assert {b.hint for b in cells} == {said}


def test_equal_reasons_are_one_line_with_a_count() -> None:
    cells = list(bind(fan(), []).values())
    assert len(cells) > 2
    (line,) = binding.joined_lines(cells, 5)
    assert line == f"{cells[0]} (and {len(cells) - 1} more)"
    other = replace(cells[1], hint="insert=True")
    lines = binding.joined_lines([cells[0], other, cells[2]], 5)
    assert lines == [f"{cells[0]} (and 1 more)", str(other)]
    assert len(binding.joined_lines([cells[0], other], 1)) == 1


@pytest.mark.parametrize(("options", "said"), [
    ({}, ('boundary="slide"', "insert=True")),
    ({"insert": True}, ('boundary="slide"',)),
    ({"boundary": "slide"}, ("envelope=0.002", "insert=True")),
])
def test_a_report_says_what_frees_the_worst_cells(options: dict[str, Any], said: Any) -> None:
    _, report = odt_plugins.optimize_with_report(STORED, smoothing={"rounds": 1, "cycles": 1},
                                                 **options)
    hints = {b.hint for b in report.binding if b.reason == "all its 4 vertices are fixed"}
    assert hints == {" and ".join(said)}
    text = str(report)
    assert text.count("all its 4 vertices are fixed") <= 1
    assert report.to_dict()["binding"][0]["hint"] == report.binding[0].hint


@pytest.mark.parametrize(("refused", "said"), [
    ((), 'boundary="slide" and insert=True'), (("insert",), 'boundary="slide"'),
    (("boundary",), "insert=True"), (("free='inside'", "insert", "boundary"), ""),
])
def test_no_option_is_advised_that_the_call_refuses(refused: Any, said: str) -> None:
    mesh = fan()
    report = make_report(mesh, outcome(mesh), Options(), refused=refused)
    assert {b.hint for b in report.binding} == {said}


@pytest.mark.parametrize("given", [
    {"finish": False}, {"smoothing": {"connectivity": "none"}}, {"metric": "input"},
])
def test_vertices_inside_are_not_advised_where_none_may_come(given: Any) -> None:
    mesh = replace(fan(), frozen=np.ones(len(fan().cells), bool))
    report = make_report(mesh, outcome(mesh), Options(**given))
    assert {b.hint for b in report.binding} == {'free="layers"'}


@pytest.mark.parametrize(("free", "said"), [
    ((), {'free="layers" and insert=True'}), (("layers",), {"insert=True"}),
    (("inside",), {'free=("inside", "layers") and insert=True'}),
])
def test_a_word_of_free_is_advised_unless_it_is_given(free: Any, said: Any) -> None:
    mesh = replace(fan(), frozen=np.ones(len(fan().cells), bool))
    report = make_report(mesh, outcome(mesh), Options(free=free))
    assert {b.hint for b in report.binding} == said


def test_each_call_tells_what_it_refuses(monkeypatch: pytest.MonkeyPatch) -> None:
    from odt_plugins import api, remeshing

    told: list[Any] = []

    def instead(mesh: Any, options: Any, engine: Any, wanted: Any) -> Any:
        told.append(wanted.refused)
        raise MeshFileError

    for module in (api, remeshing):
        monkeypatch.setattr(module, "run_engine", instead)
    tet = (np.zeros((4, 3)), np.array([[0, 1, 2, 3]]))
    with pytest.raises(MeshFileError):
        odt_plugins.remesh(tet, 1.0)
    with pytest.raises(MeshFileError):
        odt_plugins.untangle(tet)
    assert {"insert", "free='inside'"} <= {*told[0]}
    assert {"boundary", "envelope", "free"} <= {*told[1]}
    assert "insert" not in told[1]


def test_fixed_selected_and_labelled_vertices_have_hints_of_their_own() -> None:
    points, cells = tet_meshes.ball(150, 3)
    half = (points[cells].mean(axis=1)[:, 0] > 0).astype(np.int32)
    inside = np.linalg.norm(points, axis=1) < 0.9 * np.linalg.norm(points, axis=1).max()
    for options, word in (({"fixed": inside}, "fewer vertices in fixed"),
                          ({"selection": np.arange(3)}, "a larger selection"),
                          ({"regions": half}, "regions=None")):
        _, report = odt_plugins.optimize_with_report((points, cells), smoothing={"rounds": 1},
                                                     **options)
        assert any(word in b.hint for b in report.binding), options


def test_a_veto_says_what_was_refused_and_how_to_have_it() -> None:
    _, report = odt_plugins.optimize_with_report(STORED.with_name("tetwild_csg.vtu"), finish=False)
    veto = report.vetoed
    assert veto is not None
    assert veto["mean_quality"] > report.after.mean_quality + 0.005
    for name, (before, there) in veto["worse"].items():
        assert before == pytest.approx(getattr(report.before, name, before), rel=1e-6)
        assert (there > before) == (name in ("max_angle", "share_below_20"))
    (line,) = [line for line in str(report).splitlines() if line.startswith("veto ")]
    left = tuple(name for name in report.options["keep"] if name not in veto["worse"])
    assert line.endswith(f"try keep={left!r}")
    assert f"a state with mean q {veto['mean_quality']:.3f}" in line
    _, freed = odt_plugins.optimize_with_report(
        STORED.with_name("tetwild_csg.vtu"), finish=False, keep=left)
    assert freed.after.mean_quality > report.after.mean_quality + 0.005
    assert freed.vetoed is None or freed.vetoed["worse"].keys() != veto["worse"].keys()
    assert json.loads(report.to_json())["vetoed"]["mean_quality"] == veto["mean_quality"]


def test_a_report_says_where_no_more_vertices_may_come() -> None:
    share, more = 0.02, {}
    for _ in range(2):
        _, report = odt_plugins.optimize_with_report(STORED, insert=share)
        lines = [line for line in str(report).splitlines() if line.startswith("size ")]
        more[share] = report.counts["vertices added"]
        if lines:
            assert more[share] == int(share * report.n_used)
            assert lines[0].endswith(f"as many as may by insert={share}; try insert={2 * share:g}")
        share *= 2
    assert more[0.04] > more[0.02] == int(0.02 * report.n_used)


def test_binding_by_a_boundary_triangle() -> None:
    """An apex at its best place over a flat boundary triangle: the triangle binds."""
    base = np.array([[0.0, 0, 0], [1, 0, 0], [0.3, 0.05, 0]])
    limit = best_quality_on(base)
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 41)] * 3), axis=-1).reshape(-1, 3)
    tets = np.column_stack([np.tile([0, 1, 2], (len(grid), 1)), np.arange(3, 3 + len(grid))])
    best = grid[np.abs(radius_ratio(np.vstack([base, grid]), tets)).argmax()]
    mesh = simplex_mesh(np.vstack([base, best]), [[0, 1, 2, 3]])[0]
    mask = np.array([False, False, False, True])
    cells = mesh.cells
    facets = [f for f in ([0, 1, 2],)]
    reason = binding._reason(mesh.points, cells[0], [np.array(f) for f in facets], mask,
                             cell_figures(mesh.points, cells), 0)
    assert reason.startswith("its boundary triangle (")
    assert f"allows no more than {limit:.3f}" in reason


def test_binding_by_a_sharp_corner_of_the_surface() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 1, 0.05], [0.5, 1, -0.05]])
    mesh = simplex_mesh(points, [[0, 1, 2, 3]])[0]
    only = bind(mesh, [])[0]
    assert only.reason.startswith("two triangles of it that stay fixed meet along its edge (")
    assert set(only.binds) == {"quality", "min_angle", "max_angle"}
    flat = simplex_mesh(np.array([[0.0, 0], [1, 0], [0.9, 0.1]]), [[0, 1, 2]])[0]
    assert "meet at its vertex (0) at" in bind(flat, [])[0].reason


def test_binding_names_the_worst_cells_of_each_figure() -> None:
    rng = np.random.default_rng(829)
    figures = CellFigures(*(rng.random(50) for _ in CellFigures._fields))
    points = rng.random((60, 3))
    cells = np.array([rng.choice(60, 4, replace=False) for _ in range(50)], dtype=np.int32)
    found = binding_cells(points, cells, np.zeros(50, np.int32), np.ones(60, bool), figures)
    worst = {"quality": figures.quality, "min_angle": figures.min_angle,
             "max_angle": -figures.max_angle}
    for name, value in worst.items():
        assert {b.cell for b in found if name in b.binds} == set(np.argsort(value)[:10])
    assert [b.quality for b in found] == sorted(b.quality for b in found)


@pytest.mark.parametrize("suffix", [".png", ".pdf", ".svg"])
def test_the_figure_is_written(report: Report, tmp_path: Path, suffix: str) -> None:
    pytest.importorskip("matplotlib")
    report.plot(tmp_path / f"figure{suffix}")
    assert (tmp_path / f"figure{suffix}").stat().st_size > 5000


def test_the_figure_draws_the_counts_and_the_energy(
    report: Report, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    figures = []
    monkeypatch.setattr(plotting, "_save", lambda figure, *_args, **_kw: figures.append(figure))
    report.plot(tmp_path / "figure.png")
    before, after, energy = figures[0].axes
    assert [bar.get_height() for bar in before.patches] == list(report.histogram_before)
    assert [bar.get_height() for bar in after.patches] == list(report.histogram_after)
    assert list(energy.lines[0].get_ydata()) == [2.0, 1.5]
    assert f"min {report.after.min_quality:.3f}" in after.texts[0].get_text()


def test_a_cut_open_mesh_is_painted_with_both_histograms(report: Report, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    mesh = fan()
    pair = (mesh.points, mesh.cells)
    plotting.plot_before_after(pair, pair, report, tmp_path / "cut.png", title="fan", up=1)
    assert (tmp_path / "cut.png").stat().st_size > 10000


def test_a_figure_that_cannot_be_written(report: Report, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    with pytest.raises(MeshFileError, match="cannot be written"):
        report.plot(tmp_path / "no" / "figure.png")
    with pytest.raises(MeshFileError, match="cannot be written"):
        report.plot(tmp_path / "figure.mp3")


def test_without_matplotlib_the_way_out_is_named(
    report: Report, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "matplotlib.figure", None)
    with pytest.raises(MissingDependencyError, match=r'pip install "odt-plugins\[plot\]"'):
        report.plot(tmp_path / "figure.png")
