"""Scenes of trimesh and models of open3d, part by part; parts that share a rim stay together."""

from __future__ import annotations

import contract
import numpy as np
import pytest
import quadratic_meshes
import surface_meshes as sm
from scipy.spatial import Delaunay

import odt_plugins
from odt_plugins.errors import (
    InvalidMeshError,
    InvalidOptionError,
    TangledMeshError,
    UnsupportedMeshError,
)

trimesh = pytest.importorskip("trimesh")
move = trimesh.transformations.translation_matrix


def bowl(seed=0):
    p, t = sm.bowl(13, noise=0.0)
    rim = np.unique([v for e, d in sm.edge_set(t).items() if d == 1 for v in e])
    free = np.setdiff1d(np.arange(len(p)), rim)
    seam = np.abs(p[:, 0]) < 1e-12
    p[free, :2] += 0.05 * np.random.default_rng(seed).uniform(-1, 1, (len(free), 2))
    p[seam, 0] = 0.0
    p[:, 2] = 0.3 * (p[:, 0] ** 2 - 0.5 * p[:, 1] ** 2)
    return p, t


def halves():
    """The two sides of a bowl, cut along x = 0, each with vertices of its own."""
    p, t = bowl()
    left = p[t].mean(axis=1)[:, 0] < 0.0
    out = []
    for part in (t[left], t[~left]):
        used, rows = np.unique(part, return_inverse=True)
        out.append((p[used], rows.reshape(-1, 3)))
    return out


def shared(a, b):
    return set(map(tuple, np.asarray(a).tolist())) & set(map(tuple, np.asarray(b).tolist()))


def scene_of(parts):
    scene = trimesh.Scene(metadata={"recipe": 7})
    for i, (p, t) in enumerate(parts):
        mesh = trimesh.Trimesh(p, t, process=False)
        scene.add_geometry(mesh, node_name=f"node {i}", geom_name=f"part {i}")
    return scene


def test_a_scene_is_optimised_geometry_by_geometry():
    class Mine(trimesh.Scene):
        pass

    scene = scene_of([bowl(1), bowl(2)])
    scene.__class__ = Mine
    scene.mine = [1, 2]
    scene.graph.update("node 1", matrix=move([5.0, 0, 0]), geometry="part 1")
    scene.graph.update("again", matrix=move([0, 9.0, 0]), geometry="part 1")
    scene.add_geometry(trimesh.primitives.Box(), node_name="box", geom_name="box",
                       transform=move([-9.0, 0, 0]))
    scene.add_geometry(trimesh.PointCloud(np.eye(3)), node_name="cloud", geom_name="cloud")
    scene.geometry["part 0"].visual.vertex_colors = np.arange(
        4 * len(scene.geometry["part 0"].vertices)).reshape(-1, 4) % 256
    before = {name: np.array(part.vertices) for name, part in scene.geometry.items()}
    out, whole = odt_plugins.optimize_with_report(scene, envelope=0.02)
    assert type(out) is Mine
    assert out.mine == [1, 2]
    assert out.metadata == scene.metadata
    assert list(out.geometry) == list(scene.geometry)
    assert set(out.graph.nodes) == set(scene.graph.nodes)
    for node in scene.graph.nodes_geometry:
        assert out.graph[node][1] == scene.graph[node][1]
        assert np.array_equal(out.graph[node][0], scene.graph[node][0])
    assert len(whole.parts) == 2
    for i, report in enumerate(whole.parts):
        alone = odt_plugins.optimize(scene.geometry[f"part {i}"], envelope=0.02)
        there = out.geometry[f"part {i}"]
        assert np.array_equal(alone.vertices, there.vertices)
        assert np.array_equal(alone.faces, there.faces)
        assert report.after.mean_quality > report.before.mean_quality
        assert report.notes == ()
    assert np.array_equal(out.geometry["part 0"].visual.vertex_colors,
                          scene.geometry["part 0"].visual.vertex_colors)
    assert isinstance(out.geometry["box"], trimesh.primitives.Box)
    for name, points in before.items():
        assert np.array_equal(scene.geometry[name].vertices, points)
        assert out.geometry[name] is not scene.geometry[name]
    assert odt_plugins.optimize(scene, envelope=0.02).to_mesh().faces.shape == (
        out.to_mesh().faces.shape)


def test_what_is_changed_in_the_metadata_of_a_result_stays_as_it_is_in_the_scene():
    scene = scene_of([bowl(1)])
    scene.metadata["units"] = {"length": ["mm"]}
    odt_plugins.optimize(scene, envelope=0.02).metadata["units"]["length"].append("m")
    assert scene.metadata["units"] == {"length": ["mm"]}


