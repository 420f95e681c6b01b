"""The comparison: its measures, its processes, and what it writes."""

from __future__ import annotations

import csv
import hashlib
import html
import json
import math
import os
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest
from contestants import charts_unwritten, in_this_process
from scipy.sparse import diags

import odt_plugins
from odt_plugins.cli.main import main
from odt_plugins.compare import contestants as table
from odt_plugins.compare.baselines import netgen_optimize
from odt_plugins.compare.contestants import CONTESTANTS, KINDS, OURS, TOOLS, Contestant, choose
from odt_plugins.compare.hull import BoundaryChange, compare_boundaries, held_vertices, hull_facets
from odt_plugins.compare.manuscript import to_markdown
from odt_plugins.compare.output import FILES, to_csv, to_json
from odt_plugins.compare.poisson import conjugate_gradients, solve_poisson
from odt_plugins.compare.rows import Row, compare_on, mark, measure_mesh
from odt_plugins.compare.runner import Limits, run_contestant
from odt_plugins.compare.score import scores, verdict
from odt_plugins.compare.start import (
    STORED,
    ball,
    make_start,
    pebble,
    plate,
    read_start,
    refine,
    stored,
    suite,
)
from odt_plugins.errors import InvalidOptionError
from odt_plugins.figures import radius_ratio, volumes

QUICK = Limits(seconds=60.0, repeats=2, enough=0.0)
ONCE = Limits(seconds=60.0, repeats=1)
FACTS = {"processor": "one", "threads": 1, "seed": 2, "date": "today"}


@pytest.fixture
def no_processes():
    with in_this_process():
        yield


def contestant(name):
    return next(c for c in CONTESTANTS if c.name == name)


# ---- start meshes

@pytest.mark.parametrize("name", list(STORED))
def test_stored_meshes_are_modest_and_sound(name):
    start = stored(name)
    assert len(start.cells) < 50_000
    assert np.array_equal(np.unique(start.cells), np.arange(len(start.points)))
    if start.kind != "surface":
        assert (volumes(start.points, start.cells) > 0).all()


@pytest.mark.parametrize("make", [ball, plate])
def test_meshes_made_on_the_fly_repeat_themselves_and_fill_their_domain(make):
    a, b = make(300), make(300)
    assert a.points.tobytes() == b.points.tobytes()
    assert a.cells.tobytes() == b.cells.tobytes()
    assert make(300, 5).points.tobytes() != a.points.tobytes()
    exact = 4 / 3 * math.pi if make is ball else 4 - 0.09 * math.pi
    volume = volumes(a.points, a.cells)
    assert (volume > 0).all()
    assert volume.sum() == pytest.approx(exact, rel=0.06)


@pytest.mark.parametrize(("make", "pieces"), [(ball, 8), (plate, 4)])
def test_refinement_keeps_volume_boundary_and_conformity(make, pieces):
    start = make(60)
    fine = make_start("fine", *refine(start.points, start.cells))
    assert len(fine.cells) == pieces * len(start.cells)
    volume = volumes(fine.points, fine.cells)
    assert (volume > 0).all()
    assert volume.sum() == pytest.approx(volumes(start.points, start.cells).sum(), rel=1e-12)
    assert len(hull_facets(fine)) == 2 ** (start.points.shape[1] - 1) * len(hull_facets(start))
    assert compare_boundaries(start, fine).verdict == "same place"


