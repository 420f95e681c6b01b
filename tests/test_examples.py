"""Every example is run and one of its numbers checked; those of pymeshlab beside its filters."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


def example(name):
    """Module of an example."""
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def colours(path):
    """Number of different colours in the left and in the right half of a picture."""
    from matplotlib.image import imread

    pixels = (imread(path)[:, :, :3] * 255).astype(int)
    half = pixels.shape[1] // 2
    return [len({tuple(c) for c in side.reshape(-1, 3)[::7].tolist()})
            for side in (pixels[:, :half], pixels[:, half:])]


def test_a_tetwild_mesh_is_improved(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # pytetwild writes a file there
    for name in ("pytetwild", "pyvista"):
        pytest.importorskip(name)
    report = example("tetwild_postprocess").main()
    assert report.after.mean_quality > report.before.mean_quality + 0.01
    assert report.after.min_quality >= report.before.min_quality
    assert report.after.min_angle >= report.before.min_angle
    assert report.fallback is None


def test_open3d_tetrahedra_are_improved_and_drawn(tmp_path):
    for name in ("open3d", "matplotlib"):
        pytest.importorskip(name)
    before, after = example("open3d_pipeline").main(tmp_path / "ball.png")
    assert before < 0.55
    assert after > 0.78
    assert min(colours(tmp_path / "ball.png")) > 50


def test_a_sizing_field_is_kept():
    for name in ("pytetwild", "pyvista"):
        pytest.importorskip(name)
    (plain, spread), (better, kept) = example("sizing_field").main().values()
    assert better > plain + 0.005
    assert kept < spread + 0.1


def test_pyvista_renders_without_a_window(tmp_path):
    """In a process of its own: a graphics driver that is missing ends it."""
    for name in ("pyvista", "matplotlib"):
        pytest.importorskip(name)
    picture = tmp_path / "picture.png"
    done = subprocess.run([sys.executable, str(EXAMPLES / "pyvista_before_after.py"), str(picture)],
                          capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    words = done.stdout.split()
    before, after = float(words[3]), float(words[5].rstrip(","))
    assert before < 0.55
    assert after > 0.78
    assert min(colours(picture)) > 50
