"""Signals at random moments of the command: it ends soon and leaves nothing half-written."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from functools import cache
from pathlib import Path

import contract
import meshio
import numpy as np
import surface_meshes

from attack.damage import FORMATS, TRIANGLES
from attack.judge import Broken

SECONDS = 120.0
"""No case may take longer."""

SOON = 10.0
"""Seconds within which a command has to end after a signal."""

OLD = b"what was there before"

Rng = np.random.Generator


def attack(rng: Rng, folder: Path) -> None:
    """Optimise a file to a file and send a signal to the process.

    Raises
    ------
    Broken    it went on, left something behind, or said more than a line
    """
    name = str(rng.choice(sorted(FORMATS)))
    flat = name in TRIANGLES
    out = folder / "out"
    out.mkdir()
    source, target = folder / "in.vtu", out / f"better{FORMATS[name][0]}"
    start_mesh(flat=flat).write(source)
    if rng.random() < 0.5:
        target.write_bytes(OLD)
    number = signal.SIGINT if rng.random() < 0.5 else signal.SIGTERM
    moment = rng.uniform(0.2, 1.05) * usual_seconds(flat=flat)
    with subprocess.Popen(command(source, target), stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                          text=True) as process:
        try:
            process.wait(moment)
        except subprocess.TimeoutExpired:
            process.send_signal(number)
        clock = time.monotonic()
        try:
            _, errors = process.communicate(timeout=SOON)
        except subprocess.TimeoutExpired:
            process.kill()
            msg = f"{number.name} after {moment:.2f} s did not end it within {SOON:g} s"
            raise Broken([msg]) from None
    seconds = time.monotonic() - clock
    faults = [f"{fault}, {number.name} after {moment:.2f} s, it took {seconds:.1f} s"
              for fault in left_behind(out, target, process.returncode, errors)
              # Before the command has begun and after its end, the interpreter answers.
              if not (fault.startswith("a traceback") and "odt_plugins/cli.py" not in errors)
              # CPython forgets that an interrupt was caught when it came within an exec of text.
              and fault not in (f"it ended with {-number}", f"it ended with {-signal.SIGINT}")]
    if faults:
        raise Broken(faults)


def command(source: Path, target: Path) -> list[str]:
    """Words of the command that optimises a file."""
    return [sys.executable, "-m", "odt_plugins", "optimize", str(source), str(target)]


def start_mesh(*, flat: bool) -> meshio.Mesh:
    """Triangles or tetrahedra that take about as long as starting the interpreter."""
    if flat:
        points, cells = surface_meshes.torus(60, 30, 0.3)
    else:
        points, cells, _ = contract.grid(3, 8)
    return meshio.Mesh(points, [("triangle" if flat else "tetra", cells)])


@cache
def usual_seconds(*, flat: bool) -> float:
    """How long the command takes when it is left alone."""
    source = Path("usual.vtu")
    start_mesh(flat=flat).write(source)
    clock = time.monotonic()
    subprocess.run(command(source, Path("done.vtu")), check=True, capture_output=True)
    return time.monotonic() - clock


def left_behind(out: Path, target: Path, code: int, errors: str) -> list[str]:
    """Say what is wrong about an output folder, an exit code and what was said.

    Parameters
    ----------
    out : path       had nothing, or `target` with OLD in it
    target : path
    code : int       0: the target is whole; 1: nothing of it is there
    errors : str     standard error
    """
    faults = []
    if "Traceback" in errors:
        faults.append(f"a traceback: {' '.join(errors.split())[-300:]}")
    elif code == 1 and len(errors.strip().splitlines()) != 1 and "warning" not in errors:
        faults.append(f"it said {errors!r}")
    if code not in (0, 1):
        faults.append(f"it ended with {code}")
    there = {path.name for path in out.iterdir()}
    new = target.is_file() and target.read_bytes() != OLD
    hidden = sorted(name for name in there if name.startswith("."))
    if hidden:
        faults.append(f"{hidden} were left behind")
    elif not new and there - {target.name}:
        faults.append(f"{sorted(there - {target.name})} are there without {target.name}")
    if code == 0 and not new:
        faults.append("it ended well and wrote nothing")
    if new:
        from odt_plugins.adapters.files import read_file

        read_file(target)
    return faults