def test_a_start_is_turned_and_loses_unused_vertices():
    points = np.array([[0.0, 0, 0], [9, 9, 9], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    start = make_start("one", points, np.array([[0, 3, 2, 4]], dtype=np.int32))
    assert len(start.points) == 4
    assert volumes(start.points, start.cells) == pytest.approx([1 / 6])
    with pytest.raises(InvalidOptionError, match="huge"):
        suite("huge")


# ---- measures

def test_boundary_is_compared_whatever_the_numbering(d):
    start = ball(60) if d == 3 else plate(60)
    order = np.random.default_rng(7).permutation(len(start.points))
    rank = np.argsort(order).astype(np.int32)
    same = replace(start, points=start.points[order], cells=rank[start.cells])
    assert compare_boundaries(start, same).verdict == "identical"
    nudged = replace(start, points=start.points * (1 + 1e-15))
    assert compare_boundaries(start, nudged).verdict == "same place"


def test_boundary_distance_is_a_fraction_of_the_diagonal_both_ways(d):
    grown = 1.01
    start = ball(60) if d == 3 else plate(60)
    change = compare_boundaries(start, replace(start, points=start.points * grown))
    reach = 1.0 if d == 3 else math.sqrt(2.0)
    diagonal = np.linalg.norm(np.ptp(start.points, axis=0))
    assert change.verdict == "moved"
    assert change.outward == pytest.approx(0.01 * reach / diagonal, rel=0.05)
    assert change.inward == pytest.approx(0.01 * reach / diagonal, rel=0.5)


def test_a_missing_corner_shows_in_one_direction_only():
    """A square whose corner is cut off lies within the old boundary: only one way is far."""
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    whole = make_start("square", square, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32))
    half = make_start("half", square, np.array([[0, 1, 2]], dtype=np.int32))
    change = compare_boundaries(whole, half)
    assert change.inward == pytest.approx(math.sqrt(0.5) / math.sqrt(2))
    assert change.outward == pytest.approx(0.5 / math.sqrt(2))


def test_inverted_cells_are_counted_on_the_orientation_of_the_contestant():
    start = ball(60)
    turned = start.cells[:, [1, 0, 2, 3]]
    assert measure_mesh(start, start.points, turned, poisson=False).summary.inverted == 0
    mixed = start.cells.copy()
    mixed[:5] = turned[:5]
    assert measure_mesh(start, start.points, mixed, poisson=False).summary.inverted == 5


def test_conjugate_gradients_give_solution_steps_and_condition():
    n = 60
    matrix = diags([-np.ones(n - 1), 2 * np.ones(n), -np.ones(n - 1)], [-1, 0, 1]).tocsr()
    right = np.random.default_rng(3).normal(size=n)
    x, steps, condition = conjugate_gradients(matrix, right)
    assert matrix @ x == pytest.approx(right, abs=1e-7 * np.linalg.norm(right))
    exact = np.linalg.cond(matrix.toarray())
    assert condition == pytest.approx(exact, rel=1e-6)
    assert steps <= n + 5
    assert conjugate_gradients(matrix, right, lambda r: r / 2.0)[1] == steps


@pytest.mark.parametrize("make", [ball, plate])
def test_poisson_errors_fall_at_the_rates_of_linear_elements(make):
    coarse = make(200)
    fine = make_start("fine", *refine(coarse.points, coarse.cells))
    a, b = solve_poisson(coarse, coarse), solve_poisson(fine, coarse)
    assert a.l2_error / b.l2_error == pytest.approx(4.0, rel=0.35)
    assert a.h1_error / b.h1_error == pytest.approx(2.0, rel=0.25)
    assert b.amg_steps < b.cg_steps
    assert b.condition > a.condition


def test_a_better_mesh_has_a_better_condition():
    start = ball(200)
    points, cells = odt_plugins.optimize((start.points, start.cells))
    better = replace(start, points=points, cells=cells)
    assert solve_poisson(better, start).condition < solve_poisson(start, start).condition


# ---- processes

FAULTS = {
    "raises": "raise ValueError('no luck')",
    "aborts": "import os; os.abort()",
    "leaves": "import sys; sys.exit(3)",
    "hangs": "import time; time.sleep(1000)",
    "empty": "return start.points, start.cells[:0]",
    "beyond": "return start.points, start.cells + 10000",
    "nan": "return start.points * float('nan'), start.cells",
    "second": "import time\n        calls.append(1)\n        time.sleep(60 * (len(calls) > 1))\n"
              "        return start.points, start.cells",
    "litter": "open('rubbish.stl', 'w').write('x')\n        return start.points, start.cells",
    "slow": "return start.points, start.cells",
}
WARM_UPS = {"slow": "import time; time.sleep(2)"}


@pytest.fixture
def faulty(tmp_path, monkeypatch):
    """A contestant with a fault of its own, in a module of its own."""
    def make(name):
        folder = tmp_path / "faulty"
        folder.mkdir()
        (folder / f"{name}.py").write_text(
            "from odt_plugins.compare.baselines.task import Task\n"
            "calls = []\n"
            "def prepare(start, settings):\n"
            f"    def call():\n        {FAULTS[name]}\n"
            "    return Task(call, lambda result: result)\n"
            f"def warm_up(start, settings):\n    {WARM_UPS.get(name, 'pass')}\n")
        monkeypatch.setenv("PYTHONPATH", str(tmp_path))
        return Contestant(name, "faulty", ("tets",), f"faulty.{name}")
    return make


@pytest.mark.parametrize(("name", "status", "message"), [
    ("raises", "failed", "ValueError: no luck"),
    ("aborts", "crashed", "SIGABRT"),
    ("leaves", "crashed", "exit code 3"),
    ("empty", "nothing", "no cells"),
    ("beyond", "nothing", "do not exist"),
    ("nan", "nothing", "not finite"),
])
def test_whatever_a_contestant_does_is_a_row(faulty, name, status, message):
    run = run_contestant(ball(60), faulty(name), ONCE)
    assert (run.status, message in run.message) == (status, True), run.message


def test_a_hanging_contestant_is_ended_in_time(faulty):
    assert run_contestant(ball(60), faulty("hangs"), Limits(seconds=1.0)).status == "timeout"


def test_compiling_does_not_count(faulty):
    assert run_contestant(ball(60), faulty("slow"), Limits(seconds=1.5)).status == "ok"


def test_repeats_that_were_complete_survive_the_time_limit(faulty):
    run = run_contestant(ball(60), faulty("second"), Limits(seconds=3.0))
    assert run.status == "ok"
    assert len(run.meshes) == 1
    assert "after 1 complete run" in run.message


def test_files_of_a_tool_stay_out_of_the_working_directory(faulty, tmp_path, monkeypatch):
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    assert run_contestant(ball(60), faulty("litter"), ONCE).status == "ok"
    assert os.listdir(here) == []


def test_memory_is_that_of_the_contestant_and_not_of_this_process():
    ballast = np.ones(40_000_000)
    run = run_contestant(ball(60), contestant("Laplacian"), ONCE)
    assert run.facts["peak"] < ballast.nbytes


def test_a_package_that_is_not_installed_is_a_row_that_names_the_extra(monkeypatch):
    absent = replace(contestant("Gmsh default"), package="no-such-package")
    row = compare_on(ball(60), [absent], ONCE, poisson=False).rows[0]
    assert row.status == "missing"
    assert 'pip install "odt-plugins[compare]"' in row.message


# ---- contestants


def test_every_contestant_names_an_extra_of_the_package():
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    for one in CONTESTANTS:
        assert one.extra in project["optional-dependencies"], one.name


SMALL = {"tets": ball(200), "planar": plate(200)}
GOOD = ["Gmsh default", "Gmsh Netgen", "Gmsh combination", "Gmsh Relocate2D", "Netgen sm",
        "mmg3d no insertion", "smart Laplacian", "CGAL exude", "MeshLab flips and Laplacian", OURS]


@pytest.mark.usefixtures("no_processes")
@pytest.mark.parametrize("name", GOOD)
def test_baselines_are_called_so_that_they_improve_the_mesh(name):
    """A rival that is called wrongly would be beaten without merit."""
    one = contestant(name)
    start = SMALL[one.kinds[0]]
    row = compare_on(start, [one], ONCE, poisson=False).rows[0]
    assert row.status == "ok", row.message
    after = row.measured.summary
    assert after.inverted == 0
    assert after.mean_quality > radius_ratio(start.points, start.cells).mean()
    assert row.measured.boundary.verdict in ("identical", "same place")
    assert abs(row.measured.volume_change) < 1e-12
    assert row.timing.peak > 1e7


@pytest.mark.usefixtures("no_processes")
@pytest.mark.parametrize("name", ["CGAL odt", "CGAL lloyd"])
def test_cgal_moves_the_surface_and_that_is_measured(name):
    row = compare_on(SMALL["tets"], [contestant(name)], ONCE, poisson=False).rows[0]
    assert row.status == "ok", row.message
    assert row.measured.boundary.verdict == "moved"
    assert 1e-5 < row.measured.boundary.outward < 0.05
    assert row.measured.summary.mean_quality > 0.75


@pytest.mark.usefixtures("no_processes")
def test_cgal_refuses_a_start_that_is_not_delaunay():
    start = ball(60)
    moved = start.points.copy()
    inner = np.setdiff1d(np.arange(len(moved)), hull_facets(start))
    moved[inner] *= 0.97
    run = run_contestant(replace(start, points=moved), contestant("CGAL odt"), ONCE)
    assert run.status == "unsupported"
    assert "not Delaunay" in run.message


@pytest.mark.usefixtures("no_processes")
def test_ours_on_a_curved_surface_is_a_row(tmp_path):
    surface = stored("bone-surface")
    ours, peer = compare_on(surface, choose(["open3d taubin"]), ONCE).rows[:2]
    assert ours.contestant == OURS
    assert ours.status == "ok"
    assert ours.measured.boundary.verdict == "moved"
    assert 0 < max(ours.measured.boundary[1:]) <= 1e-3
    assert ours.measured.summary.mean_quality > 0.98
    assert peer.measured.boundary.verdict == "moved"
    assert 0 < peer.measured.boundary.outward < 0.05


@pytest.mark.parametrize("threads", [1, 2])
def test_netgen_gets_as_many_threads_as_the_others(
    monkeypatch: pytest.MonkeyPatch, threads: int,
) -> None:
    meshing = MagicMock()
    monkeypatch.setitem(sys.modules, "netgen", MagicMock())
    monkeypatch.setitem(sys.modules, "netgen.meshing", meshing)
    netgen_optimize.prepare(ball(60), {"optimize3d": "stm", "steps": 10, "threads": threads})
    given = meshing.MeshingParameters.call_args.kwargs
    assert (given["nthreads"], given["parallel_meshing"]) == (threads, threads > 1)


def test_choice_by_family_and_by_name():
    assert [c.name for c in choose(["mmg3d no insertion"])] == [OURS, "mmg3d no insertion"]
    families = {c.family for c in choose(["gmsh", "netgen"])}
    assert families == {"odt-plugins", "gmsh", "netgen"}
    assert len([c for c in choose(["gmsh"]) if c.family == OURS]) == 1
    assert len([c for c in choose([OURS])]) > 5
    assert [c for c in choose([]) if not c.program] == [
        c for c in table.CONTESTANTS if not c.program]
    with pytest.raises(InvalidOptionError, match="expected one of cgal"):
        choose(["gmesh"])


@pytest.mark.usefixtures("no_processes")
def test_a_tool_that_cannot_take_a_mesh_has_its_row():
    start = SMALL["planar"]
    chosen = choose(["netgen", "Gmsh default", "open3d", "cgal"])
    rows = compare_on(start, chosen, ONCE, poisson=False).rows
    told = {row.contestant: row.message for row in rows if row.status == "unsupported"}
    assert list(told) == ["Gmsh default", "Netgen", "CGAL", "Open3D"]
    assert told["Gmsh default"] == "does not take triangles in the plane"
    assert "geometry" in told["Netgen"]
    assert len(rows) == 5
    families = {c.family for c in CONTESTANTS}
    assert set(TOOLS) == families
    for kind in KINDS:
        taken = {c.family for c in CONTESTANTS if kind in c.kinds}
        assert {name for name in TOOLS if kind in TOOLS[name].refuses} == families - taken


# ---- rows and files

@pytest.fixture(scope="module")
def result():
    return compare_on(ball(60), choose(["Laplacian", "netgen", "CGAL odt"]), QUICK)


def test_rows_tell_figures_time_memory_and_repeats(result):
    ours = result.rows[0]
    assert ours.status == "ok"
    assert ours.repeats_itself in (True, None)
    assert ours.timing.least <= ours.timing.median <= ours.timing.most
    assert ours.timing.compile is not None
    assert 0 < ours.timing.cpu < 10
    assert ours.measured.summary.min_quality > result.measured.summary.min_quality
    assert sum(ours.measured.histogram) == ours.measured.summary.n_cells
    assert ours.measured.poisson.cg_steps <= result.measured.poisson.cg_steps


def made_up(name, family, **figures):
    start = ball(60)
    measured = measure_mesh(start, start.points, start.cells, poisson=False)
    measured = replace(measured, summary=replace(measured.summary, **figures))
    return Row("ball", "tets", name, family, "", {}, None, 1, 0, "ok", "", measured)


def test_rows_that_beat_ours_are_marked_and_stay():
    ours = made_up(OURS, OURS, min_quality=0.5, mean_quality=0.8, max_angle=150.0)
    better = made_up("rival", "rival", min_quality=0.6, mean_quality=0.8, max_angle=140.0)
    invalid = made_up("broken", "rival", min_quality=0.9, inverted=1)
    rows = mark([better, ours, invalid])
    assert rows[0].better_than_ours == ("min_quality", "max_angle")
    assert rows[1].better_than_ours == rows[2].better_than_ours == ()
    assert [r.contestant for r in rows] == ["rival", OURS, "broken"]
    failed = replace(ours, status="failed", measured=None)
    assert "mean_quality" in mark([better, failed])[0].better_than_ours


def test_verdict_names_who_is_better_in_what(result):
    rows = mark([made_up(OURS, OURS, min_quality=0.5),
                 made_up("rival", "rival", min_quality=0.6)])
    assert verdict(replace(result, rows=rows)) == f"Better than {OURS} in least q: rival."


def test_there_is_no_verdict_without_an_opponent(result):
    ours = made_up(OURS, OURS, min_quality=0.5)
    beside = made_up(f"{OURS}: insertion", OURS, min_quality=0.4)
    gone = replace(made_up("gone", "rival"), measured=None, status="missing")
    for rows in ([ours], [ours, beside], [ours, beside, gone]):
        alone = replace(result, rows=mark(rows))
        assert verdict(alone) == "No other tool has a result here to compare with."
        assert scores([alone]) == []


def moved(row, outward, inward=0.0):
    boundary = BoundaryChange("moved", outward, inward)
    return replace(row, measured=replace(row.measured, boundary=boundary))


def test_what_moved_the_surface_further_is_no_plain_win(result):
    ours = moved(made_up(OURS, OURS, min_quality=0.5), 1e-3, 2e-4)
    level = moved(made_up("level", "rival", min_quality=0.6), 1e-4, 1e-3)
    further = moved(made_up("further", "rival", min_quality=0.7), 1e-4, 1.1e-3)
    rows = mark([ours, level, further])
    assert [row.freer for row in rows] == ["", "", "surface moved further than ours"]
    assert rows[1].better_than_ours == rows[2].better_than_ours == ("min_quality",)
    both = replace(result, rows=rows)
    assert verdict(both) == (
        f"Better than {OURS} in least q: level. "
        "Better, but no plain win (surface moved further than ours), in least q: further.")
    only = replace(result, rows=[rows[0], rows[2]])
    assert verdict(only).startswith(f"No other tool is plainly better than {OURS}")
    timed = [replace(row, timing=result.rows[0].timing) for row in rows]
    text = to_markdown([replace(result, rows=timed)], FACTS, "the command")
    assert "| level | ▲0.600 /" in text
    assert "| further | △0.700 /" in text


def test_figures_are_counted_per_opponent_and_in_all(result):
    ours = made_up(OURS, OURS, min_quality=0.5, mean_quality=0.8, max_angle=150.0)
    better = made_up("better", "rival", min_quality=0.6, mean_quality=0.8, max_angle=140.0)
    freer = moved(made_up("freer", "rival", min_quality=0.6), 1e-3)
    gone = replace(better, contestant="gone", measured=None, status="crashed")
    timed = [replace(row, timing=result.rows[0].timing) for row in (ours, better)]
    one = replace(result, rows=mark([*timed, freer, gone]))
    two = replace(result, rows=mark([ours, replace(freer, contestant="better")]))
    found = {score.opponent: score for score in scores([one, two])}
    lost = len(mark([ours, freer])[1].better_than_ours)
    assert lost > 0
    assert found["better"][1:] == (2, 12, 10 - lost, 2, lost, 1)
    assert found["freer"][1:] == (1, 6, 6 - lost, 0, lost, 0)
    assert found["all"][1:] == (3, 18, 16 - 2 * lost, 2, 2 * lost, 1)
    assert list(found) == ["better", "freer", "all"]
    text = to_markdown([one, two], FACTS, "the command")
    assert f"**{OURS} is ahead or level in {16 - 2 * lost} of 18 figures**" in text


def test_csv_and_json_hold_every_row(result):
    missing = replace(result.rows[0], contestant="gone", status="missing", measured=None,
                      timing=None)
    result = replace(result, rows=[*result.rows, missing])
    lines = list(csv.DictReader(to_csv([result]).splitlines()))
    assert [line["contestant"] for line in lines[1:]] == [r.contestant for r in result.rows]
    assert float(lines[1]["mean_quality"]) == result.rows[0].measured.summary.mean_quality
    assert lines[-1]["status"] == "missing"
    whole = json.loads(to_json([result], {"cores": 2}, "command"))
    assert len(whole["meshes"][0]["rows"]) == len(result.rows)
    assert whole["meshes"][0]["rows"][0]["timing"]["runs"] >= 1


def test_markdown_marks_what_beats_ours_and_tells_what_failed(result):
    rows = mark([made_up(OURS, OURS, min_quality=0.5),
                 made_up("rival", "rival", min_quality=0.6, n_points=1000),
                 replace(made_up("gone", "rival"), measured=None, status="crashed")])
    timing = result.rows[0].timing
    rows = [replace(row, timing=timing) for row in rows]
    text = to_markdown([replace(result, rows=rows)], FACTS, "the command")
    table = text.partition("ahead or level")[0]
    lines = {line.split(" | ")[0].strip("| *"): line for line in table.splitlines()}
    assert "the command" in lines
    assert "▲0.600 /" in lines["rival"]
    assert "+884 vertices" in lines["rival"]
    assert "▲" not in lines[OURS]
    assert lines["gone"] == "| gone | crashed |"


def test_command_writes_into_out_alone(tmp_path, monkeypatch, capsys):
    import meshio

    monkeypatch.chdir(tmp_path)
    start = plate(60)
    meshio.write(tmp_path / "small.vtu", meshio.Mesh(
        np.column_stack([start.points, np.zeros(len(start.points))]),
        [("triangle", start.cells)]))
    with charts_unwritten(), in_this_process():
        assert main(["compare", "small.vtu", "--against", "laplacian", "--out", "table",
                     "--repeats", "1"]) == 0
    said = capsys.readouterr().out
    assert "smart Laplacian" in said
    assert "small: small.vtu, 74 vertices, 116 cells" in said
    assert sorted(os.listdir(tmp_path)) == ["small.vtu", "table"]
    assert sorted(os.listdir("table")) == sorted(FILES)
    facts = json.loads((tmp_path / "table" / FILES[1]).read_text())
    assert facts["command"] == (
        "odt-plugins compare small.vtu --against laplacian --out table --repeats 1 "
        "--time-limit 60.0 --threads 1")
    digest = hashlib.sha256((tmp_path / "small.vtu").read_bytes()).hexdigest()
    for name in FILES[:-1]:
        text = (tmp_path / "table" / name).read_text(encoding="utf-8")
        assert digest[:16] in text, name
        assert "--repeats 1 --time-limit 60.0" in html.unescape(text) or name == FILES[0]
    assert facts["machine"]["numpy"] == np.__version__


def test_command_says_what_is_wrong(tmp_path, capsys):
    assert main(["compare"]) == 2
    assert "give a mesh file" in capsys.readouterr().err
    assert main(["compare", "--suite", "standard", "--against", "gmesh"]) == 2
    assert "gmesh" in capsys.readouterr().err
    assert main(["compare", str(tmp_path / "none.vtu")]) == 1
    assert "missing" in capsys.readouterr().err


def test_worker_is_a_process_that_leaves_its_own_result(tmp_path):
    start = ball(60)
    job = {"mesh": "ball", "kind": "tets", "module": "averaging", "imports": [], "threads": 1,
           "settings": {"iterations": 1, "smart": False}, "repeats": 1, "enough": 1.0, "seed": 1}
    (tmp_path / "job.json").write_text(json.dumps(job))
    np.savez(tmp_path / "start.npz", points=start.points, cells=start.cells)
    subprocess.run([sys.executable, "-m", "odt_plugins.compare.worker", str(tmp_path)], check=True)
    facts = json.loads((tmp_path / "result.json").read_text())
    assert facts["status"] == "ok"
    assert facts["peak"] >= facts["peak_before"] > 0


# ---- regions

def with_regions(start):
    """The same mesh in three regions: halves, one of them cut once more."""
    centre = start.points[start.cells].mean(axis=1)
    halves = (centre[:, 0] > 0).astype(np.int32)
    return replace(start, regions=halves + halves * (centre[:, 1] > 0))


REGIONS = ["Laplacian", "smart Laplacian", "Gmsh default", "Gmsh Netgen", "Gmsh combination",
           "Gmsh Relocate2D", "Netgen stm", "mmg3d with insertion, 3 times", "MeshLab Laplacian",
           OURS]


@pytest.mark.usefixtures("no_processes")
@pytest.mark.parametrize(("name", "kind"), [
    (name, kind) for name in REGIONS for kind in ("tets", "planar")
    if any(c.name == name and kind in c.kinds for c in CONTESTANTS)])
def test_who_can_respects_the_regions_of_a_mesh(name, kind):
    one = next(c for c in CONTESTANTS if c.name == name and kind in c.kinds)
    row = compare_on(with_regions(SMALL[kind]), [one], ONCE, poisson=False).rows[0]
    assert row.status == "ok", row.message
    assert not row.measured.regions_ignored
    assert row.measured.boundary.verdict in ("identical", "same place")
    assert abs(row.measured.volume_change) < 1e-12


@pytest.mark.usefixtures("no_processes")
def test_meshlabs_laplacian_holds_the_regions_of_a_surface():
    start = with_regions(pebble(200))
    held = held_vertices(start)
    corners = np.repeat(np.arange(len(start.cells)), 3)
    for vertex in range(len(start.points)):
        around = start.regions[corners[start.cells.ravel() == vertex]]
        assert held[vertex] == (len(set(around.tolist())) > 1)
    run = run_contestant(start, contestant("MeshLab Laplacian"), ONCE)
    points, cells, regions = run.meshes[0]
    assert np.array_equal(points[held], start.points[held])
    assert (points[~held] != start.points[~held]).any(axis=1).all()
    assert np.array_equal(cells, start.cells)
    assert np.array_equal(regions, start.regions)
    assert not held_vertices(pebble(200)).any()


@pytest.mark.usefixtures("no_processes")
def test_who_cannot_respect_regions_says_so():
    start = with_regions(SMALL["tets"])
    assert run_contestant(start, contestant("CGAL exude"), ONCE).status == "unsupported"
    rows = compare_on(with_regions(SMALL["planar"]), choose(["MeshLab flips"]), ONCE,
                      poisson=False).rows
    assert [row.measured.regions_ignored for row in rows] == [False, True]
    assert rows[1].freer == "regions ignored"


def test_an_interface_that_moves_or_is_lost_is_measured():
    start = with_regions(SMALL["planar"])
    swapped = measure_mesh(start, start.points, start.cells, (start.regions + 1) % 3,
                           poisson=False)
    assert swapped.boundary.verdict == "identical"
    assert abs(swapped.volume_change) > 0.4
    one = measure_mesh(start, start.points, start.cells, np.zeros_like(start.regions),
                       poisson=False)
    assert one.boundary.verdict == "moved"
    assert one.boundary.inward > 0.1
    assert measure_mesh(start, start.points, start.cells, poisson=False).regions_ignored


def test_regions_of_a_file_are_those_of_the_start(tmp_path):
    import meshio

    start = with_regions(SMALL["tets"])
    meshio.write(tmp_path / "two.vtu", meshio.Mesh(
        start.points, [("tetra", start.cells)], cell_data={"medit:ref": [7 * start.regions]}))
    assert np.array_equal(read_start(tmp_path / "two.vtu").regions, start.regions)


# ---- programs and remeshers of surfaces

STAND_IN = f"""#!{sys.executable}
import pathlib
import sys

import numpy as np

flag, config, prefix = sys.argv[1:]
points, cells = (np.loadtxt(f"{{prefix}}.{{end}}", skiprows=1) for end in ("node", "ele"))
corners = points[cells[:, 1:].astype(int) - 1, 1:]
negative = (np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0).all()
fixed = "usequadrics 0" in pathlib.Path(config).read_text()
if flag != "-s" or "." in prefix or not negative or not fixed:
    sys.exit("this is not what Stellar takes")
for end in ("node", "ele"):
    pathlib.Path(f"{{prefix}}.1.{{end}}").write_text(pathlib.Path(f"{{prefix}}.{{end}}").read_text())
"""


@pytest.fixture
def on_path(tmp_path, monkeypatch):
    def put(script):
        file = tmp_path / "Stellar"
        file.write_text(script)
        file.chmod(0o755)
        monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)

    return put


