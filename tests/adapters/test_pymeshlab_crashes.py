"""Where others raise, pymeshlab ends the process, or never ends: this file is a program, too.

New memory is filled with a pattern (glibc's MALLOC_PERTURB_): custom attributes that came into a
set with `add_mesh()` hold uninitialised memory, and MeshLab's function filters read it.
"""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest

MOVING = ("apply_coord_odt_smoothing", "apply_coord_cpt_smoothing",
          "apply_coord_odt_global_smoothing")
IN_PLACE = (*MOVING, "meshing_odt_optimization", "compute_scalar_by_radius_ratio_per_face")


def with_attributes(mesh):
    n, m = mesh.vertex_number(), mesh.face_number()
    mesh.add_vertex_custom_scalar_attribute(np.arange(n) / 7, "vs")
    mesh.add_vertex_custom_point_attribute(np.arange(3 * n).reshape(n, 3) / 11, "vp")
    if m:
        mesh.add_face_custom_scalar_attribute(np.arange(m) / 13, "fs")
        mesh.add_face_custom_point_attribute(np.arange(3 * m).reshape(m, 3) / 17, "fp")
    return mesh


def plate():
    import contract
    import pymeshlab

    points, faces, _ = contract.grid(2, 6)
    return with_attributes(pymeshlab.Mesh(np.column_stack([points, 0 * points[:, 0]]), faces))


def shapes():
    """Sets of meshes, most of them with attributes, whatever the filters make of them."""
    import pymeshlab

    polygons = pymeshlab.MeshSet()
    polygons.create_grid(numvertx=5, numverty=4)
    emptied = pymeshlab.MeshSet()
    emptied.add_mesh(plate())
    emptied.set_selection_all()
    emptied.meshing_remove_selected_vertices_and_faces()
    yield "nothing", pymeshlab.MeshSet()
    yield "emptied", emptied
    for name, mesh in (
        ("points", pymeshlab.Mesh(np.eye(3))),
        ("triangle", pymeshlab.Mesh(np.eye(3), np.array([[0, 1, 2]]))),
        ("flat", pymeshlab.Mesh(np.eye(3), np.array([[0, 1, 1]]))),
        ("lines", pymeshlab.Mesh(np.eye(3), edge_matrix=np.array([[0, 1]], dtype=np.int32))),
        ("polygons", polygons.current_mesh()),
    ):
        meshes = pymeshlab.MeshSet()
        meshes.add_mesh(with_attributes(mesh))
        yield name, meshes
    cut = pymeshlab.MeshSet()
    cut.add_mesh(plate())
    cut.set_selection_all(allfaces=False)
    cut.apply_selection_erosion()
    cut.meshing_remove_selected_vertices_and_faces()
    yield "cut", cut


def survive_shapes():
    import pymeshlab

    names = [*IN_PLACE, "generate_odt_tetrahedralization"]
    for name in names:
        for shape, meshes in shapes():
            hollow = shape in ("nothing", "emptied", "points", "lines")
            if name == names[-1] and not hollow:
                continue
            sys.stdout.write(f"{name}: {shape}\n")
            for _ in range(2):
                try:
                    meshes.apply_filter(name)
                    refused = False
                except pymeshlab.PyMeshLabException:
                    refused = True
                assert refused == (hollow or (shape == "flat" and name != IN_PLACE[-1]))


def read(mesh):
    return [np.array(getattr(mesh, f"{kind}_custom_{what}")(kind[0] + what[0]))
            for kind in ("vertex", "face")
            for what in ("scalar_attribute_array", "point_attribute_matrix")]


def survive_function_filters():
    """Results bear MeshLab's function filters, and these read the right values."""
    import pymeshlab

    import odt_plugins

    for name in ("optimize", "mesh", "smooth", "meshing_odt_optimization",
                 "compute_scalar_by_radius_ratio_per_face"):
        sys.stdout.write(f"function filters after {name}\n")
        meshes = pymeshlab.MeshSet()
        meshes.add_mesh(plate())
        meshes.add_mesh(plate())
        if name == "optimize":
            meshes = odt_plugins.optimize(meshes)
        elif name == "smooth":
            meshes = odt_plugins.optimize(meshes, smoothing={"connectivity": "none"}, finish=False)
        elif name == "mesh":
            mesh = odt_plugins.optimize(plate())
            meshes.clear()
            meshes.add_mesh(mesh)
            # Attributes of a copy made by pymeshlab are unsound again, those of ours are not.
            meshes = odt_plugins.optimize(meshes)
        else:
            meshes.apply_filter(name)
        mesh = meshes.current_mesh()
        before = read(mesh)
        meshes.compute_scalar_by_function_per_vertex(q="vs")
        assert np.array_equal(mesh.vertex_scalar_array(), before[0])
        meshes.compute_scalar_by_function_per_face(q="fs")
        assert np.array_equal(mesh.face_scalar_array(), before[2])
        assert all(np.array_equal(a, b) for a, b in zip(before, read(mesh), strict=True))
        assert len(np.unique(before[2])) > 50


def survive_polygons():
    """A cube keeps parts of its squares' diagonals where it is subdivided."""
    import pymeshlab

    import odt_plugins

    meshes = pymeshlab.MeshSet()
    meshes.create_cube()
    meshes.meshing_surface_subdivision_midpoint(threshold=pymeshlab.PercentageValue(0))
    meshes.meshing_odt_optimization()
    with pytest.warns(odt_plugins.DataNotKeptWarning, match="polygons, which are now"):
        finer = odt_plugins.remesh(meshes, scale=0.5)
    with pytest.warns(odt_plugins.DataNotKeptWarning, match="polygons, which are now"):
        meshes.meshing_odt_remeshing(targetlen=pymeshlab.PercentageValue(10))
    for mesh in (finer.current_mesh(), meshes.current_mesh()):
        assert len(mesh.polygonal_face_list()) == mesh.face_number()


@pytest.mark.parametrize("part", ["survive_shapes", "survive_function_filters",
                                  "survive_polygons"])
def test_nothing_ends_the_process(part):
    if not find_spec("pymeshlab"):
        pytest.skip("pymeshlab is missing")
    done = subprocess.run([sys.executable, "-X", "faulthandler", __file__, part], check=False,
                          capture_output=True, text=True, timeout=120,
                          env={**os.environ, "MALLOC_PERTURB_": "165",
                               "PYTHONPATH": os.pathsep.join(filter(None, sys.path))})
    assert done.returncode == 0, (done.stdout[-200:], done.stderr[-800:])


if __name__ == "__main__":
    import odt_plugins

    odt_plugins.register("pymeshlab")
    globals()[sys.argv[1]]()
