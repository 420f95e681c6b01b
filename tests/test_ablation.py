"""The ablation: what every phase of the schedule gains."""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner
from measure.ablation import HEADS, SMOOTHING, ablation
from measure.command import main

from odt_plugins.compare.start import ball, pebble, plate
from odt_plugins.engine.run.plan import run
from odt_plugins.engine.run.within import Within
from odt_plugins.engine.surface.driver import run_surface
from odt_plugins.mesh.simplex import simplex_mesh
from odt_plugins.mesh.surface import surface_mesh
from odt_plugins.options import Options

STARTS = [plate(150), pebble(200)]


@pytest.fixture(scope="module")
def table():
    told = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("measure.ablation.TURNS", 1)
        found = ablation(STARTS, Options(), told.append)
    assert told == [start.name for start in STARTS]
    return found


def test_the_ablation_has_a_row_for_every_phase_that_runs(table):
    assert table.heads == HEADS
    rows = {row[0]: row for row in table.rows}
    assert list(rows)[:4] == [SMOOTHING, "bulk", "tail 1", "tail 2"]
    assert {name: rows[name][1] for name in ("bulk", "tail 1", "tail 3")} == {
        "bulk": 2, "tail 1": 2, "tail 3": 1}
    assert "polish" not in rows


def test_a_gain_is_the_difference_to_the_run_without_the_phase(table):
    engine = {"planar": (simplex_mesh, lambda mesh, options, without: run(
        mesh, options, within=Within(without=without))), "surface": (surface_mesh, run_surface)}
    gain = 0.0
    for start in STARTS:
        make, optimise = engine[start.kind]
        mesh = make(start.points, start.cells)
        mesh = mesh[0] if isinstance(mesh, tuple) else mesh
        whole, without = (optimise(mesh, Options(), without=left_out)
                          for left_out in ((), ("tail 1",)))
        q = [quality(outcome) for outcome in (whole, without)]
        gain += q[0].mean() - q[1].mean()
    assert gain > 0.005
    row = next(row for row in table.rows if row[0] == "tail 1")
    assert float(row[2]) == pytest.approx(gain, abs=1e-4)


def quality(outcome):
    x = outcome.points[outcome.cells]
    a, b, c = (np.linalg.norm(x[:, i] - x[:, j], axis=1) for i, j in ((1, 2), (2, 0), (0, 1)))
    return (b + c - a) * (c + a - b) * (a + b - c) / (a * b * c)


def test_a_phase_that_is_left_out_is_not_run_and_other_names_change_nothing():
    start = ball(60)
    mesh = simplex_mesh(start.points, start.cells)[0]
    whole = run(mesh, Options())
    same = run(mesh, Options(), within=Within(without=("no such phase",)))
    assert whole.points.tobytes() == same.points.tobytes()
    names = ("bulk", "tail 1", "tail 2", "tail 3", "angles", "extremes", "regain", "polish",
             "after polish", "repair", "after repair", "cautious", "worst")
    nothing = run(mesh, Options(smoothing={"rounds": 0}), within=Within(without=names))
    assert nothing.counts.get("quality flips", 0) == 0
    assert whole.counts["quality flips"] > 0


def test_the_command_prints_the_table(tmp_path):
    import meshio

    start = plate(60)
    path = tmp_path / "plate.vtu"
    meshio.write_points_cells(path, np.pad(start.points, ((0, 0), (0, 1))),
                              {"triangle": start.cells})
    done = CliRunner().invoke(main, ["ablation", str(path)])
    assert done.exit_code == 0, done.output
    assert done.stderr.strip() == "plate"
    assert all(head in done.stdout for head in HEADS)
    assert "tail 1" in done.stdout


def test_what_is_no_measurement_is_refused():
    done = CliRunner().invoke(main, ["thread"])
    assert done.exit_code == 2
    assert "got 'thread'; expected some of stages" in done.stderr
