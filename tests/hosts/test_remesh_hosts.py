"""Other sizes on every host: what lies on a mesh comes back on vertices that come and go."""

from __future__ import annotations

from itertools import combinations

import boxes
import gmsh
import meshio
import ngsolve
import numpy as np
import open3d
import pymeshlab
import pytest
import pyvista
import skfem
import trimesh
from contract import GmshModel
from surface_meshes import bowl, sphere

import odt_plugins
from odt_plugins.errors import InvalidOptionError, ODTWarning

for host in ("gmsh", "open3d", "pymeshlab", "pyvista"):
    odt_plugins.register(host)

SIZE, WITHIN = 0.25, {"envelope": 1e-2}


def share_in(points, cells, size=SIZE):
    pairs = np.concatenate([cells[:, pair] for pair in combinations(range(cells.shape[1]), 2)])
    ends = points[np.unique(np.sort(pairs, axis=1), axis=0)]
    length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    return ((length > 0.7 * size) & (length < 1.42 * size)).mean()


@pytest.fixture(scope="module")
def ball():
    """A sphere, its upper and its lower half, and sizes at its vertices."""
    points, cells = sphere(3, 0.1)
    return points, cells, (points[cells].mean(axis=1)[:, 2] > 0).astype(int)


def halves_are_where_they_were(points, cells, part):
    middle = points[cells].mean(axis=1)[:, 2]
    return np.array_equal(part[abs(middle) > 0.1] == 1, middle[abs(middle) > 0.1] > 0)


def test_trimesh_with_attributes_and_colours(ball):
    points, cells, part = ball
    mesh = trimesh.Trimesh(
        points, cells, process=False, face_attributes={"part": part},
        vertex_attributes={"h": np.full(len(points), SIZE), "id": np.arange(len(points))})
    mesh.visual.vertex_colors = np.full((len(points), 4), [9, 8, 7, 255], dtype=np.uint8)
    out = odt_plugins.remesh(mesh, "h", **WITHIN)
    assert type(out) is trimesh.Trimesh
    assert share_in(out.vertices, out.faces) > 0.75
    assert halves_are_where_they_were(out.vertices, out.faces, out.face_attributes["part"])
    assert out.vertex_attributes["h"] == pytest.approx(np.full(len(out.vertices), SIZE))
    assert len(out.vertex_attributes["id"]) == len(out.visual.vertex_colors) == len(out.vertices)
    assert (out.visual.vertex_colors == [9, 8, 7, 255]).all()


def test_open3d_as_methods_of_its_meshes(ball):
    points, cells, part = ball
    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(points), open3d.utility.Vector3iVector(cells))
    mesh.vertex_colors = open3d.utility.Vector3dVector(0.5 + 0.5 * points)
    out = mesh.remesh_odt(SIZE, **WITHIN)
    x = np.asarray(out.vertices)
    assert share_in(x, np.asarray(out.triangles)) > 0.97
    assert np.asarray(out.vertex_colors) == pytest.approx(0.5 + 0.5 * x, abs=0.03)
    tensor = open3d.t.geometry.TriangleMesh.from_legacy(mesh)
    tensor.vertex["h"] = open3d.core.Tensor(np.full((len(points), 1), SIZE))
    tensor.vertex["v"] = open3d.core.Tensor(points)
    tensor.vertex["id"] = open3d.core.Tensor(np.arange(len(points)))
    tensor.triangle["part"] = open3d.core.Tensor(part)
    out = tensor.remesh_odt("h", **WITHIN)
    with pytest.raises(InvalidOptionError, match=r"got size='k'; .* it has h \(point\)$"):
        tensor.remesh_odt("k", **WITHIN)
    x, rows = out.vertex["positions"].numpy(), out.triangle["indices"].numpy()
    assert halves_are_where_they_were(x, rows, out.triangle["part"].numpy())
    assert len(out.vertex["id"]) == len(x) < len(points)
    solid = open3d.geometry.TetraMesh(*map(
        lambda kind, rows: kind(rows), (open3d.utility.Vector3dVector,
                                        open3d.utility.Vector4iVector), boxes.box(3, 3)))
    finer = solid.remesh_odt(scale=0.8, **WITHIN)
    assert type(finer) is type(solid)
    assert len(finer.tetras) > len(solid.tetras)


