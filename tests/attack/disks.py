"""Disks that fill: one sentence, nothing half-written, and the interpreter ends as it should."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import contract
import meshio
import numpy as np
import surface_meshes
from processes import full_disk

from attack.damage import FORMATS, TRIANGLES
from attack.judge import Broken
from attack.signals import OLD, left_behind
from odt_plugins.errors import ODTError

SECONDS = 120.0
"""No case may take longer."""

Rng = np.random.Generator

CHILD = """
import os, resource, sys
from pathlib import Path
from odt_plugins.cli.main import main
source, whole, target, share = sys.argv[1:]
if main(["optimize", "--quiet", source, whole]) != 0:
    sys.exit(100)
size = max(path.stat().st_size for path in Path(whole).parent.iterdir())
limit = int(float(share) * size)
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
again = "import sys; from odt_plugins.cli.main import main; sys.exit(main(sys.argv[1:]))"
os.execv(sys.executable, [sys.executable, "-c", again, "optimize", "--quiet", source, target])
"""
"""Write a file once with room enough, and then where files may not be longer than a share.

The second time is a new process: VTK writes in a helper process that the first time has started,
which the limit would not reach.
"""


def attack(rng: Rng, folder: Path) -> None:
    """Write a file of any format where it has not enough room.

    Raises
    ------
    Broken      it went wrong without a word, or left something behind
    ODTError    the format does not hold the mesh
    """
    name = str(rng.choice(sorted(FORMATS)))
    suffix = FORMATS[name][0]
    flat = name in TRIANGLES or rng.random() < 0.2
    if flat:
        points, cells = surface_meshes.bowl(int(rng.integers(4, 12)), 0.3)
    else:
        points, cells, _ = contract.grid(3, int(rng.integers(2, 6)))
    points = np.round(points * 1024) / 1024
    mesh = meshio.Mesh(points, [("triangle" if flat else "tetra", cells)])
    mesh.point_data["temperature"] = np.arange(len(points)) / 7
    source = folder / "in.vtu"
    mesh.write(source)
    whole, out = folder / "whole", folder / "full"
    whole.mkdir()
    out.mkdir()
    target = out / f"better{suffix}"
    if rng.random() < 0.5:
        target.write_bytes(OLD)
    share = rng.choice([0.0, rng.uniform(0, 1), rng.uniform(0.9, 1.0), 1.5])
    words = [sys.executable, "-c", CHILD, source, whole / target.name, target, str(share)]
    try:
        done = subprocess.run(words, capture_output=True, text=True, check=False,
                              timeout=0.8 * SECONDS, env=full_disk())
    except subprocess.TimeoutExpired:
        raise Broken([f"no end (.{name}, {share:.3f} of its size)"]) from None
    if done.returncode == 100:
        raise ODTError(done.stderr)
    errors = "\n".join(line for line in done.stderr.splitlines() if "warning:" not in line)
    faults = left_behind(out, target, done.returncode, errors)
    if done.returncode == 0 and share < 0.9:
        faults.append("it ended well where there was not enough room")
    if faults:
        raise Broken([f"{fault} (.{name}, {share:.3f} of its size)" for fault in faults])