@pytest.mark.parametrize("away", [0.0, 3.0])
def test_parts_that_touch_do_not_come_apart(away):
    """Two halves of a bowl, the second moved by its node, and a fin that stands on the first."""
    (p, t), (q, u) = halves()
    rim = {v for e, d in sm.edge_set(t).items() if d == 1 for v in e}
    line = np.flatnonzero(np.isclose(p[:, 0], p[np.argmin(np.abs(p[:, 0] + 0.5)), 0], atol=0.07))
    line = np.array([v for v in line[np.argsort(p[line, 1])] if v not in rim])
    k = len(line)
    assert k > 5
    a, b = np.arange(k - 1), np.arange(1, k)
    fin = (np.concatenate([p[line], p[line] + [0.0, 0.0, 0.3]]),
           np.concatenate([np.c_[a, b, a + k], np.c_[b, b + k, a + k]]))
    seam, shift = shared(p, q), np.array([away, 0.0, 0.0])
    assert len(seam) > 10
    scene = scene_of([(p, t), (q - shift, u), fin])
    scene.graph.update("node 1", matrix=move(shift), geometry="part 1")
    out, whole = odt_plugins.optimize_with_report(scene, envelope=0.05)
    x, y, z = (out.geometry[f"part {i}"].vertices for i in range(3))
    assert shared(x, p) >= seam
    assert shared(x, z) == shared(p, fin[0])
    assert len(shared(y, q - shift)) >= len(seam)
    assert [len(report.notes) for report in whole.parts] == [1, 0, 0]
    assert whole.parts[0].notes[0].startswith(f"{k} vertices at the rim of another geometry stay")
    assert (x != p).any()
    assert all(r.after.mean_quality > r.before.mean_quality for r in whole.parts[:2])


@pytest.mark.parametrize(("name", "number"), [("cells", 1000), ("vertices", 500)])
def test_parts_have_the_number_asked_for_together(name, number):
    big, small = trimesh.creation.icosphere(2), trimesh.creation.icosphere(1)
    scene = trimesh.Scene()
    scene.add_geometry(big, geom_name="big")
    scene.add_geometry(small, geom_name="small", transform=move([5.0, 0, 0]))
    out, report = odt_plugins.remesh_with_report(scene, **{name: number})
    found = report.after.n_cells if name == "cells" else report.after.n_points
    assert abs(found - number) < 0.05 * number
    ratio = len(out.geometry["big"].faces) / len(out.geometry["small"].faces)
    assert abs(ratio - len(big.faces) / len(small.faces)) < 0.8
    with pytest.raises(InvalidOptionError, match=f"{name}=0; expected an integer"):
        odt_plugins.remesh(scene, **{name: 0})


def test_what_is_fixed_stays_beside_what_is_shared():
    (p, t), (q, u) = halves()
    scene = scene_of([(p, t), (q, u)])
    out = odt_plugins.optimize(scene, fixed=[0, 1, 2], envelope=0.05)
    for i, points in enumerate((p, q)):
        assert np.array_equal(out.geometry[f"part {i}"].vertices[:3], points[:3])


def test_scenes_that_cannot_be_optimised_are_named():
    with pytest.raises(UnsupportedMeshError, match=r"trimesh Scene of 0 geometries without"):
        odt_plugins.optimize(trimesh.Scene())
    with pytest.raises(UnsupportedMeshError, match=r"single mesh is needed, try mesh\.to_mesh\(\)"):
        odt_plugins.quality(scene_of(halves()))
    broken = scene_of(halves())
    broken.geometry["part 1"].vertices[0] = np.nan
    with pytest.raises(InvalidMeshError, match=r"^geometry 'part 1': .*finite"):
        odt_plugins.optimize(broken)
    with pytest.raises(InvalidOptionError, match="geometries that touch"):
        odt_plugins.optimize(scene_of(halves()), boundary="slide")


def test_a_model_of_open3d_is_optimised_mesh_by_mesh():
    o3d = pytest.importorskip("open3d")
    rendering = o3d.visualization.rendering
    model = rendering.TriangleMeshModel()
    material = rendering.MaterialRecord()
    material.shader = "defaultUnlit"
    model.materials = [material]
    parts = []
    for p, t in halves():
        parts.append(o3d.geometry.TriangleMesh(
            o3d.utility.Vector3dVector(p), o3d.utility.Vector3iVector(t.astype(np.int32))))
        parts[-1].vertex_colors = o3d.utility.Vector3dVector(np.abs(p) / np.abs(p).max())
    empty = o3d.geometry.TriangleMesh()
    model.meshes = [rendering.TriangleMeshModel.MeshInfo(mesh, name, 0) for mesh, name in (
        (parts[0], "left"), (empty, "nothing"), (parts[1], ""))]
    before = [np.array(mesh.vertices) for mesh in parts]
    out, whole = odt_plugins.optimize_with_report(model, envelope=0.05)
    assert type(out) is type(model)
    assert [info.mesh_name for info in out.meshes] == ["left", "nothing", ""]
    assert [info.material_idx for info in out.meshes] == [0, 0, 0]
    assert [m.shader for m in out.materials] == ["defaultUnlit"]
    assert [report.name for report in whole.parts] == ["left", "mesh 2"]
    assert "\npart 0 'left'\n" in str(whole)
    after = [np.asarray(out.meshes[i].mesh.vertices) for i in (0, 2)]
    assert shared(*after) == shared(*before)
    assert all((new != old).any() for new, old in zip(after, before, strict=True))
    assert all(np.array_equal(mesh.vertices, old) for mesh, old in zip(parts, before, strict=True))
    assert np.array_equal(out.meshes[0].mesh.vertex_colors, parts[0].vertex_colors)
    with pytest.raises(UnsupportedMeshError, match="TriangleMeshModel of 0 meshes"):
        odt_plugins.optimize(rendering.TriangleMeshModel())
    with pytest.raises(UnsupportedMeshError, match="try sum") as caught:
        odt_plugins.quality(model)
    one = eval(str(caught.value).rpartition("try ")[2], {"mesh": model, "open3d": o3d})
    assert odt_plugins.quality(one).n_cells == sum(len(t) for _, t in halves())