def test_meshlab_in_its_own_words(ball):
    points, cells, part = ball
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(points, cells, v_scalar_array=points[:, 0],
                                   f_scalar_array=part.astype(float)), "ball")
    lengths = {"targetlen": pymeshlab.PureValue(SIZE),
               "maxsurfdist": pymeshlab.PercentageValue(1)}
    found = meshes.meshing_odt_remeshing(**lengths)
    out = meshes.current_mesh()
    x, rows = out.vertex_matrix(), out.face_matrix()
    assert found["faces"] == len(rows)
    assert share_in(x, rows) > 0.97
    assert out.vertex_scalar_array() == pytest.approx(x[:, 0], abs=1e-12)
    assert halves_are_where_they_were(x, rows, out.face_scalar_array())
    del out
    meshes.compute_selection_by_condition_per_face(condselect="(z0+z1+z2) > 0")
    chosen = meshes.current_mesh().face_selection_array()
    meshes.apply_filter("meshing_odt_remeshing", selectedonly=True,
                        **lengths | {"targetlen": pymeshlab.PureValue(0.6 * SIZE)})
    new = meshes.current_mesh()
    left = {tuple(sorted(map(tuple, row))) for row in x[rows[~chosen]]}
    there = {tuple(sorted(map(tuple, row))) for row in new.vertex_matrix()[new.face_matrix()]}
    assert left <= there
    assert len(there) > len(rows)
    del new
    meshes.meshing_odt_remeshing(adaptive=True, maxsurfdist=pymeshlab.PercentageValue(2))
    assert meshes.current_mesh().face_number() < len(rows)


def test_pyvista_with_arrays_named_texture_and_blocks(ball):
    points, cells, part = ball
    mesh = pyvista.PolyData.from_regular_faces(points, cells)
    mesh.cell_data["part"], mesh.cell_data["h"] = part, np.full(len(cells), SIZE)
    pair = pyvista.MultiBlock([mesh, mesh.translate((5, 0, 0))])
    for out in pair.odt.remesh("h", **WITHIN):
        x, rows = out.points, out.regular_faces
        assert share_in(x, rows) > 0.75
        assert halves_are_where_they_were(x, rows, out.cell_data["part"])
    with pytest.raises(InvalidOptionError, match=r"size='k'.*it has h \(cell\)"):
        mesh.odt.remesh("k")
    touching = pyvista.MultiBlock([mesh, mesh.copy()])
    with pytest.raises(InvalidOptionError, match="would come apart"):
        touching.odt.remesh(SIZE, boundary="slide")


def test_parts_that_touch_still_meet_and_others_slide():
    """Two halves of a ball meet along a circle, on which no edge is split, and one lies apart."""
    ball = trimesh.creation.icosphere(2)
    up = ball.triangles_center[:, 2] > 0.1
    halves = [ball.submesh([np.flatnonzero(side)], append=True) for side in (up, ~up)]
    given = [*halves, halves[0].copy().apply_translation([5, 0, 0])]
    out, report = odt_plugins.remesh_with_report(trimesh.Scene(given), scale=0.5, envelope=0.01)
    new = list(out.geometry.values())
    assert all(len(b.faces) > 1.5 * len(a.faces) for a, b in zip(given, new, strict=True))
    joined = trimesh.Trimesh(
        np.concatenate([part.triangles.reshape(-1, 3) for part in new[:2]]),
        np.arange(3 * sum(len(part.faces) for part in new[:2])).reshape(-1, 3))
    assert joined.is_watertight
    told = ["boundary stays, since this geometry touches" in str(part) for part in report.parts]
    assert told == [True, True, False]
    edges = [np.unique(part.edges_sorted, axis=0, return_counts=True)[1]
             for part in (given[2], new[2], new[0])]
    rims = [(times == 1).sum() for times in edges]
    assert rims[1] > rims[0] == rims[2]


def test_the_texture_of_triangles_that_came_is_that_under_them():
    points, cells = bowl(15, 0.2)
    mesh = pyvista.PolyData.from_regular_faces(points, cells)
    mesh.point_data["uv"] = points[:, :2].copy()
    mesh.point_data.active_texture_coordinates_name = "uv"
    out = odt_plugins.remesh(mesh, SIZE, **WITHIN)
    assert out["uv"] == pytest.approx(out.points[:, :2], abs=1e-12)
    for flat in (False, True):
        x = points * [1, 1, not flat]
        wedges = open3d.geometry.TriangleMesh(
            open3d.utility.Vector3dVector(x), open3d.utility.Vector3iVector(cells))
        wedges.triangle_uvs = open3d.utility.Vector2dVector(x[cells].reshape(-1, 3)[:, :2])
        out = odt_plugins.remesh(wedges, SIZE, **WITHIN)
        corners = np.asarray(out.vertices)[np.asarray(out.triangles)].reshape(-1, 3)
        assert np.asarray(out.triangle_uvs) == pytest.approx(corners[:, :2], abs=1e-12)


