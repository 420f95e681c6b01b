"""pymeshlab: what survives, named one by one; the selection; the filters' own numbers."""

from __future__ import annotations

import functools
import gc
import os
import re
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor

import contract
import numpy as np
import pytest

import odt_plugins
from odt_plugins.adapters.pymeshlab_copy import CUSTOM, custom_attributes, muted, private_copy
from odt_plugins.adapters.pymeshlab_mesh import move_vertices
from odt_plugins.adapters.pymeshlab_set import saved_script
from odt_plugins.errors import (
    DataNotKeptWarning,
    InvalidOptionError,
    MissingDependencyError,
    ODTWarning,
    UnsupportedMeshError,
)
from odt_plugins.options import FIGURES

pymeshlab = pytest.importorskip("pymeshlab")
odt_plugins.register("pymeshlab")

MOVING = ("apply_coord_odt_smoothing", "apply_coord_cpt_smoothing",
          "apply_coord_odt_global_smoothing")
IN_PLACE = (*MOVING, "meshing_odt_optimization", "compute_scalar_by_radius_ratio_per_face")
THIRD = 1.0 / 3.0
TEXTURE = os.path.join(pymeshlab.__path__[0], "tests", "sample_meshes", "TextureDouble_A.png")


def plate(seed=0):
    """Jittered plate in the plane z = 1/3 with every kind of data a Mesh holds."""
    points, faces, labels = contract.grid(2, 6, seed)
    faces = faces.astype(np.int32)
    n, m = len(points), len(faces)
    uv = np.round(points, 6).astype(np.float32).astype(float)
    byte = np.random.default_rng(2).integers(0, 256, (n + m, 4)) / 255.0
    mesh = pymeshlab.Mesh(
        np.column_stack([points, np.full(n, THIRD)]), faces,
        edge_matrix=np.array([[0, 7], [7, 14]], dtype=np.int32),
        v_scalar_array=np.arange(n) * THIRD, f_scalar_array=np.arange(m) / 7,
        v_color_matrix=byte[:n], f_color_matrix=byte[n:], v_tex_coords_matrix=uv[:, ::-1].copy(),
        w_tex_coords_matrix=uv[faces].reshape(-1, 2))
    contract.add_pymeshlab_attributes(mesh, labels)
    return mesh


def plates(**settings):
    """Three meshes, the middle one a plate: textured, partly selected, transformed, hidden."""
    meshes = pymeshlab.MeshSet(**settings)
    corner = pymeshlab.Mesh(np.eye(3), np.array([[0, 1, 2]]))
    corner.add_vertex_custom_scalar_attribute(np.arange(3.0), "weight")
    corner.set_label("corner")
    bare = pymeshlab.Mesh(np.eye(3))
    bare.set_label("points")
    meshes.add_mesh(corner, "corner")
    with_selection = pymeshlab.MeshSet()
    points = plate().vertex_matrix()
    with_selection.add_mesh(pymeshlab.Mesh(points, plate().face_matrix()))
    # Function filters crash once there are custom attributes: select on a bare mesh of the same
    # faces, and let a PLY file carry the flags over.
    with_selection.compute_selection_by_condition_per_face(condselect="x0 + x1 + x2 < 1.8")
    with_selection.compute_selection_by_condition_per_vertex(condselect="y < 0.4")
    bare_selected = with_selection.current_mesh()
    meshes.add_mesh(_selected(plate(), bare_selected), "plate of steel")
    meshes.set_texture_per_mesh(textname=TEXTURE)
    meshes.set_matrix(transformmatrix=np.diag([2.0, 3.0, 4.0, 1.0]), freeze=False)
    meshes.set_current_mesh_visibility(False)
    meshes.add_mesh(bare, "points")
    meshes.set_current_mesh(1)
    meshes.clear_filter_script()
    return meshes


