"""Systems without groups of processes, limits of memory and their signals, such as Windows."""

import os
import subprocess
import sys
from pathlib import Path

import meshio
import pytest

import odt_plugins
from odt_plugins.generate.clouds import ball
from odt_plugins.processes import GROUP, end_group, is_gone

HERE = Path(__file__).parent
EVERYTHING = """
import importlib, os, pkgutil, signal, sys
import odt_plugins
assert not hasattr(os, "killpg") and not hasattr(signal, "SIGKILL")
for module in pkgutil.walk_packages(odt_plugins.__path__, "odt_plugins."):
    last = module.name.rpartition(".")[2]
    # Toolkits' own programs load these files, where their modules are; kernels.so is a library.
    if last not in ("__main__", "paraview_plugin", "kernels"):
        importlib.import_module(module.name)
"""
COMMANDS = {
    "optimize": ["optimize", "ball.vtu", "out/ball.vtu"],
    "batch": ["batch", "ball.vtu", "ball-2.vtu", "--out", "out", "--timeout", "200"],
    "workers": ["batch", "ball.vtu", "ball-2.vtu", "--out", "out", "--workers", "2"],
    "compare": ["compare", "ball.vtu", "--against", "pymeshlab", "--repeats", "1", "--no-poisson",
                "--out", "out"],
}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with two small meshes."""
    folder = tmp_path_factory.mktemp("place")
    points, cells = ball(60)
    for name in ("ball.vtu", "ball-2.vtu"):
        meshio.write(folder / name, meshio.Mesh(points, [("tetra", cells)]))
    return folder


def emulated(folder, *words):
    """What a command says on a Python without what only Unix has."""
    path = os.pathsep.join(
        [str(HERE / "helpers" / "emulated_windows"), str(Path(odt_plugins.__file__).parents[1])])
    done = subprocess.run([sys.executable, *words], cwd=folder, text=True, capture_output=True,
                          env=os.environ | {"PYTHONPATH": path}, check=False, timeout=250)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


def test_every_module_is_imported(tmp_path):
    emulated(tmp_path, "-c", EVERYTHING)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_does_its_work(place, tmp_path, command):
    for name in ("ball.vtu", "ball-2.vtu"):
        (tmp_path / name).write_bytes((place / name).read_bytes())
    (tmp_path / "out").mkdir()
    emulated(tmp_path, "-m", "odt_plugins", *COMMANDS[command])
    made = {file.name for file in (tmp_path / "out").iterdir()}
    assert made & {"ball.vtu", "comparison.html"}, made


def test_a_limit_of_memory_is_refused_in_one_sentence(place):
    code = ("import sys\nfrom odt_plugins.cli.main import main\n"
            "sys.exit(main(['batch', 'ball.vtu', '--out', 'no', '--memory-limit', '4']) != 2)")
    said = emulated(place, "-c", code)
    assert "this system cannot set" in said
    assert "Traceback" not in said


def test_a_process_ends_with_what_it_started(tmp_path):
    code = ("import subprocess, sys, time\n"
            "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'])\n"
            "print('ready', flush=True)\ntime.sleep(60)")
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True,
                               **GROUP)
    with process.stdout as told:
        told.readline()
        assert not is_gone(process.pid)
        end_group(process)
        # The pipe ends when the last process that can write into it has.
        assert told.read() == ""
    assert is_gone(process.pid)
    assert process.returncode == -9
