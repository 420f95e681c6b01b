"""Contestants of the caller's own, mesh files as results, kept meshes, further measures."""

from __future__ import annotations

import json

import meshio
import numpy as np
import pytest
from click.testing import CliRunner
from contestants import charts_unwritten, in_this_process

from odt_plugins.adapters.files import read_file, write_arrays
from odt_plugins.cli.main import cli
from odt_plugins.compare.contestants import CONTESTANTS, OURS, OWN, choose
from odt_plugins.compare.measures import further, mean_ratio, scaled_jacobian
from odt_plugins.compare.output import write_all
from odt_plugins.compare.rows import compare_on
from odt_plugins.compare.runner import Limits
from odt_plugins.compare.start import ball, make_start, plate
from odt_plugins.errors import InvalidOptionError
from odt_plugins.generate.clouds import plate as plate_arrays
from odt_plugins.objectives import AIMS
from odt_plugins.report.machine import describe

ONCE = Limits(repeats=1)


@pytest.fixture
def here():
    """No contestant has a process of its own."""
    with in_this_process():
        yield


@pytest.fixture
def undrawn():
    """No chart of a page is drawn."""
    with charts_unwritten():
        yield


CONTESTANT = '''
def still(points, cells, labels):
    assert labels is None or len(labels) == len(cells)
    return points, cells

def raises(points, cells, labels):
    raise RuntimeError("out of luck")

def nothing(points, cells, labels):
    pass

def alone(points, cells, labels):
    return points

def four(points, cells, labels):
    return [points, cells, labels, 4]
'''


@pytest.mark.parametrize("k", [3, 4])
def test_measures_are_1_of_regular_cells_0_of_flat_ones_and_follow_closed_forms(k):
    regular = np.array([[0.0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]])[:k]
    rows = np.arange(k)[None].astype(np.int32)
    if k == 4 and np.linalg.det(regular[1:] - regular[0]) < 0:
        rows = rows[:, [1, 0, 2, 3]]
    points = regular if k == 4 else np.array([[0.0, 0], [1, 0], [0.5, 0.75**0.5]])
    corner = np.vstack([np.zeros(k - 1), np.eye(k - 1)])
    flat = np.vstack([corner[:-1], [corner[1:-1].mean(axis=0)]])
    for measure in (scaled_jacobian, mean_ratio):
        assert measure(7.0 * points, rows) == pytest.approx(1.0, abs=1e-14)
        assert measure(points, rows[:, [1, 0, *range(2, k)]])[0] == pytest.approx(-1.0)
        assert measure(flat, np.arange(k)[None].astype(np.int32)) == pytest.approx(0.0, abs=1e-9)
        assert measure(np.zeros((k, k - 1)), rows)[0] == 0.0
    right = np.arange(k)[None].astype(np.int32)
    if k == 3:  # area 1/2, edges 1, 1, sqrt 2
        assert scaled_jacobian(corner, right)[0] == pytest.approx(2 / 3**0.5 * 1 / 2**0.5)
        assert mean_ratio(corner, right)[0] == pytest.approx(4 * 3**0.5 * 0.5 / 4)
    else:  # volume 1/6, three edges 1, three sqrt 2; products 1 and 2
        assert scaled_jacobian(corner, right)[0] == pytest.approx(2**0.5 * 1 / 2)
        assert mean_ratio(corner, right)[0] == pytest.approx(12 * 0.5 ** (2 / 3) / 9)
    both = further(np.vstack([corner, 5.0 + corner]), np.vstack([right, right + k]))
    assert both["min_mean_ratio"] == both["mean_mean_ratio"] == mean_ratio(corner, right)[0]


def test_functions_of_the_caller_take_part(tmp_path, monkeypatch):
    (tmp_path / "mine_to_compare.py").write_text(CONTESTANT)
    monkeypatch.chdir(tmp_path)
    names = ["mine_to_compare:still", "mine_to_compare:raises", "mine_to_compare:none",
             "no_such_module:f"]
    chosen = choose(names)
    assert [c.name for c in chosen] == [OURS, *names]
    start = ball(60)
    result = compare_on(start, chosen[1:], ONCE, poisson=False)
    still, raises, none, missing = result.rows
    assert (still.status, still.family) == ("ok", OWN)
    assert still.measured.boundary.verdict == "identical"
    assert still.measured.further == result.measured.further
    assert still.timing.median >= 0.0
    assert (raises.status, raises.message) == ("failed", "RuntimeError: out of luck")
    assert none.status == "failed"
    assert "'none'" in none.message
    assert missing.status == "missing"
    assert "no_such_module" in missing.message
    with pytest.raises(InvalidOptionError, match="or module:name of a function of yours"):
        choose(["no tool:at all"])
    for name, said in (("nothing", "NoneType"), ("alone", "ndarray"), ("four", "list of 4")):
        mine = choose([f"mine_to_compare:{name}"])[1:]
        row = compare_on(start, mine, ONCE, poisson=False).rows[0]
        assert f"the function returned a {said}; expected (points, cells), or" in row.message