def _selected(mesh, like):
    """The mesh with the selection of another of the same faces, without the package's writer."""
    faces = mesh.face_matrix()
    n, m = mesh.vertex_number(), mesh.face_number()
    head = ["ply", "format ascii 1.0", f"element vertex {n}"]
    head += [f"property {p}" for p in (
        "double x", "double y", "double z", "int flags", "uchar red", "uchar green",
        "uchar blue", "uchar alpha", "double quality", "float texture_u", "float texture_v")]
    head += [f"element face {m}", "property list uchar int vertex_indices", "property int flags",
             "property list uchar float texcoord", "property uchar red", "property uchar green",
             "property uchar blue", "property uchar alpha", "property double quality",
             f"element edge {mesh.edge_number()}", "property int vertex1", "property int vertex2",
             "end_header"]
    colour = np.rint(255 * mesh.vertex_color_matrix()).astype(int)
    uv, w = mesh.vertex_tex_coord_matrix(), mesh.wedge_tex_coord_matrix().reshape(-1, 6)
    for i in range(n):
        head.append(" ".join(map(str, [
            *mesh.vertex_matrix()[i].tolist(), 32 * int(like.vertex_selection_array()[i]),
            *colour[i], float(mesh.vertex_scalar_array()[i]), *uv[i].tolist()])))
    colour = np.rint(255 * mesh.face_color_matrix()).astype(int)
    for i in range(m):
        head.append(" ".join(map(str, [
            3, *faces[i], 32 * int(like.face_selection_array()[i]), 6, *w[i].tolist(), *colour[i],
            float(mesh.face_scalar_array()[i])])))
    head += [f"{a} {b}" for a, b in mesh.edge_matrix()]
    file = f"{tempfile.gettempdir()}/odt-plugins-test-{os.getpid()}.ply"
    with open(file, "w", encoding="utf-8") as handle:
        handle.write("\n".join([*head, ""]))
    loaded = pymeshlab.MeshSet()
    loaded.load_new_mesh(file)
    os.remove(file)
    out = pymeshlab.MeshSet()
    out.add_mesh(loaded.current_mesh(), mesh.label())
    kept = out.current_mesh()
    kept.set_label(mesh.label())
    kept.add_vertex_custom_scalar_attribute(
        mesh.vertex_custom_scalar_attribute_array("temperature"), "temperature")
    kept.add_vertex_custom_point_attribute(
        mesh.vertex_custom_point_attribute_matrix("velocity"), "velocity")
    for name in ("stress", "marker"):
        kept.add_face_custom_scalar_attribute(mesh.face_custom_scalar_attribute_array(name), name)
    kept.add_face_custom_point_attribute(mesh.face_custom_point_attribute_matrix("axis"), "axis")
    _selected.alive = out
    return kept


PER_VERTEX = {
    "vertex colours": lambda m: m.vertex_color_array(),
    "vertex scalars": lambda m: m.vertex_scalar_array(),
    "vertex texture coordinates": lambda m: m.vertex_tex_coord_matrix(),
    "vertex selection": lambda m: m.vertex_selection_array(),
    "custom scalars per vertex": lambda m: m.vertex_custom_scalar_attribute_array("temperature"),
    "custom points per vertex": lambda m: m.vertex_custom_point_attribute_matrix("velocity"),
}
PER_FACE = {
    "face colours": lambda m: m.face_color_array(),
    "face scalars": lambda m: m.face_scalar_array(),
    "face selection": lambda m: m.face_selection_array(),
    "custom scalars per face": lambda m: m.face_custom_scalar_attribute_array("stress"),
    "labels of regions": lambda m: m.face_custom_scalar_attribute_array("marker"),
    "custom points per face": lambda m: m.face_custom_point_attribute_matrix("axis"),
}
PER_MESH = {
    "label": lambda m: m.label(),
    "transform matrix": lambda m: m.transform_matrix(),
    "edges": lambda m: m.edge_matrix(),
    "texture": lambda m: [(name, image.width()) for name, image in m.textures().items()],
    "components": lambda m: [getattr(m, name)() for name in sorted(dir(m))
                             if name.startswith("has_")],
}
OF_THE_SET = {
    "number of meshes": lambda s: s.mesh_number(),
    "visibility": lambda s: [s.is_mesh_visible(0), s.is_current_mesh_visible(),
                             s.is_mesh_visible(2)],
    "id of the first": lambda s: s.mesh(0).label(),
    "id of the third": lambda s: s.mesh(2).label(),
    "points of the first": lambda s: s.mesh(0).vertex_matrix(),
    "data of the first": lambda s: s.mesh(0).vertex_custom_scalar_attribute_array("weight"),
    "points of the third": lambda s: s.mesh(2).vertex_matrix(),
}


@functools.lru_cache
def done(name):
    """The plates before and after one filter; "optimize" is the function, not a filter."""
    before, after = plates(), plates()
    if name == "optimize":
        given = after
        after = odt_plugins.optimize(given, keep=())
        assert after is not given
    else:
        after.apply_filter(name, **({"keepquality": False, "selected": False}
                                    if name != IN_PLACE[-1] else {}))
    return before, after


ALL = [*IN_PLACE, "optimize"]


@pytest.mark.parametrize("name", [*MOVING, "meshing_odt_optimization", "optimize"])
def test_something_happens_at_all(name):
    before, after = (s.current_mesh() for s in done(name))
    assert (before.vertex_matrix() != after.vertex_matrix()).any()
    flipped = not np.array_equal(before.face_matrix(), after.face_matrix())
    assert flipped == (name not in MOVING)
    old = odt_plugins.quality(before)
    assert odt_plugins.quality(after).mean_quality > old.mean_quality + 0.01


