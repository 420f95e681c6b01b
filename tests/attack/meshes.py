"""Random small meshes over all options: every result is valid and keeps the promise."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np

import odt_plugins
from attack.callers import random_caller
from attack.judge import Broken, Mesh, broken
from attack.options import random_options
from attack.shapes import random_mesh
from odt_plugins.mesh.plane import plane_frame
from odt_plugins.options import Options

SECONDS = 60.0
"""No case may take longer."""

Rng = np.random.Generator


def attack(rng: Rng, folder: Path) -> None:
    """Optimise one random mesh and judge the result.

    Raises
    ------
    Broken    what of the promise does not hold
    """
    mesh = random_mesh(rng)
    caller = random_caller(mesh, rng)
    options = random_options(rng, mesh, caller.labels)
    before, original = caller.view(caller.mesh), _bytes(caller.mesh)
    result, report = odt_plugins.optimize_with_report(caller.mesh, **options)
    after = caller.view(result)
    bent = curved(before)
    faults = broken(before, after, Options(**options), curved=bent)
    changing = (("uv",) * bent + ("vertices",) * bool(options.get("insert"))
                + ("fields",) * (options.get("fields") == "conserve"))
    faults += caller.data_faults(caller.mesh, result, changing)
    if original != _bytes(caller.mesh):
        faults.append("the caller's mesh was changed")
    if rng.random() < 0.1:
        again = options | {"threads": 1 + options.get("threads", 1) % 3}
        if not same(after, caller.view(odt_plugins.optimize(caller.mesh, **again))):
            faults.append(f"the result is another one for {again['threads']} threads")
    str(report), report.to_json()
    if faults:
        raise Broken(faults)


def curved(mesh: Mesh) -> bool:
    """Whether these are triangles in space that lie in no plane."""
    points = np.asarray(mesh.points, dtype=np.float64)
    cells = mesh.cells.astype(np.int64)
    return points.shape[1] == cells.shape[1] and plane_frame(points, cells) is None


def _bytes(caller: Any) -> Any:
    """What must not change of arrays."""
    if not isinstance(caller, tuple | list):
        return None
    return [(part.dtype, part.shape, part.tobytes()) for part in caller]


def same(a: Mesh, b: Mesh) -> bool:
    """Whether two meshes have the same bits."""
    return all((x is None and y is None) or np.array_equal(x, y, equal_nan=True)
               for x, y in itertools.zip_longest(a, b))
