"""Meshes made anew with edges of one length: figures, the table, and every tool once."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import replace
from importlib import import_module

import meshio
import numpy as np
import pytest
from surface_meshes import sphere

from odt_plugins.cli.main import main
from odt_plugins.compare import sized
from odt_plugins.compare.baselines.task import mean_edge
from odt_plugins.compare.contestants import OURS
from odt_plugins.compare.runner import Limits, Run, run_contestant
from odt_plugins.compare.sized import CONTESTANTS, FILE, run_sized, sized_figures
from odt_plugins.compare.start import ball, make_start, pebble, plate

START = {"tets": ball(150), "planar": plate(150), "surface": pebble(150)}
ONCE = Limits(60.0, 1, 1.0, 1)


def made(points, cells):
    return Run("ok", facts={"seconds": [1.0]}, meshes=[(points, cells, None)])


def test_figures_of_two_spheres():
    points, cells = sphere(3)
    start = make_start("ball", points, cells)
    size = mean_edge(start)
    found = sized_figures(start, made(1.1 * points, cells), 1.1 * size)
    away = 0.1 / 12**0.5
    assert found["there"] == pytest.approx(away, rel=0.02)
    assert found["back"] == pytest.approx(away, rel=0.1)
    assert found["in"] == 1.0
    assert sized_figures(start, made(points, cells), 2 * size)["in"] == 0.0
    assert found["small"] == 0
    flat = points * [1, 1, 1e-3]
    assert sized_figures(start, made(flat, cells), size)["small"] > 0


def test_the_rim_counts_in_the_plane():
    start = START["planar"]
    moved = start.points + np.array([0.01, 0])
    found = sized_figures(start, made(moved, start.cells), 1.0)
    extent = np.linalg.norm(np.ptp(start.points, axis=0))
    assert found["there"] == pytest.approx(0.01 / extent, rel=1e-6)
    assert found["back"] == pytest.approx(0.01 / extent, rel=1e-6)


def test_the_table_has_a_row_for_every_size_and_bound(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr(sized, "SAMPLES", 100)
    told = []

    def run(start, contestant, limits):
        told.append(contestant)
        if contestant.name == "PyACVD":
            return Run("missing", "no PyACVD")
        return made(start.points, start.cells)

    text = run_sized(tmp_path, [START["surface"]], [], ONCE, lambda line: None, run)
    ours = [c.settings for c in told if c.name == OURS]
    assert len(ours) == 6
    assert {s["envelope"] for s in ours} == {1e-2, 1e-3}
    assert len({s["size"] for s in ours}) == 3
    assert len([c for c in told if c.name == "Gmsh"]) == 3
    assert not any(c.program for c in told)
    values = json.loads((tmp_path / FILE).read_text())
    assert {row["who"] for row in values["rows"] if row["status"] == "missing"} == {"PyACVD"}
    assert text.count("odt-plugins") == 6


def test_the_command_runs_the_suite(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sized.run_sized, "__defaults__", (lambda *_: Run("failed", "not now"),))
    start, path = START["planar"], tmp_path / "plate.vtu"
    meshio.Mesh(start.points, [("triangle", start.cells)]).write(path)
    assert main(["compare", str(path), "--suite", "remesh", "--against", "mmg",
                 "--out", str(tmp_path)]) == 0
    assert "mmg2d" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["mmg3d", "mmg2d", "mmgs", "MeshLab isotropic remeshing",
                                  "CGAL isotropic remeshing", OURS])
def test_a_tool_makes_edges_about_as_long_as_asked_for(name):
    contestant = next(c for c in CONTESTANTS if c.name == name)
    for kind in contestant.kinds:
        start = START[kind]
        size = 0.7 * mean_edge(start)
        settings = contestant.settings | {"size": size, "threads": 1, "envelope": 0.02}
        task = import_module(
            f"odt_plugins.compare.baselines.{contestant.module}").prepare(start, settings)
        mesh = task.collect(task.call())
        found = sized_figures(start, made(*mesh[:2]), size)
        assert found["in"] > 0.5, kind
        assert max(found["there"], found["back"]) < 0.1, kind


def test_gmsh_in_a_process_of_its_own():
    contestant = next(c for c in CONTESTANTS if c.name == "Gmsh")
    size = mean_edge(START["planar"])
    run = run_contestant(
        START["planar"], replace(contestant, settings={"angle": 40.0, "size": size}), ONCE)
    assert run.status == "ok", run.message
    assert sized_figures(START["planar"], run, size)["in"] > 0.8


COPIES = {
    "tetgen": """flags, name = sys.argv[1:]
assert flags.startswith("-rqa0.")
for end in ("node", "ele"):
    shutil.copy(f"{name}.{end}", f"{name}.1.{end}")
""",
    "cgal_remeshing": """start, result, length, passes, _ = sys.argv[1:]
assert float(length) > 0 and passes == "10"
shutil.copy(start, result)
"""}


@pytest.mark.parametrize("program", COPIES)
def test_programs_are_rows_where_they_are_on_the_path(program, tmp_path, monkeypatch):
    file = tmp_path / program
    file.write_text(f"#!{sys.executable}\nimport shutil, sys\n{COPIES[program]}")
    file.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.chdir(tmp_path)
    contestant = next(c for c in CONTESTANTS if c.program == program)
    start = START["tets"]
    settings = contestant.settings | {"size": mean_edge(start)}
    task = import_module(
        f"odt_plugins.compare.baselines.{contestant.module}").prepare(start, settings)
    points, cells = task.collect(task.call())
    np.testing.assert_array_equal(points, start.points)
    np.testing.assert_array_equal(np.sort(cells, axis=1), np.sort(start.cells, axis=1))