def test_regions_reach_functions_of_the_caller(tmp_path, monkeypatch):
    (tmp_path / "mine_with_labels.py").write_text(
        "def same(points, cells, labels):\n    return points, cells, labels\n")
    monkeypatch.chdir(tmp_path)
    start = ball(60)
    halves = start.points[start.cells].mean(axis=1)[:, 0] > 0.0
    start = make_start("halves", start.points, start.cells, regions=halves.astype(int))
    row = compare_on(start, choose(["mine_with_labels:same"])[1:], ONCE, poisson=False).rows[0]
    assert row.status == "ok"
    assert not row.measured.regions_ignored


ODD = """
import numpy as np
def flat(points, cells, labels):
    return points[:, :2], cells
def faces(points, cells, labels):
    return points, cells[:, :3]
def few(points, cells, labels):
    return points, cells, [7, 8]
def shut(points, cells, labels):
    return points, np.zeros_like(cells)
def huge(points, cells, labels):
    return 1e300 * points, cells
"""


@pytest.mark.filterwarnings("ignore:overflow:RuntimeWarning")
@pytest.mark.parametrize(("name", "status", "said"), [
    ("flat", "nothing", r"points of shape (116, 2), expected (n, 3)"),
    ("faces", "nothing", r"expected (n, 4)"),
    ("few", "nothing", "labels of shape (2,)"),
    ("shut", "ok", ""),
    ("huge", "failed", "its mesh cannot be measured: ValueError"),
])
def test_whatever_a_function_returns_is_a_row(tmp_path, monkeypatch, name, status, said):
    (tmp_path / f"odd_{name}.py").write_text(ODD)
    monkeypatch.chdir(tmp_path)
    contestant = choose([f"odd_{name}:{name}"])[1:]
    result = compare_on(ball(60), contestant, ONCE, keep=tmp_path / "kept")
    (row,) = result.rows
    assert (row.status, said in row.message) == (status, True), row.message
    kept = {path.name for path in (tmp_path / "kept").iterdir()}
    assert len(kept) == 1 + (status == "ok")


