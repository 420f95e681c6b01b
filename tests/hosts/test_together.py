"""All toolkits in one process, as people use them: the same mesh through many hands."""

from __future__ import annotations

import contract
import numpy as np
import pytest

import odt_plugins

SAME = ["pyvista-tet", "vtk-tet", "meshio-tet", "skfem-tet", "netgen-tet", "ngsolve-tet"]
"""Hosts of the same tetrahedra in the same order with the same two labels."""


def test_every_host_gives_the_bits_that_arrays_give():
    points, cells, labels = contract.grid(3, 4)
    order = np.argsort(labels != 7, kind="stable")
    parts = (points, cells[order], labels[order])
    want = odt_plugins.optimize(parts, fields="keep")
    for name in SAME:
        contract.need(name)
        host = contract.HOSTS[name]
        found = host.view(host.optimize(host.make(parts), fields="keep"))
        assert found.points.tobytes() == want[0].tobytes(), name
        assert np.array_equal(found.cells, want[1]), name


def test_a_part_of_gmsh_goes_through_all_tools():
    """CAD in Gmsh, improved there; a problem of scikit-fem; its skin in trimesh; NGSolve; VTK."""
    gmsh = pytest.importorskip("gmsh")
    skfem = pytest.importorskip("skfem")
    trimesh = pytest.importorskip("trimesh")
    ngsolve = pytest.importorskip("ngsolve")
    pyvista = pytest.importorskip("pyvista")
    from netgen.meshing import FaceDescriptor, Mesh

    model = contract.GmshModel().current()
    model.occ.addTorus(0, 0, 0, 1, 0.4)
    model.occ.synchronize()
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.3)
    model.mesh.generate(3)
    odt_plugins.register("gmsh")
    told = gmsh.model.mesh.odt(boundary="slide").after
    tags, flat, _ = model.mesh.getNodes()
    nodes = model.mesh.getElementsByType(4)[1]
    used, cells = np.unique(nodes, return_inverse=True)
    points = flat.reshape(-1, 3)[np.argsort(tags)][np.searchsorted(np.sort(tags), used)]
    cells = cells.reshape(-1, 4)

    tets = skfem.MeshTet(points.T.copy(), cells.T.copy())
    assert odt_plugins.quality(tets).min_quality == pytest.approx(told.min_quality)
    better = odt_plugins.optimize(tets)
    first = odt_plugins.quality(better)
    assert first.mean_quality >= told.mean_quality

    skin = better.facets[:, better.boundary_facets()].T
    shell = trimesh.Trimesh(better.p.T, skin, process=True)
    shell.fix_normals()
    assert shell.is_watertight
    smooth = odt_plugins.optimize(shell, envelope=0.01)
    assert smooth.volume == pytest.approx(shell.volume, rel=0.05)

    inner = Mesh(3)
    inner.AddPoints(np.ascontiguousarray(better.p.T))
    inner.Add(FaceDescriptor(surfnr=1, domin=1, domout=0, bc=1))
    inner.AddElements(dim=2, index=1, data=skin.astype(np.int32), base=0)
    inner.AddElements(dim=3, index=1, data=better.t.T.astype(np.int32)[:, [1, 0, 2, 3]], base=0)
    last = odt_plugins.optimize(ngsolve.Mesh(inner))
    volume = ngsolve.Integrate(ngsolve.CF(1), last)
    assert volume == pytest.approx(shell.volume, rel=1e-9)

    grid = pyvista.UnstructuredGrid({10: np.array(
        last.ngmesh.Elements3D().NumPy()["nodes"], dtype=np.int64) - 1},
        np.array(last.ngmesh.Coordinates()))
    assert odt_plugins.quality(grid) == odt_plugins.quality(last)
    assert abs(grid.volume) == pytest.approx(volume, rel=1e-9)
