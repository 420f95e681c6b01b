"""MeshLab's isotropic remeshing of the bunny's surface, and ODT behind it: figures of each mesh."""

from __future__ import annotations

import time

import pymeshlab

import odt_plugins
from odt_plugins.compare.start import stored


def main(length: float = 1.0) -> list[odt_plugins.QualitySummary]:
    """Print the table; return the figures of the scan, of MeshLab's mesh, and of the last one.

    MeshLab aims at edges of a `length` in percent of the diagonal, 1 unless given.
    """
    odt_plugins.register("pymeshlab")
    scan = stored("bunny-surface")
    edges = pymeshlab.PercentageValue(length)
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(scan.points, scan.cells))
    print("| mesh | triangles | min q | 1 % | mean q | seconds of the processor |")
    print("|---|---|---|---|---|---|")
    found = []
    steps = {"scan": ("", {}),
             "MeshLab's remeshing": ("meshing_isotropic_explicit_remeshing", {"targetlen": edges}),
             "ODT behind it": ("meshing_odt_optimization", {})}
    for name, (filter_name, values) in steps.items():
        clock = time.process_time()
        if filter_name:
            getattr(meshes, filter_name)(**values)
        seconds = time.process_time() - clock
        q = odt_plugins.quality(meshes)
        found.append(q)
        print(f"| {name} | {q.n_cells} | {q.min_quality:.3f} | {q.p1_quality:.3f} | "
              f"{q.mean_quality:.3f} | {seconds:.1f} |")
    return found


if __name__ == "__main__":
    main()