@pytest.mark.parametrize("what", PER_VERTEX)
@pytest.mark.parametrize("name", ALL)
def test_data_per_vertex_survive(name, what):
    before, after = (PER_VERTEX[what](s.current_mesh()) for s in done(name))
    assert len(np.unique(before, axis=0)) > 1
    assert np.array_equal(before, after)


@pytest.mark.parametrize("what", PER_FACE)
@pytest.mark.parametrize("name", ALL)
def test_data_per_face_survive(name, what):
    before, after = (s.current_mesh() for s in done(name))
    old, new = PER_FACE[what](before), PER_FACE[what](after)
    assert len(np.unique(old, axis=0)) > 1
    if name == IN_PLACE[-1] and what == "face scalars":
        return
    views = [contract.View(m.vertex_matrix(), m.face_matrix(), {}, {}, {}) for m in (before, after)]
    labels = [PER_FACE["labels of regions"](m) for m in (before, after)]
    assert np.array_equal(new, old[contract.sources(*views, *labels)])


@pytest.mark.parametrize("what", PER_MESH)
@pytest.mark.parametrize("name", ALL)
def test_data_of_the_mesh_survive(name, what):
    before, after = (PER_MESH[what](s.current_mesh()) for s in done(name))
    assert np.array_equal(before, after)
    assert len(before)


def test_a_mesh_without_a_label_comes_back_without_one():
    given = plates()
    given.current_mesh().set_label("")
    whole = odt_plugins.optimize(given, keep=())
    out, other = (meshes.current_mesh() for meshes in (whole, done("optimize")[1]))
    for what, of in (PER_VERTEX | PER_FACE | PER_MESH).items():
        assert np.array_equal(of(out), "" if what == "label" else of(other)), what
    for mesh in (out, pymeshlab.Mesh(out.vertex_matrix(), out.face_matrix())):
        assert odt_plugins.remesh(mesh, scale=0.8).label() == ""


@pytest.mark.parametrize("what", OF_THE_SET)
@pytest.mark.parametrize("name", ALL)
def test_the_rest_of_the_set_survives(name, what):
    before, after = (OF_THE_SET[what](s) for s in done(name))
    assert np.array_equal(before, after)


@pytest.mark.parametrize("name", ALL)
def test_wedges_keep_the_texture_of_their_vertices(name):
    """The texture is continuous here, so every wedge must have that of its vertex."""
    before, after = (s.current_mesh() for s in done(name))
    uv = before.vertex_tex_coord_matrix()[:, ::-1]
    assert np.array_equal(after.wedge_tex_coord_matrix(), uv[after.face_matrix()].reshape(-1, 2))