def test_vertices_that_a_soup_has_several_times_are_gone(tmp_path):
    points, cells = bowl(15, 0.2)
    soup = meshio.Mesh(points[cells].reshape(-1, 3), [
        ("triangle", np.arange(cells.size).reshape(-1, 3))])
    out, report = odt_plugins.remesh_with_report(soup, SIZE, **WITHIN)
    assert len(np.unique(out.points, axis=0)) == len(out.points) < len(points)
    assert any("in the result they are gone" in note for note in report.notes)


def test_scikit_fem_with_subdomains_and_boundaries():
    mesh = skfem.MeshTet.init_tensor(*[np.linspace(0, 1, 4)] * 3).with_subdomains(
        {"left": lambda x: x[0] < 0.5}).with_boundaries({"top": lambda x: x[2] > 0.99})
    out = odt_plugins.remesh(mesh, scale=0.8, free="periodic", **WITHIN)
    assert type(out) is skfem.MeshTet
    one = skfem.Functional(lambda w: 1.0 + 0 * w.x[0])
    was, left = (one.assemble(skfem.Basis(m, skfem.ElementTetP1(), elements="left"))
                 for m in (mesh, out))
    assert left == pytest.approx(was, rel=3e-3)
    top = skfem.FacetBasis(out, skfem.ElementTetP1(), facets="top")
    assert one.assemble(top) == pytest.approx(1, abs=0.02)
    assert out.nelements > mesh.nelements


def test_netgen_with_materials_and_boundaries():
    from netgen.occ import Box, Glue, OCCGeometry, Z

    iron = Box((0, 0, 0), (1, 1, 1))
    iron.mat("iron")
    iron.faces.Max(Z).name = "top"
    air = Box((1, 0, 0), (2, 1, 1))
    air.mat("air")
    mesh = ngsolve.Mesh(OCCGeometry(Glue([iron, air])).GenerateMesh(
        maxh=0.4, optsteps3d=0))
    out = odt_plugins.remesh(mesh, scale=0.75, free="periodic", **WITHIN)
    one = ngsolve.CF(1)
    assert out.GetMaterials() == mesh.GetMaterials()
    assert [*ngsolve.Integrate(one, out, region_wise=True)] == pytest.approx([1, 1], abs=5e-3)
    top = ngsolve.Integrate(one, out, definedon=out.Boundaries("top"))
    assert top == pytest.approx(1, abs=0.02)
    assert out.ne > mesh.ne


def test_the_current_model_of_gmsh_with_its_groups():
    model = GmshModel().current()
    model.occ.addBox(0, 0, 0, 1, 1, 1)
    model.occ.synchronize()
    model.addPhysicalGroup(2, [1], 5, name="low")
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.4)
    model.mesh.generate(3)
    try:
        before = len(model.mesh.getElementsByType(4)[0])
        report = model.mesh.odt_remesh(0.18, free="periodic", **WITHIN)
        tags, nodes = model.mesh.getElementsByType(4)
        tags, places, _ = model.mesh.getNodes()
        x = places.reshape(-1, 3)[np.argsort(tags)]
        rows = np.searchsorted(np.sort(tags), nodes.reshape(-1, 4))
        assert len(rows) > before
        assert share_in(x, rows, 0.18) > 0.9
        assert report.after.inverted == 0
        low = model.mesh.getNodesForPhysicalGroup(2, 5)[1].reshape(-1, 3)
        assert abs(low[:, 0]).max() < 0.02
    finally:
        gmsh.option.restoreDefaults()
        gmsh.option.setNumber("General.Terminal", 0)
        model.remove()


def test_a_mesh_in_use_stays_and_a_warning_says_so(ball):
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(*ball[:2]))
    held = meshes.current_mesh()
    with pytest.warns(ODTWarning, match="in use as a Mesh object"):
        meshes.meshing_odt_remeshing(targetlen=pymeshlab.PureValue(SIZE),
                                     maxsurfdist=pymeshlab.PercentageValue(1))
    assert held.face_number() == len(ball[1])
