"""The scripts of examples/paper reach the paper's figures."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pictures import draw_small

pytest.importorskip("matplotlib")
FOLDER = Path(__file__).parents[2] / "examples" / "paper"


@pytest.fixture
def script(monkeypatch):
    """Import a script of the folder by name."""
    monkeypatch.syspath_prepend(str(FOLDER))
    draw_small(monkeypatch)
    yield importlib.import_module
    for path in FOLDER.glob("*.py"):
        sys.modules.pop(path.stem, None)


def drawn(folder, *names):
    """Every picture is there and is not empty."""
    from matplotlib.image import imread

    for name in names:
        pixels = imread(folder / name)[:, :, :3]
        assert pixels.min() < 0.4, name
        assert pixels.std() > 0.02, name
    assert {p.name for p in folder.iterdir()} == set(names)


def test_a_script_is_run_with_the_folder_of_its_pictures(tmp_path):
    done = subprocess.run([sys.executable, str(FOLDER / "fig03_boundary.py"), "pictures"],
                          cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "barycenters at the boundary         away | 0.4" in done.stdout
    assert [p.name for p in tmp_path.rglob("*")] == ["pictures", "fig03.png"]


def test_fig3_a_vertex_stays_off_the_boundary(script, tmp_path):
    module = script("fig03_boundary")
    result = module.main(tmp_path)
    assert result[False][0] == pytest.approx(module.HEIGHT, rel=1e-6)
    assert result[True][0] > 3 * result[False][0]
    assert result[True][1] > 5 * result[False][1]
    drawn(tmp_path, "fig03.png")


def test_figs4_and_5_channel(script, tmp_path, capsys):
    result, gaps = script("fig04_05_channel").main(tmp_path)
    _, odt, cpt, best = result.values()
    assert odt[0] >= 0.69
    assert odt[1] >= 0.964
    assert odt[2] <= 5.3
    assert cpt[0] >= 0.69
    assert cpt[1] >= 0.965
    assert odt[2] < cpt[2]
    assert best[0] >= 0.82
    assert best[1] >= 0.968
    for curve in gaps:
        assert (np.diff(curve["ODT"]) < 0).all()
        assert (np.diff(curve["CPT"]) < 0).all()
        assert (curve["ODT"] < curve["CPT"])[2:].all()
        assert curve["ODT"][1] < 0.25 * curve["ODT"][0]
    assert "0.709 | 0.69" in capsys.readouterr().out
    drawn(tmp_path, "fig04.png", "fig05.png")


def test_fig6_airfoil(script, tmp_path):
    _, literal, best = script("fig06_airfoil").main(tmp_path).values()
    assert literal[0] >= 0.57
    assert literal[1] >= 0.95
    assert best[0] >= 0.65
    assert best[1] >= 0.95
    for _, _, change, deleted in (literal, best):
        assert float(change.rstrip("%")) < 5.0
        assert deleted == 0
    drawn(tmp_path, "fig06.png")


def test_figs7_and_8_four_global_steps(script, tmp_path):
    result, steps = script("fig07_08_global").main(tmp_path)
    assert steps["global, alpha 1"] == 4
    assert steps["global, alpha 0.75"] <= 8
    assert steps["Jacobi"] is None
    assert result["global, alpha 1"][4] < 1e-3 < 0.05 < result["Gauss-Seidel"][4]
    drawn(tmp_path, "fig07.png", "fig08.png")


def test_fig10_ball(script, tmp_path):
    start, odt, cpt, best = script("fig10_ball").main(tmp_path).values()
    assert start[0] == pytest.approx(0.74, abs=0.02)
    assert min(odt[0], cpt[0]) > start[0] + 0.09
    assert max(odt[1], cpt[1]) < 0.1 * start[1]
    assert odt[3] < cpt[3]
    assert best[0] >= 0.88
    assert best[1] == 0
    drawn(tmp_path, "fig10.png")


def test_fig11_bunny(script, tmp_path):
    result, means = script("fig11_bunny").main(tmp_path, slide=False)
    assert means["ODT"][10] > means["CPT"][10] > means["CVT"][10] > means["CVT"][0]
    assert means["ODT"][10] > means["ODT"][0] + 0.07
    assert result["odt_plugins.optimize"][0] > result["ODT"][0] + 0.03
    assert result["odt_plugins.optimize"][1] == 0
    drawn(tmp_path, "fig11.png")


def test_section43_two_grids(script, tmp_path):
    result = script("two_grid").main(tmp_path, levels=2, space_levels=1)
    for fine, both in result.values():
        assert both[1] < 0.25 * fine[1]
        assert both[2].mean > fine[2].mean
        assert both[2].uniformity < fine[2].uniformity
        assert both[0] < 1.02 * fine[0]
    fine, both = result["channel"]
    assert both[0] < fine[0]
    drawn(tmp_path, "two_grid.png")


def test_fig9_table1_and_step_tables(script, tmp_path, capsys):
    """One seed of two domains; the medians of all six are those of test_generate_mesh."""
    module = script("fig09_table1")
    table, steps = module.main(tmp_path, names=("ring", "crescent"), seeds=(0,))
    for name, (literal, ours) in table.items():
        least, mean, uniformity = module.SAMPLES[name].paper
        assert ours.least >= least
        assert ours.mean >= mean - 0.005
        assert ours.uniformity <= 100 * uniformity
        assert literal.least == pytest.approx(least, abs=0.06)
        assert literal.mean == pytest.approx(mean, abs=0.01)
        assert literal.uniformity < 100 * uniformity + 1.5
    got, paper = steps["crescent"], np.array(module.PAPER_STEPS["crescent"])
    assert np.abs(got - paper)[:, 1].max() < 0.015
    assert np.abs(got - paper)[3:, 0].max() < 0.1
    assert (got - paper)[:, 2].max() < 1.5
    assert got[3, 0] > got[2, 0]
    assert "4. odtmeshoptimization  0.73 | 0." in capsys.readouterr().out
    drawn(tmp_path, "fig09.png")