@pytest.mark.parametrize("name", ALL)
def test_normals_are_those_of_the_new_mesh(name):
    """MeshLab weighs normals of vertices by angles and scales those of faces by the transform."""
    mesh = done(name)[1].current_mesh()
    points, faces = mesh.vertex_matrix(), mesh.face_matrix()
    fresh = pymeshlab.MeshSet()
    fresh.add_mesh(pymeshlab.Mesh(points, faces))
    assert fresh.current_mesh().face_normal_matrix() == pytest.approx(
        np.tile([0, 0, 1.0], (72, 1)), abs=1e-12)
    fresh.set_matrix(transformmatrix=mesh.transform_matrix(), freeze=False)
    assert np.array_equal(mesh.face_normal_matrix(), fresh.current_mesh().face_normal_matrix())
    angle = np.zeros(len(points))
    for face in faces:
        for i in range(3):
            a, b = (points[face[(i + k) % 3]] - points[face[i]] for k in (1, 2))
            angle[face[i]] += np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))
    expected = np.column_stack([0 * angle, 0 * angle, angle])
    assert mesh.vertex_normal_matrix() == pytest.approx(expected, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("name", MOVING)
def test_moving_filters_leave_the_mesh_object_in_place(name):
    meshes = plates()
    mesh, other = meshes.current_mesh(), meshes.mesh(0)
    meshes.apply_filter(name, keepquality=False, selected=False)
    assert meshes.current_mesh() is mesh
    assert meshes.mesh(0) is other
    assert mesh.id() == 1
    assert np.array_equal(mesh.vertex_matrix(), done(name)[1].current_mesh().vertex_matrix())


@pytest.mark.parametrize("gone", [(), (0,), (1, 3), (0, 1, 3)])
def test_meshes_keep_their_ids_when_edges_are_flipped(gone):
    """A mesh of every id has its own label and points; the next one that is added another id."""
    meshes = pymeshlab.MeshSet()
    for seed in range(4):
        meshes.add_mesh(plate(seed))
        meshes.current_mesh().set_label(f"plate {seed}")
        meshes.set_current_mesh_visibility(seed != 3)
    for i in gone:
        meshes.set_current_mesh(i)
        meshes.delete_current_mesh()
    meshes.set_current_mesh(2)
    left = [i for i in range(4) if i not in gone]
    assert meshes.meshing_odt_optimization()["new_faces"] > 0
    assert meshes.current_mesh_id() == 2
    assert [i for i in range(9) if meshes.mesh_id_exists(i)] == left
    for i in left:
        assert meshes.mesh(i).label() == f"plate {i}"
        assert meshes.is_mesh_visible(i) == (i != 3)
        assert np.array_equal(meshes.mesh(i).vertex_matrix(), plate(i).vertex_matrix()) == (i != 2)
    meshes.add_mesh(plate())
    assert meshes.current_mesh_id() not in left


def test_mesh_objects_of_other_meshes_stay_valid_when_edges_are_flipped():
    """Then the current mesh has a new id, and a warning tells it."""
    meshes = plates()
    first = meshes.mesh(0)
    with pytest.warns(ODTWarning, match="mesh 1 of the MeshSet was built anew and is now mesh 3"):
        meshes.meshing_odt_optimization(selected=False)
    assert meshes.current_mesh_id() == 3
    assert [meshes.mesh_id_exists(i) for i in range(5)] == [True, False, True, True, False]
    assert first is meshes.mesh(0)
    assert first.vertex_matrix() == pytest.approx(np.eye(3))
    assert not meshes.is_current_mesh_visible()


def test_another_mesh_with_several_textures_stays_when_edges_are_flipped(tmp_path):
    meshes = two_textures(tmp_path)
    meshes.add_mesh(plate())
    with pytest.warns(ODTWarning, match="mesh 1 of the MeshSet was built anew and is now mesh 2"):
        meshes.meshing_odt_optimization()
    assert sorted(meshes.mesh(0).textures()) == ["rock.png", "soil.png"]


def without_face_attributes(mesh):
    """A set of one mesh with all its data but custom attributes of faces."""
    meshes = private_copy(mesh)
    found = custom_attributes(meshes)
    with tempfile.TemporaryDirectory() as folder:
        file = f"{folder}/mesh.ply"
        names = {f"{mark}{a.name}": False for a in found for mark, reader in CUSTOM.items()
                 if reader == a.reader}
        meshes.save_current_mesh(file, save_textures=True, **names)
        fresh = pymeshlab.MeshSet()
        fresh.load_new_mesh(file)
    for attribute in found:
        if "vertex" in attribute.reader:
            attribute.add(fresh.current_mesh(), attribute.values(mesh))
    fresh.set_matrix(transformmatrix=np.array(mesh.transform_matrix()), freeze=False)
    return fresh


READ = [name for name in dir(pymeshlab.Mesh) if name.endswith(("_array", "_matrix", "_number"))
        and not any(word in name for word in ("custom", "curvature", "adjacency"))]


@pytest.mark.parametrize("keep", [True, False])
def test_a_mesh_object_stays_valid_when_edges_are_flipped(keep):
    """Everything is as in a copy that was built anew."""
    start = plates()
    meshes = without_face_attributes(start.current_mesh())
    mesh, matrix = meshes.current_mesh(), plate().face_matrix()
    copy = odt_plugins.optimize(meshes, smoothing={"cycles": 1}, keep=FIGURES if keep else ())
    other = copy.current_mesh()
    meshes.meshing_odt_optimization(selected=False, keepquality=keep)
    assert meshes.current_mesh() is mesh
    assert (meshes.mesh_number(), mesh.id()) == (1, 0)
    assert (mesh.face_matrix() != matrix).any()
    for name in READ:
        there = getattr(other, name)()
        assert np.array_equal(getattr(mesh, name)(), there), name
    for what in ("custom scalars per vertex", "custom points per vertex"):
        assert np.array_equal(PER_VERTEX[what](mesh), PER_VERTEX[what](other))


def test_a_mesh_object_whose_mesh_takes_no_faces_keeps_its_mesh():
    """MeshLab sets custom attributes of faces for new meshes only."""
    meshes = plates()
    start = plates()
    mesh, before = meshes.current_mesh(), start.current_mesh()
    with pytest.warns(ODTWarning, match="mesh 1 of the MeshSet is in use .* result is mesh 3"):
        meshes.meshing_odt_optimization(selected=False)
    assert meshes.current_mesh_id() == 3
    assert meshes.mesh(1) is mesh
    for name in READ:
        assert np.array_equal(getattr(mesh, name)(), getattr(before, name)()), name
    assert (meshes.current_mesh().face_matrix() != mesh.face_matrix()).any()


@pytest.mark.parametrize("held", [True, False])
def test_texture_coordinates_of_wedges_alone(held):
    """The filter of MeshLab that sets them adds texture coordinates of vertices."""
    points, faces, _ = contract.grid(2, 6)
    space = np.column_stack([points, np.zeros(len(points))])
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(space, faces, w_tex_coords_matrix=points[faces].reshape(-1, 2)))
    mesh = meshes.current_mesh() if held else None
    meshes.meshing_odt_optimization()
    now = meshes.current_mesh()
    assert meshes.current_mesh_id() == 0
    assert (now.face_matrix() != faces).any()
    assert not held or now is mesh
    assert now.has_vertex_tex_coord() == held
    uv = now.wedge_tex_coord_matrix().reshape(-1, 3, 2)
    assert uv == pytest.approx(points[now.face_matrix()], abs=1e-6)