def test_stellar_is_a_row_where_the_program_is_on_the_path(on_path, monkeypatch):
    monkeypatch.setenv("PATH", "")
    assert "Stellar" not in {c.name for c in choose([])}
    assert [c.name for c in choose(["stellar"])] == [OURS, "Stellar"]
    run = run_contestant(ball(60), contestant("Stellar"), ONCE)
    assert (run.status, run.message) == ("missing", "no program Stellar is on the PATH")
    on_path(STAND_IN)
    assert "Stellar" in {c.name for c in choose([])}
    start = ball(60)
    run = run_contestant(start, contestant("Stellar"), ONCE)
    assert run.status == "ok", run.message
    points, cells, _ = run.meshes[0]
    np.testing.assert_array_equal(points, start.points)
    assert (volumes(points, cells) > 0).all()
    np.testing.assert_array_equal(np.sort(cells, axis=1), np.sort(start.cells, axis=1))
    assert run.facts["cpu"][0] > 0.01


def test_a_stellar_that_fails_is_a_row_that_says_so(on_path):
    on_path(f"#!{sys.executable}\nimport sys\nsys.exit('no room')\n")
    run = run_contestant(ball(60), contestant("Stellar"), ONCE)
    assert run.status == "failed"
    assert "Stellar ended with 1 and wrote no mesh: no room" in run.message


@pytest.mark.usefixtures("no_processes")
@pytest.mark.parametrize("name", ["mmgs hausd 2e-3", "CGAL isotropic remeshing"])
def test_remeshers_of_surfaces_give_a_better_surface_close_to_the_start(name):
    start = pebble(400)
    run = run_contestant(start, contestant(name), ONCE)
    assert run.status == "ok", run.message
    points, cells, regions = run.meshes[0]
    measured = measure_mesh(start, points, cells, regions=regions, poisson=False)
    assert measured.summary.mean_quality > 0.9
    assert measured.summary.n_points > 0.8 * len(start.points)
    assert max(measured.boundary.outward, measured.boundary.inward) < 0.03
    assert "plane" in TOOLS[contestant(name).family].refuses["planar"]
