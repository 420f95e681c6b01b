"""The promise on many kinds of meshes: clustered, stretched, thin, needle-like, sliver-ridden."""

from __future__ import annotations

import json
from pathlib import Path

import meshio
import numpy as np
import pytest
import tet_meshes as tm
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from measure import command, robustness
from measure.hard import CLOUDS, delaunay, hard_meshes
from promises import assert_promise, measure, mesh_of, volumes
from strategies import SEEDS

from odt_plugins.compare.start import ball
from odt_plugins.engine.run.plan import run
from odt_plugins.errors import MeshFileError
from odt_plugins.mesh.simplex import simplex_mesh
from odt_plugins.options import Options

DATA = Path(__file__).parents[2] / "data"

HARD = {mesh.name: mesh for mesh in hard_meshes(200)}


@pytest.mark.parametrize("name", HARD)
def test_hard_meshes(name):
    hard = HARD[name]
    mesh = mesh_of(hard.points, hard.cells, hard.regions)
    outcome = run(mesh, Options())
    assert_promise(mesh, outcome)
    before, after = measure(mesh.points, mesh.cells), measure(outcome.points, outcome.cells)
    assert after[2] > before[2]


def tetwild(name):
    stored = meshio.read(DATA / f"{name}.vtu")
    cells = stored.cells_dict["tetra"]
    return simplex_mesh(np.array(stored.points, dtype=float), cells)[0]


TETWILD = ["bone05", "tetwild_bunny", "tetwild_csg", "tetwild_cube", "tetwild_airplane"]


@pytest.mark.parametrize("name", TETWILD)
def test_meshes_of_tetwild(name):
    mesh = tetwild(name)
    outcome = run(mesh, Options())
    assert_promise(mesh, outcome)
    before, after = measure(mesh.points, mesh.cells), measure(outcome.points, outcome.cells)
    assert after[2] > before[2] + 0.02


def test_a_very_thin_plate_gains_where_its_quantile_may_fall():
    plate = HARD["very thin plate, space"]
    mesh = mesh_of(plate.points, plate.cells)
    kept, free = (run(mesh, Options(keep=keep)) for keep in
                  (Options().keep, ("min_quality", "mean_quality", "min_angle", "max_angle")))
    before, still, after = (measure(m.points, m.cells) for m in (mesh, kept, free))
    assert set(map(frozenset, kept.cells.tolist())) == set(map(frozenset, mesh.cells.tolist()))
    assert "p1_quality" in kept.fallback
    assert_promise(mesh, free, keep=False)
    assert after[2] > 1.5 * before[2]
    assert after[2] > still[2] > before[2]
    assert after[0] >= before[0] - 2e-15


def pressed(points, cells, rng, angle):
    """Press interior vertices towards an opposite facet until cells are as flat as the angle."""
    interior = np.ones(len(points), dtype=bool)
    for facet, owners in tm.facets_of(cells).items():
        if len(owners) == 1:
            interior[list(facet)] = False
    points = points.copy()
    for c in rng.permutation(len(cells))[:40]:
        v = cells[c][interior[cells[c]]]
        if not v.size:
            continue
        base = points[cells[c][cells[c] != v[0]]].mean(axis=0)
        old = points[v[0]].copy()
        points[v[0]] = base + angle * (old - base)
        if (tm.signed_volumes(points, cells) <= 0).any():
            points[v[0]] = old
    return points


@pytest.mark.parametrize("angle", [1e-2, 2e-4])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_slivers_of_a_hundredth_of_a_degree(angle, seed):
    points, cells = tm.ball(300, seed)
    points = pressed(points, cells, np.random.default_rng(seed), angle)
    assert tm.dihedral_angles(points, cells).min() < 60 * angle + 0.5
    mesh = mesh_of(points, cells)
    outcome = run(mesh, Options())
    assert_promise(mesh, outcome)
    assert measure(outcome.points, outcome.cells)[2] > measure(points, cells)[2] + 0.05


@pytest.mark.parametrize("hole", [True, False])
@pytest.mark.parametrize("labels", [1, 2, 5])
def test_holes_and_regions(hole, labels):
    points, cells = tm.grid(5, 4, hole=hole)
    center = points[cells].mean(axis=1)
    regions = (np.floor(center[:, 0]) + np.floor(center[:, 1])).astype(np.int32) % labels
    mesh = mesh_of(points, cells, regions)
    assert_promise(mesh, run(mesh, Options()))


def test_random_labels_everywhere(d):
    rng = np.random.default_rng(5)
    points, cells = delaunay(rng.random((200, d)))
    mesh = mesh_of(points, cells, rng.integers(0, 3, len(cells)).astype(np.int32))
    assert_promise(mesh, run(mesh, Options()))


def test_two_parts_that_touch_in_a_vertex_or_an_edge():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0],
                       [0.05, 0.1, 0.3], [0, -0.2, -1]], dtype=float)
    cells = tm.oriented(points, [[0, 1, 2, 6], [0, 1, 3, 6], [0, 2, 3, 6], [1, 2, 3, 6],
                                 [0, 4, 5, 7]])
    mesh = mesh_of(points, cells)
    outcome = run(mesh, Options())
    assert_promise(mesh, outcome)
    assert measure(outcome.points, outcome.cells)[2] > measure(points, cells)[2]


