"""The figures that the README states, reached through the command line on the stored meshes."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import meshio
import numpy as np
import planar_meshes as pm
import pytest
import tet_meshes as tm

from odt_plugins.cli.main import main

ROOT = Path(__file__).parents[2]
BUNNY = ROOT / "odt_plugins" / "compare" / "data" / "bunny.vtu"
BONE = ROOT / "tests" / "data" / "bone05.vtu"
BALL = ROOT / "examples" / "meshes" / "ball.vtu"
AIRFOIL = ROOT / "examples" / "meshes" / "airfoil.vtu"


def read(path):
    mesh = meshio.read(path)
    if "tetra" in mesh.cells_dict:
        cells = mesh.cells_dict["tetra"]
        return mesh.points, cells if path.stem != "bone05" else cells[:, [1, 0, 2, 3]]
    return mesh.points[:, :2], mesh.cells_dict["triangle"]


def figures(points, cells):
    """Mean, 1 %, min of q, smallest and largest angle, by the tests' own code."""
    q, angles = (
        pm.shape(points, cells)
        if cells.shape[1] == 3
        else (tm.quality(points, cells), tm.dihedral_angles(points, cells))
    )
    return q.mean(), np.quantile(q, 0.01), q.min(), angles.min(), angles.max()


@pytest.mark.parametrize(
    ("path", "mean", "p1", "least", "smallest", "largest"),
    [
        (BUNNY, 0.798, 0.47, 0.15, 11.77, 157.06),
        (BONE, 0.685, 0.40, 0.106, 10.29, 164.43),
        (BALL, 0.88, 0.70, 0.50, 25.0, 139.0),
        (AIRFOIL, 0.95, 0.80, 0.65, 15.0, 135.0),
    ],
    ids=["bunny", "bone", "ball", "airfoil"],
)
def test_what_it_must_reach(tmp_path, path, mean, p1, least, smallest, largest):
    output = tmp_path / path.name
    assert main(["optimize", str(path), str(output), "--quiet"]) == 0
    before, after = read(path), read(output)
    reached = figures(*after)
    assert reached[0] >= mean
    assert reached[1] >= p1
    assert reached[2] >= least
    assert reached[3] >= smallest
    assert reached[4] <= largest
    boundary = np.zeros(len(before[0]), dtype=bool)
    faces, owners = np.unique(
        np.sort(np.concatenate([np.delete(before[1], i, axis=1)
                                for i in range(before[1].shape[1])]), axis=1),
        axis=0, return_counts=True)
    boundary[faces[owners == 1]] = True
    assert before[0][boundary].tobytes() == after[0][boundary].tobytes()
    if path is AIRFOIL:
        size = lambda p, c: np.sqrt(pm.areas(p, c)).mean()  # noqa: E731
        assert size(*after) == pytest.approx(size(*before), rel=0.05)
        assert len(np.unique(after[1])) == len(np.unique(before[1]))


def test_the_script_prints_what_the_command_reports(capsys):
    spec = importlib.util.spec_from_file_location("figures", ROOT / "examples" / "figures.py")
    script = importlib.util.module_from_spec(spec)
    sys.modules["figures"] = script
    spec.loader.exec_module(script)
    script.main([str(BONE), "--", "--smoothing", "rounds=2"])
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 6
    assert lines[2].startswith("| bone05 | before | 0.6795 | 0.370 | 0.106 | 10.3..164.4 |")
    assert float(lines[3].split("|")[3]) > 0.69