def test_a_mesh_object_stays_valid_with_several_textures(tmp_path):
    meshes = two_textures(tmp_path)
    mesh = meshes.current_mesh()
    before = sorted(materials(meshes, tmp_path).values())
    meshes.meshing_odt_optimization()
    assert meshes.current_mesh() is mesh
    assert sorted(mesh.textures()) == ["rock.png", "soil.png"]
    assert sorted(materials(meshes, tmp_path).values()) == before


def test_coordinates_arrive_bit_for_bit():
    """Also where the way is long, and the sign of a zero of a vertex that does not move."""
    rng = np.random.default_rng(5)
    old, new = rng.normal(size=(2, 40, 3)) * 10.0 ** rng.integers(-14, 14, (2, 40, 3))
    still = rng.random(old.shape) < 0.4
    old[rng.random(old.shape) < 0.3] = -0.0
    old[rng.random(old.shape) < 0.1] = 0.0
    new[still] = old[still]
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(old, np.array([[0, 1, 2]])))
    move_vertices(meshes, new)
    assert meshes.current_mesh().vertex_matrix().tobytes() == new.tobytes()


@pytest.mark.parametrize("name", [*MOVING, "meshing_odt_optimization"])
def test_filters_give_the_coordinates_of_plain_arrays(name):
    points, faces, _ = contract.grid(2, 6)
    space = np.column_stack([1.0 + 1e-3 * points[:, 0], 1e-3 * points[:, 1], -0.0 * points[:, 0]])
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(space, faces))
    meshes.apply_filter(name)
    options = {} if name.startswith("meshing") else {
        "finish": False, "method": "cpt" if "cpt" in name else "odt",
        "smoothing": {"rounds": 10, "connectivity": "none",
                      "solver": "global" if "global" in name else "gauss-seidel"}}
    expected, cells = odt_plugins.optimize((space, faces), **options)
    assert (expected != space).any()
    assert meshes.current_mesh().vertex_matrix().tobytes() == expected.tobytes()
    assert np.array_equal(meshes.current_mesh().face_matrix(), cells)


def test_a_set_with_gaps_is_copied_with_its_ids():
    meshes = plates()
    meshes.set_current_mesh(0)
    meshes.delete_current_mesh()
    meshes.set_current_mesh(1)
    meshes.apply_coord_taubin_smoothing(stepsmoothnum=1)
    out = odt_plugins.optimize(meshes)
    assert [out.mesh_id_exists(i) for i in range(4)] == [False, True, True, False]
    assert out.current_mesh_id() == 1
    assert saved_script(out) == saved_script(meshes)
    assert b'"Taubin Smooth"' in saved_script(out)


def test_result_of_a_mesh_outlives_everything_else():
    mesh = odt_plugins.optimize(plate())
    points = np.array(mesh.vertex_matrix())
    gc.collect()
    junk = [odt_plugins.optimize(plate(seed)) for seed in range(4)]
    assert np.array_equal(mesh.vertex_matrix(), points)
    assert private_copy(mesh).current_mesh().face_number() == 72
    assert len(junk) == 4


