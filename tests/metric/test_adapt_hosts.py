"""The mesh of every host is adapted to a field by the name of its point array, and comes back."""

from __future__ import annotations

import meshio
import numpy as np
import open3d
import pymeshlab
import pytest
import pyvista
import skfem
import trimesh
from surface_meshes import bowl

import odt_plugins
from odt_plugins.adapters.registry import find_adapter
from odt_plugins.errors import InvalidOptionError
from odt_plugins.hosts.pyvista_accessor import OdtAccessor

for host in ("open3d", "pymeshlab"):
    odt_plugins.register(host)

POINTS, CELLS = bowl(10, 0.1)
FLAT = POINTS * [1.0, 1.0, 0.0]


def front(x):
    return np.tanh(10.0 * (x[:, 0] - 0.1))


def polydata():
    mesh = pyvista.PolyData.from_regular_faces(POINTS, CELLS)
    mesh.point_data["u"] = front(POINTS)
    return mesh


def tensors():
    mesh = open3d.t.geometry.TriangleMesh(
        open3d.core.Tensor(POINTS), open3d.core.Tensor(CELLS.astype(np.int32)))
    mesh.vertex["u"] = open3d.core.Tensor(front(POINTS))
    return mesh


def layer(name=None):
    mesh = pymeshlab.Mesh(POINTS, CELLS, v_scalar_array=front(POINTS))
    if name:
        mesh.add_vertex_custom_scalar_attribute(front(POINTS), name)
    return mesh


def stored(place):
    file = place / "in.vtu"
    meshio.Mesh(FLAT, [("triangle", CELLS)], {"u": front(FLAT)}).write(file)
    return file


HOSTS = {
    "arrays": lambda _: ((FLAT[:, :2], CELLS), front(FLAT)),
    "arrays in space": lambda _: ((POINTS, CELLS), front),
    "file": lambda place: (stored(place), "u"),
    "meshio": lambda place: (meshio.read(stored(place)), "u"),
    "open3d": lambda _: (tensors(), "u"),
    "pymeshlab": lambda _: (layer(), "vertex scalar"),
    "pyvista": lambda _: (polydata(), "u"),
    "scikit-fem": lambda _: (
        skfem.MeshTri(FLAT[:, :2].T.copy(), CELLS.T.astype(np.int64)), front(FLAT)),
    "trimesh": lambda _: (trimesh.Trimesh(
        POINTS, CELLS, process=False, vertex_attributes={"u": front(POINTS)}), "u"),
}


def stretched(mesh):
    """Whether triangles at the front are narrow across it."""
    read = find_adapter(mesh).read(mesh)
    x = np.asarray(read.points)[np.asarray(read.cells)]
    near = np.abs(x[:, :, 0].mean(axis=1) - 0.1) < 0.1
    wide = np.ptp(x[near], axis=1)
    return np.median(wide[:, 0] / wide[:, 1]) < 0.6


@pytest.mark.parametrize("name", HOSTS)
def test_a_metric_of_a_named_field_is_taken_by_the_same_host(name, tmp_path):
    mesh, field = HOSTS[name](tmp_path)
    metric = odt_plugins.metric_from_field(mesh, field, cells=300)
    out = odt_plugins.remesh(mesh, metric=metric, envelope=1e-2)
    assert name == "file" or type(out) is type(mesh)
    assert stretched(out)


def test_hosts_adapt_in_their_own_words():
    assert stretched(OdtAccessor(polydata()).remesh(adapt="u", cells=300, envelope=1e-2))
    assert stretched(tensors().remesh_odt(adapt=["u"], cells=300, envelope=1e-2))
    with pytest.raises(InvalidOptionError, match="got adapt= without a number of cells"):
        OdtAccessor(polydata()).remesh(adapt="u")
    for name in ("vertex scalar", "heat"):
        meshes = pymeshlab.MeshSet()
        meshes.add_mesh(layer("heat"))
        found = meshes.meshing_odt_remeshing(
            targetfacenum=300, adaptto=name, maxsurfdist=pymeshlab.PercentageValue(1))
        assert abs(found["faces"] - 300) < 60
        assert stretched(meshes.current_mesh())
    for given, words in (({"adaptto": "heat"}, "expected targetfacenum above 0"),
                         ({"adaptto": "cold", "targetfacenum": 9},
                          "a vertex array of floating-point numbers of this mesh, it has .*heat")):
        with pytest.raises(InvalidOptionError, match=words):
            meshes.meshing_odt_remeshing(**given)


def test_meshlab_counts_faces():
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(layer())
    found = meshes.meshing_odt_remeshing(
        targetfacenum=100, maxsurfdist=pymeshlab.PercentageValue(5))
    assert abs(found["faces"] - 100) < 10


@pytest.mark.parametrize("adapt", [np.ones(4), 3, [1.0], abs])
def test_values_in_place_of_names_are_refused_with_what_takes_them(adapt):
    mesh = np.eye(4)[:, :3], np.array([[3, 0, 1, 2]])
    with pytest.raises(InvalidOptionError, match=r"of type \w+; expected names .* try metric="):
        odt_plugins.remesh(mesh, adapt=adapt, cells=10)


@pytest.mark.parametrize("adapt", ["", ["u", ""], ("",)])
def test_an_empty_name_of_a_field_is_refused(adapt):
    mesh = np.eye(4)[:, :3], np.array([[3, 0, 1, 2]])
    with pytest.raises(InvalidOptionError, match=r"got adapt=.*; expected names of point arrays"):
        odt_plugins.remesh(mesh, adapt=adapt, cells=10)
