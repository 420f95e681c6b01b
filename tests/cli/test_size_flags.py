"""Sizes on the command line: remesh, batch, and after TetWild."""

from __future__ import annotations

import json

import meshio
import numpy as np
import pytest
from surface_meshes import sphere

import odt_plugins
from odt_plugins import tetwild
from odt_plugins.cli import main as cli
from odt_plugins.errors import InvalidOptionError


@pytest.fixture
def ball(tmp_path):
    points, cells = sphere(2, 0.1)
    path = tmp_path / "ball.vtu"
    meshio.Mesh(points, [("triangle", cells)], {"h": np.full(len(points), 0.5)}).write(path)
    return path, len(cells)


@pytest.mark.parametrize("size", ["0.5", "h", "curvature"])
def test_a_length_a_name_and_the_curvature(ball, tmp_path, size):
    out = tmp_path / "out.vtu"
    words = ["remesh", str(ball[0]), str(out), "--size", size, "--envelope", "0.02", "--quiet"]
    assert cli.main(words) == 0
    assert 0 < len(meshio.read(out).cells[0].data) < ball[1]


def test_a_wrong_name_is_refused_with_those_there_are(ball, tmp_path, capsys):
    assert cli.main(["remesh", str(ball[0]), str(tmp_path / "out.vtu"), "--size", "g"]) == 2
    assert "it has h (point)" in capsys.readouterr().err


def test_a_batch_remeshes_small_files_in_one_process(ball, tmp_path):
    other = tmp_path / "other.vtu"
    other.write_bytes(ball[0].read_bytes())
    out = tmp_path / "out"
    assert cli.main(["batch", str(ball[0]), str(other), "--out", str(out), "--scale", "1.5",
                     "--envelope", "0.02", "--quiet"]) == 0
    for name in ("ball.vtu", "other.vtu"):
        assert len(meshio.read(out / name).cells[0].data) < ball[1]
        told = json.loads((out / f"{name}.json").read_text())
        assert told["options"]["boundary"] == "slide"
    assert cli.main(["batch", str(other), "--out", str(out), "--scale", "-1"]) == 2


@pytest.mark.parametrize(("words", "said"), [
    ("remesh --size sol", "got --size sol; "), ("optimize --density sol", "got 'sol'; expected "),
    ("remesh --fixed sol --scale 2", "got 'sol'; expected "),
    ("optimize --boundary slide --envelope 2", "got --envelope 2"),
    ("untangle --selection sol", "got 'sol'; expected ")])
def test_a_command_that_fails_tells_its_warnings_once(words, said, tmp_path, capsys):
    points = np.array([[0.0, 0], [1, 0], [0, 1]])
    meshio.write(tmp_path / "in.mesh", meshio.Mesh(points, [("triangle", [[0, 1, 2]])]))
    (tmp_path / "in.sol").write_text(
        "MeshVersionFormatted 2\nDimension 2\nSolAtVertices\n1\n1 1\n7\nEnd\n")
    files = [str(tmp_path / "in.mesh"), str(tmp_path / "out.mesh")]
    command, *flags = words.split()
    assert cli.main([command, *files, *flags]) == 2
    told, error = capsys.readouterr().err.splitlines()
    assert "warning: " in told
    assert "in.sol is not read, it has values for 1 vert" in told
    assert said in error


def test_a_row_of_a_batch_names_options_by_their_flags(ball, tmp_path):
    out = tmp_path / "out"
    assert cli.main(["batch", str(ball[0]), "--out", str(out), "--size", "g", "--quiet"]) == 1
    assert "got --size g; expected the name of" in (out / "summary.csv").read_text()


def test_a_size_without_a_character_is_refused_as_a_size(ball, tmp_path, capsys):
    assert cli.main(["remesh", str(ball[0]), str(tmp_path / "out.vtu"), "--size", ""]) == 2
    assert "got --size ''; expected a length, " in capsys.readouterr().err


def test_sizes_that_tetrahedra_of_tetwild_cannot_have_are_refused_before_it_runs(
    ball, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(tetwild, "run_tetwild", lambda *_: pytest.fail("TetWild ran"))
    points, faces = sphere(2)
    words = ["tetrahedralize", str(ball[0]), str(tmp_path / "out.vtu")]
    assert cli.main([*words, "--size", "h"]) == 2
    assert "got --size h for a surface, whose vertices" in capsys.readouterr().err
    with pytest.raises(InvalidOptionError, match=r"got size= of shape \(\d+,\) for a surface"):
        tetwild.tetrahedralize(points, faces, size=points[:, 0] + 2.0)
    assert cli.main([*words, "--size", "0.5", "--levels", "1"]) == 2
    assert "got --size beside --levels 1; expected either" in capsys.readouterr().err


def test_tetwild_and_then_sizes(ball, tmp_path):
    out = tmp_path / "out.vtu"
    points, cells = sphere(2, 0.1)
    coarse = odt_plugins.tetrahedralize(points, cells, edge_length_fac=0.1, scale=1.6,
                                        envelope=0.02, vtk_ordering=True)
    plain = odt_plugins.tetrahedralize(points, cells, edge_length_fac=0.1, odt=False)
    assert len(coarse[1]) < 0.7 * len(plain[1])
    assert cli.main(["tetrahedralize", str(ball[0]), str(out), "--edge-length", "0.1",
                     "--size", "0.5", "--envelope", "0.05", "--quiet"]) == 0
    made = meshio.read(out)
    assert np.linalg.norm(made.points, axis=1).max() < 1.1
    pairs = made.cells_dict["tetra"][:, [[0, 1], [1, 2], [2, 3], [0, 3], [0, 2], [1, 3]]]
    ends = made.points[pairs.reshape(-1, 2)]
    assert np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean() == pytest.approx(0.5, rel=0.15)
    for more, said in (({"odt": False}, "odt=False"), ({"insert": True}, "got insert=")):
        with pytest.raises(InvalidOptionError, match=said):
            odt_plugins.tetrahedralize(points, cells, scale=2, **more)
    with pytest.raises(InvalidOptionError, match="levels=1"):
        odt_plugins.tetrahedralize(ball[0], levels=1, scale=2)