@pytest.mark.parametrize("name", [*MOVING, "meshing_odt_optimization"])
def test_only_selected_faces_change(name):
    meshes, given = plates(), plates()
    before = given.current_mesh()
    chosen = before.face_selection_array()
    assert 0 < chosen.sum() < len(chosen)
    # Some faces are selected, so that is the default, as for MeshLab's own filters.
    assert meshes.filter_parameter_values(name)["selected"] is True
    meshes.apply_filter(name, keepquality=False)
    after = meshes.current_mesh()
    rest = before.face_matrix()[~chosen]
    moved = np.flatnonzero((before.vertex_matrix() != after.vertex_matrix()).any(axis=1))
    assert moved.size
    assert not np.isin(moved, rest).any()
    left = {tuple(face) for face in after.face_matrix().tolist()}
    assert {tuple(face) for face in rest.tolist()} <= left


def test_selected_vertices_are_taken_without_selected_faces():
    meshes = pymeshlab.MeshSet()
    points, faces, _ = contract.grid(2, 6)
    meshes.add_mesh(pymeshlab.Mesh(np.column_stack([points, 0 * points[:, 0]]), faces))
    meshes.compute_selection_by_condition_per_vertex(condselect="y < 0.5")
    chosen = meshes.current_mesh().vertex_selection_array().copy()
    meshes.apply_coord_odt_smoothing(selected=True, keepquality=False)
    moved = (meshes.current_mesh().vertex_matrix()[:, :2] != points).any(axis=1)
    assert moved.any()
    assert not (moved & ~chosen).any()
    meshes.set_selection_none(allfaces=True, allverts=True)
    assert meshes.apply_coord_odt_smoothing(selected=True)["moved_vertices"] == 0


def heron(points, faces):
    """2 r/R from area and sides: r = A/s, R = abc/(4A)."""
    out = []
    for a, b, c in np.asarray(points)[faces]:
        sides = [np.linalg.norm(b - a), np.linalg.norm(c - b), np.linalg.norm(a - c)]
        area = 0.5 * np.linalg.norm(np.cross(b - a, c - a))
        out.append(2 * (area / (sum(sides) / 2)) / (np.prod(sides) / (4 * area)))
    return np.array(out)


@pytest.mark.parametrize("custom", ["nothing", "vertex", "face"])
def test_radius_ratios_in_the_face_scalars(custom):
    """And nothing else: not even the colours, which MeshLab's own measure of shape sets."""
    rng = np.random.default_rng(8)
    points, faces, _ = contract.grid(2, 6)
    space = 1e-60 * np.column_stack([points, rng.uniform(0, 0.1, len(points))])
    mesh = pymeshlab.Mesh(space, faces, f_color_matrix=np.full((len(faces), 4), 0.2))
    if custom != "nothing":
        values = space if custom == "vertex" else space[faces].mean(axis=1)
        getattr(mesh, f"add_{custom}_custom_point_attribute")(values, "velocity")
    meshes = pymeshlab.MeshSet()
    for label in ("one", "two", "three"):
        meshes.add_mesh(mesh)
        meshes.current_mesh().set_label(label)
    meshes.set_current_mesh(1)
    result = meshes.compute_scalar_by_radius_ratio_per_face()
    assert (meshes.current_mesh_id(), meshes.mesh_number()) == (1, 3)
    assert [meshes.mesh(i).label() for i in range(3)] == ["one", "two", "three"]
    now = meshes.current_mesh()
    assert now.face_scalar_array() == pytest.approx(heron(1e60 * space, faces), rel=1e-12)
    assert result["min_radius_ratio"] == now.face_scalar_array().min()
    assert result["mean_radius_ratio"] == pytest.approx(now.face_scalar_array().mean())
    assert np.array_equal(now.vertex_matrix(), space)
    assert np.array_equal(now.face_matrix(), faces)
    assert np.array_equal(now.face_color_array(), mesh.face_color_array())
    assert not meshes.mesh(0).has_face_scalar()
    if custom != "nothing":
        read = f"{custom}_custom_point_attribute_matrix"
        assert np.array_equal(getattr(now, read)("velocity"), values)


def two_textures(tmp_path, names=("rock.png", "soil.png")):
    """Jittered plate whose halves x < 1/2, x > 1/2 have textures of 4 and 5 pixels."""
    pictures = pytest.importorskip("matplotlib.image")
    for i, name in enumerate(names):
        pictures.imsave(tmp_path / name, np.full((4, 4 + i, 3), 0.5))
    points, faces, labels = contract.grid(2, 6)
    lines = ["mtllib two.mtl"]
    lines += [f"v {x!r} {y!r} 0" for x, y in points.tolist()]
    lines += [f"vt {x!r} {y!r}" for x, y in points.tolist()]
    for label, material in ((7, "a"), (-2, "b")):
        lines.append(f"usemtl {material}")
        lines += ["f " + " ".join(f"{v + 1}/{v + 1}" for v in f) for f in faces[labels == label]]
    materials = [f"newmtl {m}\nmap_Kd {name}\n" for m, name in zip("ab", names, strict=True)]
    (tmp_path / "two.obj").write_text("\n".join(lines), encoding="utf-8")
    (tmp_path / "two.mtl").write_text("".join(materials), encoding="utf-8")
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(tmp_path / "two.obj"))
    return meshes


