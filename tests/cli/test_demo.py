"""The demo: its bunny, TetWild in a directory of its own, and everything it writes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest

from odt_plugins.cli import demo
from odt_plugins.cli import main as cli
from odt_plugins.errors import MissingDependencyError

STORED = Path(__file__).parents[1] / "data" / "tetwild_bunny.vtu"

CUBE = np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
FACES = np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))], dtype=np.int32)


def test_the_bunny_is_read_as_pymeshlab_reads_it(tmp_path: Path) -> None:
    pytest.importorskip("pymeshlab")
    script = ("import sys, pymeshlab, numpy as np; ms = pymeshlab.MeshSet();"
              "ms.load_new_mesh(sys.argv[1]); m = ms.current_mesh();"
              "np.savez(sys.argv[2], p=m.vertex_matrix(), f=m.face_matrix())")
    file = tmp_path / "bunny.npz"
    subprocess.run([sys.executable, "-c", script, str(demo.bunny_path()), str(file)], check=True)
    points, faces = demo.read_obj(demo.bunny_path())
    with np.load(file) as theirs:
        assert np.allclose(points, theirs["p"], rtol=1e-6)
        assert {tuple(f) for f in theirs["f"].tolist()} <= {tuple(f) for f in faces.tolist()}


def test_obj_counts_from_one_and_backwards(tmp_path: Path) -> None:
    file = tmp_path / "two.obj"
    file.write_text("# remark\n\nv 0 0 0\nv 1 0 0 1.0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n"
                    "v 0 0 1\nf -4//1 -1//2 -3//3\n")
    points, faces = demo.read_obj(file)
    assert points.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    assert faces.tolist() == [[0, 1, 2], [0, 3, 1]]


def test_a_missing_toolkit_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for place in ("odt_plugins.errors", "odt_plugins.cli.demo"):
        monkeypatch.setattr(f"{place}.find_spec", lambda name: None)
    with pytest.raises(MissingDependencyError, match=r'pymeshlab and pytetwild.*\[all\]'):
        demo.run_demo(tmp_path / "out")
    with pytest.raises(MissingDependencyError, match="did not find it"):
        demo.bunny_path()
    assert list(tmp_path.iterdir()) == []


def test_the_demo_writes_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("pymeshlab", "pytetwild", "matplotlib"):
        pytest.importorskip(name)
    stored = meshio.read(STORED)
    made = (stored.points, stored.cells_dict["tetra"].astype(np.int32))
    monkeypatch.setattr(demo, "tetrahedralize", lambda *_, **__: made)
    assert cli.main(["demo", "--out", str(tmp_path / "out"), "--threads", "1"]) == 0
    text = capsys.readouterr().out
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == sorted(demo.FILES)
    assert all(name in text for name in demo.FILES)
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    for name in ("min_quality", "p1_quality", "mean_quality", "min_angle"):
        assert report["after"][name] >= report["before"][name]
    assert report["after"]["mean_quality"] > report["before"]["mean_quality"]
    before, after = (meshio.read(tmp_path / "out" / name) for name in demo.FILES[:2])
    assert np.array_equal(before.points, stored.points)
    assert before.points.shape == after.points.shape
    assert f"{report['after']['mean_quality']:.4f}" in text
