"""The plugin in ParaView itself: filters, properties, progress, errors, a picture."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest
import surface_meshes

import odt_plugins
from odt_plugins.cli import main as cli
from odt_plugins.cli import paraview
from odt_plugins.figures import radius_ratio
from odt_plugins.options import OPTIONS

pyvista = pytest.importorskip("pyvista")

BONE = Path(odt_plugins.__file__).parent / "compare" / "data" / "bone.vtu"
SESSION = Path(__file__).with_name("paraview_session.py")


@pytest.fixture
def session(tmp_path):
    """What the session found, what it said, and its folder."""
    for program in ("pvpython", "Xvfb"):
        assert shutil.which(program), (
            f"{program} is not installed; on Debian, as root: apt-get install -y "
            "python3-paraview paraview xvfb")
    folder = tmp_path
    mesh = pyvista.read(BONE)
    mesh["height"] = mesh.points[:, 2].astype(float)
    mesh.save(folder / "mesh.vtu")
    points, faces = (np.array(part) for part in surface_meshes.sphere(1))
    surface = pyvista.PolyData.from_regular_faces(points, faces)
    surface.cell_data["side"] = 1 + (points[faces].mean(axis=1)[:, 2] > 0)
    surface.save(folder / "surface.vtp")
    display, number = os.pipe()
    # A server that starts anew whenever its last window closes refuses who comes just then.
    with subprocess.Popen(["Xvfb", "-noreset", "-displayfd", str(number),
                           "-screen", "0", "1000x600x24"],
                          pass_fds=[number], stderr=subprocess.DEVNULL) as server:
        os.close(number)
        with open(display) as file:
            name = file.readline().strip()
        environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
        environment |= {"DISPLAY": f":{name}", "ODT_PLUGINS_PYTHON": sys.executable}
        done = subprocess.run(
            ["pvpython", "--force-offscreen-rendering", str(SESSION), str(folder),
             str(paraview.PLUGIN)], capture_output=True, text=True, check=False, env=environment)
        server.terminate()
    assert done.returncode == 0, done.stderr
    return json.loads((folder / "found.json").read_text()), done.stderr, folder


def optimize_is_that_of_the_package(session):
    found, _, folder = session
    mesh = meshio.read(folder / "mesh.vtu")
    truth = odt_plugins.optimize(mesh, smoothing={"exponent": 4.0, "rounds": 10})
    for when, own in (("before", mesh), ("after", truth)):
        q = radius_ratio(own.points, own.cells_dict["tetra"])
        assert found[when]["class"] == "vtkUnstructuredGrid"
        assert found[when]["arrays"]["odt_radius_ratio"] == pytest.approx(np.abs(q).tolist())
        assert found[when]["fields"] == ["height"]
    least = [min(found[when]["arrays"]["odt_radius_ratio"]) for when in ("before", "after")]
    assert least[1] > least[0] + 0.1
    assert {"odt_min_angle", "odt_max_angle", "odt_altitude"} < set(found["after"]["arrays"])


def properties_are_the_options(session):
    found = session[0]
    named = {"".join(word.capitalize() for word in name.split("_")) for name, about
             in OPTIONS.items() if about.metadata["flag"] is not None}
    assert named == set(found["properties"]) - {"Input", "ReloadPythonModule"}
    assert tuple(found["choices"]) == OPTIONS["objective"].metadata["choices"]


def progress_grows_in_the_bar_of_paraview(session):
    told = session[0]["progress"]
    assert len(set(told)) > 5
    assert told[-1] == 1.0


def errors_are_the_sentences_of_the_package(session):
    found, said, _ = session
    assert found["refused"] == 0
    assert "got smoothing={'exponent': -4}; expected a positive number" in said
    assert "Traceback" not in said


def surfaces_are_optimised_and_filled(session):
    found = session[0]
    assert found["surface"]["class"] == "vtkPolyData"
    assert found["surface"]["cells"] == 80
    assert sorted(set(found["surface"]["arrays"]["side"])) == [1, 2]
    assert found["coarse"]["class"] == "vtkPolyData"
    assert 0 < found["coarse"]["cells"] < 80
    assert sorted(set(found["coarse"]["arrays"]["side"])) == [1, 2]
    assert found["filled"]["class"] == "vtkUnstructuredGrid"
    # Tetrahedra have no label, the triangles of the boundary have those of the faces.
    assert sorted(set(found["filled"]["arrays"]["side"])) == [0, 1, 2]


def both_meshes_are_in_the_picture(session):
    from matplotlib.image import imread

    pixels = (imread(session[2] / "shot.png")[:, :, :3] * 255).astype(int)
    half = pixels.shape[1] // 2
    for side in (pixels[:, :half], pixels[:, half:]):
        assert len(np.unique(side.reshape(-1, 3), axis=0)) > 200
        assert 0.05 < (side < 250).any(axis=2).mean() < 0.9


def test_the_filters_work_in_paraview(session):
    """One test, so that ParaView runs once however many processes the tests have."""
    for check in (optimize_is_that_of_the_package, properties_are_the_options,
                  progress_grows_in_the_bar_of_paraview, errors_are_the_sentences_of_the_package,
                  surfaces_are_optimised_and_filled, both_meshes_are_in_the_picture):
        check(session)


def test_the_command_says_how_to_load_the_plugin(capsys):
    assert cli.main(["paraview"]) == 0
    said = capsys.readouterr().out
    assert str(paraview.PLUGIN) in said
    assert f"ODT_PLUGINS_PYTHON={sys.executable}" in said
    assert paraview.PLUGIN.is_file()


def test_work_is_told_line_by_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", open(os.devnull))
    jobs = [{"task": "optimize", "source": str(BONE), "target": str(tmp_path / "out.vtu"),
             "options": {"smoothing": {"rounds": 1}, "fixed": "nothing"}},
            {"task": "optimize", "source": str(tmp_path / "none.vtu"), "options": {},
             "target": str(tmp_path / "out.vtu")}]
    for job, sentence in zip(jobs, ("expected the name of a point array", "it is missing"),
                             strict=True):
        monkeypatch.setattr(json, "load", lambda file, job=job: job)
        paraview.main()
        last = json.loads(capsys.readouterr().out.splitlines()[-1])
        assert sentence in last["error"]
        assert not (tmp_path / "out.vtu").exists()