def materials(meshes, tmp_path):
    """Picture file of every face, from the files that MeshLab writes, by sorted vertices."""
    meshes.save_current_mesh(str(tmp_path / "out.obj"))
    text = (tmp_path / "out.obj.mtl").read_text(encoding="utf-8")
    name = dict(re.findall(r"newmtl (\S+)(?:(?!newmtl)[\s\S])*?map_Kd (\S+)", text))
    found, now = {}, None
    for line in (tmp_path / "out.obj").read_text(encoding="utf-8").splitlines():
        word, *rest = line.split() or [""]
        if word == "usemtl":
            now = name[rest[0]]
        elif word == "f":
            found[tuple(sorted(int(v.partition("/")[0]) - 1 for v in rest))] = now
    return found


@pytest.mark.parametrize("name", ["apply_coord_odt_smoothing", "meshing_odt_optimization",
                                  "optimize", "second"])
def test_faces_keep_their_textures_and_those_never_mix(name, tmp_path):
    """No warning, neither where only points move; "second" stands beside the current mesh."""
    meshes = two_textures(tmp_path)
    rim = contract.facets(meshes.current_mesh().face_matrix(), (np.array(
        [picture == "rock.png" for picture in materials(meshes, tmp_path).values()])))
    old = meshes.current_mesh().vertex_matrix().copy()
    if name == "second":
        meshes.add_mesh(plate())
        meshes.set_current_mesh(0)
    if name in ("optimize", "second"):
        meshes = odt_plugins.optimize(meshes)
    else:
        meshes.apply_filter(name)
    points, faces = meshes.current_mesh().vertex_matrix(), meshes.current_mesh().face_matrix()
    assert (points != old).any()
    pictures = meshes.current_mesh().textures()
    assert {key: image.width() for key, image in pictures.items()} == {"rock.png": 4, "soil.png": 5}
    found = materials(meshes, tmp_path)
    assert set(found) == {tuple(sorted(f)) for f in faces.tolist()}
    for face, picture in found.items():
        assert picture == ("rock.png" if points[list(face), 0].mean() < 0.5 else "soil.png")
    labels = np.array([found[tuple(sorted(f))] == "rock.png" for f in faces.tolist()])
    assert contract.facets(faces, labels) == rim
    uv = meshes.current_mesh().wedge_tex_coord_matrix().reshape(-1, 3, 2)
    assert uv == pytest.approx(old[faces][:, :, :2], abs=1e-6)


def test_charts_of_a_texture_never_mix():
    """The seam is in the texture alone: no label parts the faces."""
    points, faces, labels = contract.grid(2, 6)
    uv = np.round(points * 64)[faces] / 64 + (labels == 7)[:, None, None]
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(np.column_stack([points, 0 * points[:, 0]]), faces,
                                   w_tex_coords_matrix=uv.reshape(-1, 2)))
    assert meshes.meshing_odt_optimization()["new_faces"] > 0
    mesh = meshes.current_mesh()
    got = mesh.wedge_tex_coord_matrix().reshape(-1, 3, 2)
    shift = mesh.vertex_matrix()[mesh.face_matrix()][:, :, 0].mean(axis=1) < 0.5
    assert np.array_equal(contract.facets(mesh.face_matrix(), shift),
                          contract.facets(faces, labels))
    assert np.array_equal(got, np.round(points * 64)[mesh.face_matrix()] / 64
                          + shift[:, None, None])


@pytest.mark.parametrize("flips", [False, True])
def test_a_texture_without_wedges_survives(flips, tmp_path):
    """A scan often has texture coordinates per vertex alone."""
    two_textures(tmp_path)
    points, faces, _ = contract.grid(2, 6)
    text = ["ply", "format ascii 1.0", "comment TextureFile soil.png",
            f"element vertex {len(points)}", *(f"property double {x}" for x in "xyz"),
            "property float texture_u", "property float texture_v", f"element face {len(faces)}",
            "property list uchar int vertex_indices", "end_header"]
    text += [f"{x!r} {y!r} 0 {y} {x}" for x, y in points.tolist()]
    text += [f"3 {a} {b} {c}" for a, b, c in faces.tolist()]
    (tmp_path / "scan.ply").write_text("\n".join([*text, ""]), encoding="utf-8")
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(tmp_path / "scan.ply"))
    lab = {"connectivity": "auto" if flips else "none"}
    out = odt_plugins.optimize(meshes, smoothing=lab, finish=flips)
    old, new = meshes.current_mesh(), out.current_mesh()
    assert flips != np.array_equal(old.face_matrix(), new.face_matrix())
    assert not new.has_wedge_tex_coord()
    assert np.array_equal(new.vertex_tex_coord_matrix(), old.vertex_tex_coord_matrix())
    assert [(name, i.width()) for name, i in new.textures().items()] == [("soil.png", 5)]