@pytest.mark.usefixtures("here")
def test_files_are_measured_and_results_are_kept(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    start = ball(60)
    write_arrays("start.vtu", start.points, start.cells)
    inner = np.abs(start.points).sum(axis=1) < 0.5
    moved = start.points + 1e-3 * inner[:, None]
    write_arrays("elsewhere.vtu", moved, start.cells)
    write_arrays("flat.vtu", *plate_arrays(60))
    done = CliRunner().invoke(cli, [
        "compare", "start.vtu", "--against", "Laplacian", "--result", "elsewhere.vtu", "--result",
        "flat.vtu", "--keep", "kept", "--repeats", "1", "--no-poisson"])
    assert done.exit_code == 0, done.output
    assert "elsewhere.vtu" in done.output
    assert "unsupported, flat.vtu holds triangles in the plane" in done.output
    whole = json.loads((tmp_path / "comparison" / "comparison.json").read_text())
    rows = {row["contestant"]: row for row in whole["meshes"][0]["rows"]}
    assert rows["elsewhere.vtu"]["timing"] is None
    assert rows["elsewhere.vtu"]["measured"]["further"]["mean_mean_ratio"] > 0.0
    page = (tmp_path / "comparison" / "comparison.html").read_text()
    assert "Further measures" in page
    assert "what made it" in page
    assert "elsewhere.vtu~" not in (tmp_path / "comparison" / "comparison.tex").read_text()
    kept = sorted(path.name for path in (tmp_path / "kept").iterdir())
    assert kept == ["start-Laplacian.vtu", "start-elsewhere.vtu.vtu", "start-odt-plugins.vtu",
                    "start-start.vtu"]
    back = read_file(tmp_path / "kept" / "start-elsewhere.vtu.vtu")
    assert back.points.tobytes() == moved.tobytes()


@pytest.mark.usefixtures("here", "undrawn")
def test_meshes_and_results_with_the_same_name_are_kept_apart(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for folder, count in (("a", 60), ("b", 80)):
        (tmp_path / folder).mkdir()
        start = ball(count)
        write_arrays(f"{folder}/part.vtu", start.points, start.cells)
    words = ["--repeats", "1", "--no-poisson", "--against", "Laplacian", "--keep", "kept"]
    done = CliRunner().invoke(cli, ["compare", "a/part.vtu", "b/part.vtu", *words])
    assert done.exit_code == 0, done.output
    whole = json.loads((tmp_path / "comparison" / "comparison.json").read_text())
    assert [mesh["name"] for mesh in whole["meshes"]] == ["part", "part-2"]
    for name, folder in (("part", "a"), ("part-2", "b")):
        there = read_file(tmp_path / folder / "part.vtu")
        kept = read_file(tmp_path / "kept" / f"{name}-start.vtu")
        assert np.array_equal(kept.points, there.points)
    done = CliRunner().invoke(cli, ["compare", "a/part.vtu", *words, "--result", "a/part.vtu",
                                    "--result", "b/part.vtu"])
    assert done.exit_code == 0, done.output
    assert len(read_file(tmp_path / "kept" / "part-a-part.vtu.vtu").points) != len(
        read_file(tmp_path / "kept" / "part-b-part.vtu.vtu").points)


@pytest.mark.usefixtures("here", "undrawn")
def test_meshes_whose_files_would_have_one_name_are_kept_apart(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, count in (("my part", 60), ("my-part", 80)):
        start = ball(count)
        write_arrays(f"{name}.vtu", start.points, start.cells)
    words = ["--repeats", "1", "--no-poisson", "--against", "Laplacian", "--keep", "kept"]
    done = CliRunner().invoke(cli, ["compare", "my part.vtu", "my-part.vtu", *words])
    assert done.exit_code == 0, done.output
    for kept, name in (("my-part", "my part"), ("my-part-2", "my-part")):
        there, back = read_file(f"{name}.vtu"), read_file(f"kept/{kept}-start.vtu")
        assert np.array_equal(back.points, there.points)
    done = CliRunner().invoke(cli, ["compare", "my part.vtu", *words, "--result", "my part.vtu",
                                    "--result", "my-part.vtu"])
    assert done.exit_code == 0, done.output
    for kept, name in (("my-part.vtu", "my part"), ("my-part.vtu-2", "my-part")):
        there, back = read_file(f"{name}.vtu"), read_file(f"kept/my-part-{kept}.vtu")
        assert len(back.points) == len(there.points)


def test_a_result_in_an_oblique_plane_is_seen_in_the_plane_of_its_start(tmp_path):
    flat = plate(60)
    turn = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
    space = np.pad(flat.points, [(0, 0), (0, 1)]) @ turn.T + [1.0, 2.0, 3.0]
    start = make_start("oblique", space, flat.cells)
    path = tmp_path / "same.vtu"
    write_arrays(path, space, flat.cells)
    result = compare_on(start, [], ONCE, poisson=False, results=[path], keep=tmp_path / "kept")
    assert result.rows[0].status == "ok"
    assert result.rows[0].measured.boundary.verdict in ("identical", "same place")
    back = meshio.read(tmp_path / "kept" / "oblique-start.vtu")
    assert back.points == pytest.approx(space, abs=1e-12)
    write_all(tmp_path / "out", [result], describe(1, 0), "odt-plugins compare <test>")


@pytest.mark.parametrize(("words", "said"), [
    (["--suite", "standard", "--result", "a.vtu"], "expected one MESH"),
    (["a.vtu", "b.vtu", "--result", "c.vtu"], "expected one MESH"),
    (["--suite", "remesh", "--keep", "d"], "keeps no meshes"),
])
def test_flags_that_fit_nothing_are_refused(words, said):
    done = CliRunner().invoke(cli, ["compare", *words])
    assert done.exit_code == 2
    assert said in done.output


def test_every_other_objective_has_a_row():
    names = {c.name for c in CONTESTANTS}
    assert {f"{OURS}: {name}" for name, aim in AIMS.items() if not aim.by_ratios} <= names
