"""TetWild in a process and a directory of its own: it writes files and cannot be interrupted."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import InvalidMeshError, MissingDependencyError

PROGRAM = """
import sys
import numpy as np
import pytetwild
surface = np.load("surface.npz")
points, cells = pytetwild.tetrahedralize(
    surface["points"], surface["faces"], edge_length_fac=float(sys.argv[1]),
    epsilon=float(sys.argv[2]), vtk_ordering=True)
np.savez("tets.npz", points=points, cells=cells)
"""


def fill(
    points: NDArray[np.float64], faces: NDArray[np.int32], edge_length: float, epsilon: float
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Fill a triangle surface with tetrahedra of positive volume.

    Parameters
    ----------
    points, faces : (n, 3), (m, 3)    surface
    edge_length, epsilon : float      relative to the bounding-box diagonal

    Raises
    ------
    MissingDependencyError            pytetwild is not installed
    InvalidMeshError                  TetWild ended without tetrahedra
    """
    if find_spec("pytetwild") is None:
        msg = ('tetrahedra need pytetwild, not installed here; try '
               'pip install "odt-plugins[pytetwild]"')
        raise MissingDependencyError(msg)
    with tempfile.TemporaryDirectory(prefix="odt-plugins-") as folder:
        np.savez(Path(folder) / "surface.npz", points=points, faces=faces)
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM, repr(edge_length), repr(epsilon)],
            cwd=folder, capture_output=True, text=True, check=False,
        )
        result = Path(folder) / "tets.npz"
        if not done.returncode and result.is_file():
            with np.load(result) as data:
                if len(data["cells"]):
                    return data["points"], data["cells"]
    last = (done.stderr.strip().splitlines() or [f"it ended with {done.returncode}"])[-1]
    msg = (
        f"TetWild found no tetrahedra inside the surface of {len(faces)} triangles: {last}; "
        f"expected a closed surface, try closing its holes or another edge length"
    )
    raise InvalidMeshError(msg)