def test_textures_whose_names_no_file_holds_are_named(tmp_path):
    meshes = two_textures(tmp_path, ("felsgestein-grün.png", "soil.png"))
    with pytest.warns(DataNotKeptWarning, match=r"'felsgestein-grün.png' is 'texture0.png' now"):
        out = odt_plugins.optimize(meshes)
    assert sorted(out.current_mesh().textures()) == ["soil.png", "texture0.png"]


def test_what_cannot_survive_is_named():
    points, faces, _ = contract.grid(2, 6)
    turn = np.arange(12) * np.pi / 6
    rim = np.column_stack([3 * np.cos(turn), np.sin(turn), 0 * turn])
    polygon = pymeshlab.Mesh(rim, [np.arange(12, dtype=np.uint32)])
    with pytest.warns(DataNotKeptWarning, match="polygons, which are now triangles"):
        out = odt_plugins.optimize(polygon, keep=())
    assert (len(polygon.polygonal_face_list()), len(out.polygonal_face_list())) == (1, 10)
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(np.column_stack([points, 0 * points[:, 0]]), faces))
    meshes.compute_curvature_principal_directions_per_vertex()
    with pytest.warns(DataNotKeptWarning, match="curvature directions per vertex"):
        odt_plugins.optimize(meshes)
    meshes.meshing_odt_optimization()
    assert meshes.current_mesh().vertex_curvature_principal_dir1_matrix().any()


def test_an_optimal_mesh_and_a_single_face_come_back_unchanged():
    height = 0.75**0.5
    places = np.array([[np.cos(k * np.pi / 3), np.sin(k * np.pi / 3), 2.0] for k in range(6)])
    hexagon = np.vstack([places, [0.0, 0.0, 2.0]])
    faces = np.array([[k, (k + 1) % 6, 6] for k in range(6)])
    single = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, height, 0]])
    for points, cells in ((hexagon, faces), (single, np.array([[0, 1, 2]]))):
        out = odt_plugins.optimize(pymeshlab.Mesh(points, cells))
        assert out.vertex_matrix().tobytes() == points.tobytes()
        assert np.array_equal(out.face_matrix(), cells)


@pytest.mark.parametrize(("make", "words"), [
    (lambda: pymeshlab.MeshSet(), r"MeshSet without meshes.*load_new_mesh"),
    (lambda: pymeshlab.Mesh(np.eye(3)), r"without faces.*generate_surface_reconstruction"),
])
def test_objects_that_cannot_be_optimised(make, words):
    with pytest.raises(UnsupportedMeshError, match=words):
        odt_plugins.optimize(make())


def test_regions_by_the_name_of_an_attribute():
    mesh = plate()
    mesh.add_face_custom_scalar_attribute(np.arange(72.0), "all")
    out = odt_plugins.optimize(mesh, regions="all")
    assert np.array_equal(out.face_matrix(), mesh.face_matrix())
    with pytest.raises(InvalidOptionError, match=r"'all', 'marker', 'stress'"):
        odt_plugins.optimize(mesh, regions="rock")


def test_register_knows_its_toolkits(monkeypatch):
    with pytest.raises(InvalidOptionError, match="'blender'; expected one of"):
        odt_plugins.register("blender")
    monkeypatch.setattr("odt_plugins.errors.find_spec", lambda name: None)
    with pytest.raises(MissingDependencyError, match=r'pip install "odt-plugins\[pymeshlab\]"'):
        odt_plugins.register("pymeshlab")


def test_threads_leave_the_streams_of_the_process():
    def work(_):
        with muted():
            time.sleep(1e-3)

    before = [os.fstat(stream).st_ino for stream in (1, 2)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(work, range(40)))
    assert [os.fstat(stream).st_ino for stream in (1, 2)] == before


def test_errors_speak_of_faces():
    points, faces, _ = contract.grid(2, 4)
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(np.column_stack([points, 0 * points[:, 0]]), faces))
    for mesh in (meshes, meshes.current_mesh()):
        with pytest.raises(odt_plugins.InvalidOptionError, match=r"one for each face$"):
            odt_plugins.remesh(mesh, np.ones(3))