@given(st.sampled_from(sorted(CLOUDS)), st.sampled_from([2, 3]), SEEDS,
       st.sampled_from([1e-9, 1.0, 1e9]), st.sampled_from([0.0, 1e3]),
       st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3))
def test_the_promise_holds_for_any_cloud(name, d, seed, scale, shift, stretch):
    rng = np.random.default_rng(seed)
    cloud = CLOUDS[name](rng, d, 60) * 10.0 ** np.array(stretch[:d])
    points, cells = delaunay((cloud + shift) * scale)
    mesh = mesh_of(points, cells, rng.integers(0, 2, len(cells)).astype(np.int32)
                   if seed % 4 == 0 else None)
    assert_promise(mesh, run(mesh, Options()))


@pytest.mark.parametrize("name", ["bone05", "tetwild_csg", "tetwild_airplane"])
def test_result_does_not_depend_on_unit_and_place(name):
    mesh = tetwild(name)
    points = (mesh.points - mesh.points.min(axis=0) + 1e6) - 1e6
    here = run(mesh_of(points, mesh.cells), Options())
    span = np.ptp(points)
    for scale, shift in ((1e-9, 0.0), (1e9, 0.0), (1.0, 1e6)):
        there = run(mesh_of(points * scale + shift, mesh.cells), Options())
        assert_promise(mesh_of(points * scale + shift, mesh.cells), there)
        assert there.cells.tobytes() == here.cells.tobytes(), (scale, shift)
        error = np.abs((there.points - shift) / scale - here.points).max() / span
        assert error < (1e-9 if shift else 1e-12), (scale, shift)


@pytest.mark.parametrize("scale", [1e-9, 1e9])
@pytest.mark.parametrize("shift", [0.0, 1e6])
def test_stage_one_does_not_depend_on_unit_and_place(d, scale, shift):
    points, cells = delaunay(np.random.default_rng(3).random((200, d)))
    points = points.astype(np.float32).astype(float)
    here = run(mesh_of(points, cells), Options(smoothing={"rounds": 3}, finish=False))
    placed = points + shift
    if shift:
        points = placed - shift
        here = run(mesh_of(points, cells), Options(smoothing={"rounds": 3}, finish=False))
    there = run(mesh_of(placed * scale, cells), Options(smoothing={"rounds": 3}, finish=False))
    assert (volumes(there.points, there.cells) > 0).all()
    assert there.cells.tobytes() == here.cells.tobytes()
    assert there.points / scale - shift == pytest.approx(here.points, abs=1e-6 if shift else 1e-9)


def test_the_command_tells_of_every_mesh_whether_the_promise_holds(tmp_path, monkeypatch):
    """Those of real geometry are stood in for by balls."""
    optimize = robustness.optimize_with_report
    stored = {name: ball(n) for name, n in (("bunny", 300), ("bone", 250), ("cgal-bunny", 200))}
    monkeypatch.setattr(robustness, "stored", stored.__getitem__)

    def careless(mesh, **options):
        (points, cells, regions), report = optimize(mesh, **options)
        if len(points) == len(stored["bunny"].points):
            points[cells[0, 0]] += 1.0
        return (points, cells, regions), report

    monkeypatch.setattr(robustness, "optimize_with_report", careless)
    said = []
    table = robustness.run_hard(tmp_path, 1, said.append, size=25).splitlines()
    rows = json.loads((tmp_path / robustness.FILE).read_text())["meshes"]
    assert [row["name"] for row in rows] == said
    assert len(rows) == len(HARD) + 3
    assert [row["name"] for row in rows if row["broken"]] == ["bunny"]
    lines = {row["name"]: next(line for line in table if line.startswith(row["name"]))
             for row in rows}
    assert "moved" in lines["bunny"]
    assert all("kept" in line for name, line in lines.items() if name != "bunny")
    assert f"promise kept on {len(rows) - 1} of {len(rows)}" in table[-1]
    for row in rows[:3]:
        assert row["after"]["mean_quality"] > row["before"]["mean_quality"]
        assert not row["unchanged"]


def test_the_command_runs_on_meshes_of_its_own(monkeypatch, tmp_path):
    asked = []
    monkeypatch.setattr(command, "run_hard",
                        lambda out, threads, say: asked.append((out, threads)) or "table")
    done = CliRunner().invoke(command.main, ["hard", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert "table" in done.output
    assert asked == [(tmp_path, 1)]


def test_the_command_says_where_it_cannot_write(tmp_path, monkeypatch):
    monkeypatch.setattr(robustness, "_meshes", lambda size: iter(()))
    (tmp_path / "file").write_text("")
    with pytest.raises(MeshFileError, match="cannot write into"):
        robustness.run_hard(tmp_path / "file", 1, print)
