"""What a solver gains: condition, steps of CG and stable steps against closed forms and numpy."""

from __future__ import annotations

import json
import warnings
from concurrent.futures import ThreadPoolExecutor

import meshio
import numpy as np
import planar_meshes as pm
import pytest
import surface_meshes
import tet_meshes as tm

import odt_plugins
from odt_plugins.cli import main as cli
from odt_plugins.errors import MissingDependencyError, UnsupportedMeshError
from odt_plugins.report.worth import solved

pytest.importorskip("skfem")


def square(n):
    """The unit square cut into 2 n^2 right triangles."""
    points = np.stack(np.meshgrid(*2 * [np.arange(n + 1) / n], indexing="ij"), -1).reshape(-1, 2)
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    return points, np.concatenate([np.stack([i, i + n + 1, i + n + 2], 1),
                                   np.stack([i, i + n + 2, i + 1], 1)])


def eigenvalues(points, cells):
    """Those of K u = lambda M u with lumped masses, by dense matrices."""
    n, d = len(points), cells.shape[1] - 1
    stiffness, masses = np.zeros((n, n)), np.zeros(n)
    for cell in cells:
        corner = np.column_stack([np.ones(d + 1), points[cell]])
        size = abs(np.linalg.det(corner)) / (2 if d == 2 else 6)
        slopes = np.linalg.inv(corner)[1:].T
        stiffness[np.ix_(cell, cell)] += size * slopes @ slopes.T
        masses[cell] += size / (d + 1)
    return np.linalg.eigvalsh(stiffness / np.sqrt(np.outer(masses, masses)))


def test_the_five_point_star():
    n = 8
    found = solved(*square(n))
    # eigenvalues 4 - 2 cos(i pi / n) - 2 cos(j pi / n); the load sees the extreme ones, n even
    assert found.unknowns == (n - 1) ** 2
    assert found.condition == pytest.approx(1 / np.tan(np.pi / (2 * n)) ** 2, rel=1e-6)
    assert 5 < found.cg_steps < 15
    assert found.time_step == pytest.approx(np.sqrt(0.5) / n, rel=1e-12)
    assert found.critical_step == pytest.approx(
        2 / np.sqrt(eigenvalues(*square(n)).max()), rel=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_a_step_below_the_softened_altitude_is_stable(seed):
    """The bound of the objective time_step, and what the critical step is."""
    for points, cells in (tm.ball(40, seed),
                          pm.jittered_grid(5, 5, np.random.default_rng(seed))[:2]):
        flat = cells.shape[1] == 3
        cells = (pm if flat else tm).oriented(points, cells)
        found = solved(points, cells)
        altitudes = (pm if flat else tm).altitudes(points, cells)
        softened = ((altitudes**-2.0).sum(axis=1) ** -0.5).min()
        critical = 2 / np.sqrt(eigenvalues(points, cells).max())
        assert found.critical_step == pytest.approx(critical, rel=1e-4)
        assert softened <= critical
        assert found.time_step == pytest.approx(altitudes.min(), rel=1e-9)
        assert softened <= found.time_step <= np.sqrt(cells.shape[1]) * softened


def test_one_cell_has_no_unknowns():
    found = solved(np.vstack([np.zeros(3), np.eye(3)]), np.array([[0, 1, 2, 3]]))
    assert (found.unknowns, found.condition, found.cg_steps) == (0, 1.0, 0)
    assert found.time_step == pytest.approx(3**-0.5)


def test_a_report_tells_both_and_the_command_prints_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    points, cells = tm.ball(200, 1)
    cells = tm.oriented(points, cells)
    (after, parts), report = odt_plugins.optimize_with_report(
        (points, cells), objective="time_step", smoothing={"rounds": 5})
    worth = report.worth()
    assert worth.before == solved(points, cells)
    assert worth.after == solved(after, parts)
    assert worth.faster == pytest.approx(report.after.min_altitude / report.before.min_altitude)
    assert worth.faster > 2.0
    assert worth.after.condition < worth.before.condition
    assert worth.to_dict()["after"]["cg_steps"] == worth.after.cg_steps
    assert "meshes" not in report.to_dict()
    json.loads(report.to_json())
    meshio.Mesh(points, [("tetra", cells)]).write("in.vtu")
    assert cli.main(["optimize", "in.vtu", "out.vtu", "--objective", "time_step", "--smoothing",
                     "rounds=5",
                     "--worth"]) == 0
    assert str(worth) in capsys.readouterr().out
    assert cli.main(["optimize", "in", "out.pvtu", "--worth"]) == 2
    assert "--worth are for one file each" in capsys.readouterr().err


@pytest.mark.parametrize("x", [0.0, -0.5])
def test_inverted_and_flat_cells_have_no_worth(x):
    points, cells = square(2)
    points[4, 0] = x
    worth = odt_plugins.optimize_with_report((points, cells))[1].worth()
    assert worth.before.unknowns == worth.after.unknowns == 1
    assert np.isnan([worth.before.condition, worth.before.cg_steps, worth.before.time_step,
                     worth.before.critical_step, worth.faster]).all()
    assert worth.after == solved(*square(2))
    told = json.loads(json.dumps(worth.to_dict(), allow_nan=False))
    assert told["before"] == dict.fromkeys(told["before"]) | {"unknowns": 1}
    assert str(worth).count("nan") == 4


def test_threads_leave_the_filters_of_warnings():
    before = list(warnings.filters)
    with ThreadPoolExecutor(8) as pool:
        for _ in range(10):
            list(pool.map(lambda _: solved(*square(4)), range(16)))
            assert list(warnings.filters) == before


def test_surfaces_and_missing_packages_are_told(monkeypatch):
    with pytest.raises(UnsupportedMeshError, match="triangles of a curved surface"):
        solved(*surface_meshes.sphere(1))
    monkeypatch.setattr("odt_plugins.errors.find_spec", lambda name: None)
    with pytest.raises(MissingDependencyError, match=r"needs skfem, .* \"odt-plugins\[compare\]\""):
        solved(*square(2))
