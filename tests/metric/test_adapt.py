"""Meshes that are adapted to a field, from Python and from the command line."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
from measure import aniso, matched
from strategies import jittered

import odt_plugins
from odt_plugins import remeshing
from odt_plugins.cli import main as cli
from odt_plugins.generate import clouds
from odt_plugins.report.interpolation import interpolation_errors


def front(x):
    return np.tanh(20.0 * (x[:, 0] - 0.5 + 0.1 * np.sin(6.0 * x[:, 1])))


def stored(place):
    points, cells = jittered(2, 16, 0)
    data = {"temperature": front(points), "flat": points[:, 0]}
    mesh = meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), [("triangle", cells)], data)
    mesh.write(place / "in.vtu")
    return mesh


def test_the_command_adapts_to_an_array(tmp_path):
    mesh = stored(tmp_path)
    files = [str(tmp_path / name) for name in ("in.vtu", "out.vtu")]
    words = ["remesh", *files, "--adapt", "temperature", "--cells", "1500", "--quiet"]
    assert cli.main(words) == 0
    out = meshio.read(files[1])
    rows = out.cells_dict["triangle"]
    assert 1200 < len(rows) < 1800
    uniform = odt_plugins.remesh(mesh, cells=1500)
    errors = [interpolation_errors(m.points[:, :2], m.cells_dict["triangle"], front).l2
              for m in (out, uniform)]
    assert errors[0] < 0.4 * errors[1]


def test_cells_are_stretched_as_far_as_the_boundary_allows():
    points, cells = clouds.ball(60)
    field = points[:, 0] ** 2 / np.abs(points).max() ** 2
    mesh = meshio.Mesh(points, [("tetra", cells)], {"u": field})
    out, report = odt_plugins.remesh_with_report(mesh, adapt="u", cells=2 * len(cells))
    assert abs(len(out.cells_dict["tetra"]) / (2 * len(cells)) - 1.0) < 0.1
    assert any("cells are to be stretched" in note for note in report.notes)
    assert report.fallback is None
    assert report.after.mean_quality > report.before.mean_quality + 0.3


def test_cells_stay_stretched_where_less_makes_no_fewer(monkeypatch):
    points, cells = clouds.ball(60)
    mesh = meshio.Mesh(points, [("tetra", cells)], {"u": points[:, 0] ** 2})
    seen = []

    def once(mesh, wish, options, notes=()):
        seen.append((options.metric, notes))
        if wish.crowded is not None:
            wish.crowded(5.0)
        return mesh, None, None, {}

    monkeypatch.setattr(remeshing, "_run_once", once)
    odt_plugins.remesh(mesh, adapt="u", cells=100_000)
    (first, _), (second, _), (last, notes) = seen
    assert not np.allclose(second, first)
    assert np.array_equal(last, first)
    assert notes == ()


def test_a_batch_is_adapted(tmp_path):
    stored(tmp_path)
    words = ["batch", str(tmp_path / "in.vtu"), "--out", str(tmp_path / "out"), "--quiet"]
    assert cli.main([*words, "--adapt", "temperature", "--cells", "400"]) == 0
    rows = meshio.read(tmp_path / "out" / "in.vtu").cells_dict["triangle"]
    assert 300 < len(rows) < 500


@pytest.mark.parametrize(("flags", "message"), [
    (["--adapt", "temperature", "--cells", "100", "--metric", "input"], "got --adapt and --metric"),
    (["--adapt", "temperature"], "got --adapt without a number of cells; expected --cells or"),
    (["--adapt", "temperature", "--size", "0.1", "--cells", "100"],
     "got --adapt with --size and --cells; expected --cells or --vertices alone beside it"),
    (["--adapt", "temperature", "--scale", "2", "--vertices", "100"],
     "got --adapt with --scale and --vertices; expected --cells or --vertices alone beside it"),
    (["--adapt", "heat", "--cells", "100"], "got --adapt heat; expected the name of a point array"),
    (["--adapt", "", "--cells", "100"], "got --adapt '';"),
])
def test_what_cannot_be_adapted_to_is_refused(flags, message, tmp_path, capsys):
    stored(tmp_path)
    assert cli.main(["remesh", *(str(tmp_path / name) for name in ("in.vtu", "out.vtu")), *flags])
    assert message in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out.vtu").exists()


def test_second_derivatives_and_errors_of_the_benchmark(monkeypatch):
    x = np.random.default_rng(0).random((50, 2))
    monkeypatch.setitem(aniso.TESTS, "sphere", lambda x: x[..., 0] ** 3 + x[..., 0] * x[..., 1])
    exact = np.zeros((50, 2, 2))
    exact[:, 0, 0], exact[:, 0, 1], exact[:, 1, 0] = 6.0 * x[:, 0], 1.0, 1.0
    assert np.allclose(aniso.hessians(aniso.TESTS["sphere"], x), exact, atol=1e-6)
    found = [aniso.Adapted((np.zeros((n, 2)), np.arange(n)[:, None]),
                           aniso.Errors(0.0, 5.0 / n, 0.0), 0.0) for n in (100, 200, 400)]
    assert aniso.order(2, found) == pytest.approx(2.0)


def test_the_benchmark_has_a_row_for_each(monkeypatch):
    monkeypatch.setattr(aniso, "LARGEST", {2: 300})
    monkeypatch.setattr(aniso, "HALVINGS", 0)
    monkeypatch.setattr(aniso, "ROUNDS", 2)
    monkeypatch.setattr(aniso, "TESTS", {"sphere": aniso.sphere})
    table = aniso.aniso_tables(lambda _: None, (2,))[0]
    assert table.heads == aniso.HEADS
    assert {row[1] for row in table.rows} <= {
        "odt-plugins", "odt-plugins, norm=1.5", "odt-plugins, norm=1.5, as many", "mmg"}
    assert float(table.rows[0][8]) < 3.0


def test_metrics_of_the_working_group_have_their_lengths_across_and_along_the_cylinder(monkeypatch):
    monkeypatch.setattr(matched, "ROUNDS", 0)
    monkeypatch.setattr(matched, "FINEST", 0.05)
    angle = np.array([0.1, 0.8, 1.5])
    out, along = (np.stack([*pair, 0.0 * angle], axis=1) for pair in (
        (np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))))
    for radius, across, arc in ((0.5, 0.05, 0.025), (0.55, 0.055, 0.0625), (0.75, 0.075, 0.1)):
        for fine in (False, True):
            metric = matched.polar(radius * out, fine=fine)
            for way, h in ((out, across), (along, arc if fine else 0.1)):
                assert np.einsum("ni,nij,nj->n", way, metric, way) == pytest.approx(h**-2)
    table = matched.matched(lambda _: None)
    assert [row[0] for row in table.rows] == list(matched.CASES)
    points, cells = matched.cut_cube()
    assert abs(odt_plugins.quality((points, cells)).volume - 1.0 + np.pi / 16.0) < 5e-4
