"""Tangled meshes: what is done to valid ones, and the table of what every tool leaves."""

import json
from dataclasses import replace

import numpy as np
import pytest

from odt_plugins.cli.main import main
from odt_plugins.compare import tangled
from odt_plugins.compare.baselines import mfem_tmop
from odt_plugins.compare.contestants import OURS
from odt_plugins.compare.hull import held_vertices
from odt_plugins.compare.runner import Limits, Run, run_contestant
from odt_plugins.compare.start import ball, plate
from odt_plugins.compare.tangled import FILE, run_tangled, tangles
from odt_plugins.engine.untangle.places import bad_cells


@pytest.mark.parametrize("make", [plate, ball])
def test_tangles_move_what_they_say_and_turn_cells_over(make):
    start = make(300)
    held = held_vertices(start)
    found = {how: points for how, points, _ in tangles(start)}
    assert len(found) == (6 if make is plate else 7)
    for how, points in found.items():
        assert bad_cells(points, start.cells).any(), how
        stays = (points == start.points).all(axis=1)
        moves_boundary = how in ("bent", "twisted")
        assert stays[~held if moves_boundary else held].all(), how
    steps = [np.abs(found[f"random, {n} h"] - start.points).max() for n in (1, 3, 10)]
    assert steps[0] < steps[1] < steps[2]
    for how, points, places in tangles(start):
        assert np.array_equal(found[how], points)
        assert np.array_equal(places[held], points[held]), how
        assert not bad_cells(places, start.cells).all()


def test_the_table_tells_what_every_tool_leaves(tmp_path):
    start = plate(60)
    inner = ~held_vertices(start)

    def run(knot, contestant, _limits):
        if contestant.name == "Gmsh":
            return Run("crashed", "ended by SIGSEGV")
        points = knot.points.copy()
        whole = not bad_cells(points, knot.cells).any()
        if contestant.name == OURS:
            points[inner] = start.points[inner]
        return Run("ok", "", {"seconds": [1.0 if whole else 2.0]},
                   [(points, knot.cells, None)])

    said = []
    text = run_tangled(tmp_path, [start], (), Limits(), said.append, run)
    rows = json.loads((tmp_path / FILE).read_text())["rows"]
    assert len(rows) == len(said) == 6
    for row in rows[:5]:
        assert row["left"][OURS]["inverted"] == 0 < row["inverted"]
        assert row["left"]["Laplacian"]["inverted"] == row["inverted"]
        assert row["left"][OURS]["figures"] == row["as_it_was"]["figures"]
    assert "odt-plugins mended" in text
    line = next(line for line in text.splitlines() if "one point" in line)
    assert "crashed" in line
    assert line.split()[-1] == "2"
    some = run_tangled(tmp_path, [start], ("laplacian",), Limits(), said.append, run)
    assert "crashed" not in some


def test_a_boundary_that_moved_is_told():
    start = plate(60)
    moved = Run("ok", "", {"seconds": [1.0]}, [(start.points + 1.0, start.cells, None)])
    assert tangled._told(start, moved)["status"] == "moved the boundary"
    more = Run("ok", "", {"seconds": [1.0]}, [
        (np.vstack([start.points, start.points[:1]]), start.cells, None)])
    assert tangled._told(start, more)["status"] == "moved the boundary"


def test_the_command_runs_the_suite_on_files(tmp_path, monkeypatch, capsys):
    asked = []
    monkeypatch.setattr(tangled, "run_tangled",
                        lambda out, starts, against, limits, say: asked.append(
                            ([s.name for s in starts], against, limits.threads)) or "a table")
    assert main(["compare", "--suite", "tangled", "--out", str(tmp_path), "--against", "gmsh"]) == 0
    assert asked == [(["bunny", "bone"], ("gmsh",), 1)]
    assert "a table" in capsys.readouterr().out


@pytest.mark.parametrize("make", [plate, ball])
def test_tmop_mends_reflected_vertices_and_leaves_the_boundary(make):
    """Where MFEM is installed; elsewhere its row says what to install."""
    start = make(60)
    tmop = next(c for c in tangled.CONTESTANTS if c.family == "mfem")
    points = next(points for how, points, _ in tangles(start) if how == "reflected")
    knot = replace(start, points=points)
    run = run_contestant(knot, tmop, Limits(repeats=1))
    if tmop.installed() is None:
        said = 'mfem is not installed; try pip install "odt-plugins[mfem]"'
        assert (run.status, run.message) == ("missing", said)
        return
    assert run.status == "ok", run.message
    told = tangled._told(knot, run)
    assert (told["status"], told["inverted"]) == ("ok", 0)


def test_the_barrier_of_tmop_begins_below_the_least_determinant():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, np.sqrt(0.75)], [0.5, -2.0 * np.sqrt(0.75)]])
    cells = np.array([[0, 1, 2], [0, 1, 3]])
    assert mfem_tmop._barrier(points, cells) == pytest.approx(-2.0 - mfem_tmop.BELOW)
