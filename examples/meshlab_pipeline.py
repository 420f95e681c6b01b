"""From a scan to an improved tetrahedral mesh inside pymeshlab: close holes, decimate, fill."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pymeshlab

import odt_plugins

SCAN = Path(pymeshlab.__file__).parent / "tests" / "sample_meshes" / "bunny10k_textured.obj"


def main() -> dict[str, Any]:
    """Return the result of the last filter: its figures, `tet_vertex_matrix`, `tet_matrix`."""
    odt_plugins.register("pymeshlab")
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(SCAN))
    meshes.meshing_close_holes(maxholesize=100)
    meshes.meshing_decimation_quadric_edge_collapse(targetfacenum=2000)
    return meshes.generate_odt_tetrahedralization(
        targetlen=pymeshlab.PercentageValue(8), maxsurfdist=pymeshlab.PercentageValue(1.5))


if __name__ == "__main__":
    result = main()
    print(f"{len(result['tet_matrix'])} tetrahedra, mean radius ratio "
          f"{result['mean_radius_ratio_before']:.3f} -> {result['mean_radius_ratio']:.3f}")
