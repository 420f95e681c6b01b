"""Improve a mesh that TetWild made: what pytetwild returns goes in, the same comes out.

pytetwild leaves `__tracked_surface.stl` in the working directory, so it runs in one of its own;
`odt_plugins.tetrahedralize` does that by itself.
"""

from __future__ import annotations

import contextlib
import tempfile

import numpy as np
import pytetwild
import pyvista

import odt_plugins


def main() -> odt_plugins.Report:
    """Return the report of the improvement."""
    torus = pyvista.ParametricTorus(ringradius=1.0, crosssectionradius=0.4, u_res=30, v_res=16,
                                    w_res=16).triangulate().clean()
    vertices = np.array(torus.points, dtype=np.float64)
    faces = np.array(torus.regular_faces, dtype=np.int32)
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        mesh = pytetwild.tetrahedralize(vertices, faces, edge_length_fac=0.1, stop_energy=20.0)
    (points, cells), report = odt_plugins.optimize_with_report(mesh)
    assert points.shape == mesh[0].shape
    assert cells.dtype == mesh[1].dtype
    return report


if __name__ == "__main__":
    print(main())
