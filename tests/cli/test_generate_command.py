"""odt-plugins mesh: the paper's domains and Python files, one sentence for every mistake."""

from __future__ import annotations

import json
import sys

import meshio
import numpy as np
import planar_meshes as planar
import pytest
import surface_meshes

from odt_plugins.adapters import files
from odt_plugins.cli import main as cli

DISK = """
import numpy as np
def fd(p): return np.hypot(p[:, 0] - 3, p[:, 1]) - 1
def fh(p): return 1 + np.hypot(p[:, 0] - 3, p[:, 1])
bbox = [[2, -1], [4, 1]]
pfix = [[3, 0]]
"""


@pytest.fixture
def place(tmp_path, monkeypatch):
    (tmp_path / "disk.py").write_text(DISK)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_domain_of_the_paper_is_written_and_reported(place, capsys):
    assert cli.main(["mesh", "circle", "out.vtu", "--size", "0.2", "--report", "out.json"]) == 0
    mesh = meshio.read("out.vtu")
    points, cells = mesh.points[:, :2], mesh.cells_dict["triangle"]
    assert planar.areas(points, cells).sum() == pytest.approx(np.pi, rel=0.02)
    said = capsys.readouterr().out
    assert "unit circle" in said
    assert "mean quality" in said
    values = json.loads((place / "out.json").read_text())
    assert values["n_points"] == len(points)
    assert values["min_quality"] == pytest.approx(planar.shape(points, cells)[0].min())


def test_a_python_file_gives_fd_fh_bbox_and_pfix(place, capsys):
    assert cli.main(["mesh", "disk.py", "out.msh", "--size", "0.1", "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    points = files.read_file("out.msh").points
    assert points[0].tolist() == [3, 0, 0]
    assert np.hypot(points[:, 0] - 3, points[:, 1]).max() == pytest.approx(1, abs=1e-9)


def test_a_python_file_imports_those_beside_it(place):
    folder = place / "domains"
    folder.mkdir()
    (folder / "round_domains.py").write_text(DISK)
    (folder / "disk.py").write_text("from round_domains import bbox, fd, fh, pfix\n")
    paths = list(sys.path)
    assert cli.main(["mesh", "domains/disk.py", "out.vtu", "--size", "0.2", "--quiet"]) == 0
    assert sys.path == paths
    sys.modules.pop("round_domains")


def test_an_edge_length_of_tetwild_is_refused_for_tetrahedra(place, capsys):
    points = np.vstack([np.zeros(3), np.eye(3)])
    meshio.write("tets.vtu", meshio.Mesh(points, [("tetra", [[0, 1, 2, 3]])]))
    assert cli.main(["mesh", "tets.vtu", "out.vtu", "--edge-length", "0.1"]) == 2
    assert "got --edge-length for tetrahedra that are there" in capsys.readouterr().err
    assert cli.main(["mesh", "tets.vtu", "out.vtu", "--quiet"]) == 0


def test_a_surface_becomes_tetrahedra(place, capsys):
    pytest.importorskip("pytetwild")
    points, faces = surface_meshes.sphere(2)
    meshio.write("ball.stl", meshio.Mesh(points, [("triangle", faces)]), binary=True)
    meshio.write("open.vtu", meshio.Mesh(points, [("triangle", faces[1:])]))
    capsys.readouterr()
    assert cli.main(["mesh", "ball.stl", "out.vtu", "--edge-length", "0.3", "--envelope", "0.02",
                     "--levels", "1", "--report", "out.json"]) == 0
    out = meshio.read("out.vtu")
    x = out.points[out.cells_dict["tetra"]]
    assert np.linalg.det(x[:, 1:] - x[:, :1]).sum() / 6 == pytest.approx(4.0, rel=0.03)
    values = json.loads((place / "out.json").read_text())
    assert values["levels"][1]["quality"]["n_cells"] == len(x)
    assert values["envelope"] == pytest.approx(0.02 * 12**0.5, rel=0.01)
    assert "TetWild" in capsys.readouterr().out
    for words, told in (
        (["open.vtu", "no.vtu"], "not closed: 3 edges"),
        (["ball.stl", "no.vtu", "--size", "0.1"], "expected --edge-length and --levels"),
        (["disk.py", "no.vtu", "--envelope", "0.1", "--size", "0.1"], "expected --size"),
    ):
        assert cli.main(["mesh", *words]) in (1, 2)
        assert told in capsys.readouterr().err
        assert not (place / "no.vtu").exists()


def test_levels_and_seed_reach_the_generator(place):
    for name, more in (("a.vtu", []), ("b.vtu", []), ("c.vtu", ["--seed", "5"]),
                       ("d.vtu", ["--levels", "1"])):
        assert cli.main(["mesh", "disk.py", name, "--size", "0.1", "--quiet", *more]) == 0
    a, b, c, d = (meshio.read(f"{name}.vtu").points for name in "abcd")
    assert np.array_equal(a, b)
    assert not np.array_equal(a, c[: len(a)])
    assert len(d) != len(a)


WRONG = {
    "unknown": (["disk", "o.vtu"], "", 2, "expected one of circle, ring"),
    "missing": (["none.py", "o.vtu"], "", 1, "it is missing"),
    "no fd": (["d.py", "o.vtu"], "h0 = 1", 2, "defines no function fd"),
    "broken": (["d.py", "o.vtu"], "1 +", 2, "does not run: SyntaxError"),
    "no size": (["disk.py", "o.vtu"], "", 2, "does not say h0; expected --size"),
    "raises": (["d.py", "o.vtu", "--size", "1"], "def fd(p): return 1 / 0\n", 2,
               "fails: ZeroDivisionError: division by zero"),
    "positive": (["d.py", "o.vtu", "--size", "1"], "def fd(p): return p[:, 0]**2 + 1\n", 2,
                 "without a negative value"),
    "too many": (["circle", "o.vtu", "--size", "1e-5"], "", 2, "about 3.63e+10 points"),
    "suffix": (["circle", "o.nothing"], "", 1, "o.nothing"),
    "same": (["circle", "o.vtu", "--report", "o.vtu"], "", 2, "name the same file"),
}


@pytest.mark.parametrize("name", WRONG)
def test_mistakes_are_told_in_one_line_and_write_nothing(place, capsys, name):
    arguments, text, code, sentence = WRONG[name]
    (place / "d.py").write_text(text)
    assert cli.main(["mesh", *arguments]) == code
    told = capsys.readouterr()
    assert told.out == ""
    assert sentence in told.err
    assert told.err.count("\n") == 1
    assert not list(place.glob("o.*"))


@pytest.mark.parametrize("option", ["--size", "--seed", "--most-points"])
def test_what_is_for_the_plane_is_refused_for_surfaces(place, capsys, option):
    (place / "s.stl").write_text("solid\nendsolid\n")
    assert cli.main(["mesh", "s.stl", "o.vtu", option, "5"]) == 2
    assert "for a mesh of tetrahedra; expected" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--edge-length", "--envelope", "--threads"])
def test_what_is_for_tetrahedra_is_refused_for_domains(place, capsys, option):
    assert cli.main(["mesh", "circle", "o.vtu", "--size", "0.3", option, "2"]) == 2
    told = capsys.readouterr().err
    assert option in told
    assert "for a mesh of triangles; expected --size" in told
    assert not list(place.glob("o.*"))