@pytest.mark.parametrize(("call", "named"), [
    ("remesh", {"size": "h"}), ("remesh", {"adapt": "h", "cells": 90}),
    ("remesh", {"metric": "h"}), ("optimize", {"metric": "h"}), ("optimize", {"regions": "h"})])
def test_a_name_that_a_later_part_lacks_is_told_before_the_work(call, named, monkeypatch):
    def fails(*_args, **_how):
        raise AssertionError

    parts = [trimesh.Trimesh(*bowl(i), process=False) for i in range(2)]
    tensors, regions = "metric" in named, "regions" in named
    n = len(parts[0].faces) if regions else len(parts[0].vertices)
    values = np.arange(n) // 99 if regions else np.full((n, 6) if tensors else n, 0.3)
    (parts[0].face_attributes if regions else parts[0].vertex_attributes)["h"] = values
    scene = trimesh.Scene({f"part {i}": part for i, part in enumerate(parts)})
    for room in ("odt_plugins.remeshing", "odt_plugins.api"):
        monkeypatch.setattr(f"{room}.run_engine", fails)
    with pytest.raises(InvalidOptionError, match=f"'part 1': .*{next(iter(named))}='h'"):
        getattr(odt_plugins, call)(scene, **named)


def test_figures_of_the_whole_are_those_of_its_parts_together():
    pyvista = pytest.importorskip("pyvista")
    blocks = pyvista.MultiBlock()
    for name, seed in (("left", 0), ("right", 1)):
        p = np.random.default_rng(seed).random((200, 2)) * (4.0, 1.0) + (5.0 * seed, 0.0)
        cells = Delaunay(p).simplices
        blocks[name] = pyvista.PolyData.from_regular_faces(np.pad(p, ((0, 0), (0, 1))), cells)
        blocks[name].point_data["M"] = np.tile([1.0, 0.0, 16.0], (len(p), 1))
    _, whole = odt_plugins.optimize_with_report(blocks, metric="M", keep=())
    for figures, own in ((whole.before, [part.before for part in whole.parts]),
                         (whole.after, [part.after for part in whole.parts])):
        cells = [one.n_cells for one in own]
        assert figures.mean_quality == pytest.approx(
            np.average([one.mean_quality for one in own], weights=cells))
        assert figures.min_quality == min(one.min_quality for one in own)
        assert figures.max_angle == max(one.max_angle for one in own)
        assert figures.area == pytest.approx(sum(one.area for one in own))
    assert whole.name == ""
    assert whole.worth().after.unknowns == sum(part.worth().after.unknowns for part in whole.parts)


def test_vertices_of_the_whole_are_all_nodes_of_quadratic_parts():
    pyvista = pytest.importorskip("pyvista")
    points, cells, _ = contract.grid(3, 4)
    wide, rows = quadratic_meshes.widened(points, cells)
    part = pyvista.UnstructuredGrid({quadratic_meshes.VTK[3]: rows}, wide)
    out, whole = odt_plugins.optimize_with_report(pyvista.MultiBlock([part, part.copy()]))
    assert whole.after.n_points == sum(one.after.n_points for one in whole.parts)
    assert whole.after.n_points == sum(block.n_points for block in out)


class Stopped(InvalidMeshError):
    """What a caller's own function raises."""

    def __init__(self, stage, share):
        super().__init__(f"stopped at {stage}")
        self.share = share


def test_errors_of_a_part_know_what_those_of_one_mesh_do():
    pyvista = pytest.importorskip("pyvista")
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1.5, 0.5, 0]])
    part = pyvista.PolyData.from_regular_faces(
        points, [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    with pytest.raises(TangledMeshError) as alone:
        odt_plugins.optimize(part, repair="none")
    with pytest.raises(TangledMeshError, match="block 'left': got") as found:
        odt_plugins.optimize(pyvista.MultiBlock({"left": part}), repair="none")
    assert found.value.cells == alone.value.cells != ()

    def stop(stage, share):
        if share > 0.0:
            raise Stopped(stage, share)

    with pytest.raises(Stopped, match="block 'left': stopped") as own:
        odt_plugins.optimize(pyvista.MultiBlock({"left": part}), progress=stop)
    assert own.value.share > 0.0
