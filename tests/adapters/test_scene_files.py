"""Scenes of glTF: names, graph, materials and textures stay, and what trimesh drops is named."""

from __future__ import annotations

import json
import warnings

import numpy as np
import pytest
import trimesh
from PIL import Image

from odt_plugins.adapters.files import read_file
from odt_plugins.api import optimize, optimize_file, quality
from odt_plugins.cli.main import main
from odt_plugins.errors import DataNotKeptWarning, MeshFileError, UnsupportedMeshError


def noisy(seed, uv=False):
    """A noisy sphere, with a texture if asked."""
    ball = trimesh.creation.icosphere(2)
    points = ball.vertices + np.random.default_rng(seed).normal(0, 0.01, ball.vertices.shape)
    mesh = trimesh.Trimesh(points, ball.faces, process=False)
    if uv:
        material = trimesh.visual.material.PBRMaterial(
            name="paint", baseColorTexture=Image.new("RGB", (4, 4), (200, 30, 30)))
        mesh.visual = trimesh.visual.TextureVisuals(uv=points[:, :2] / 4 + 0.5, material=material)
    return mesh


@pytest.fixture
def scene(tmp_path):
    """A file of two spheres, one of them shown twice and the other one with a texture."""
    made = trimesh.Scene()
    made.add_geometry(noisy(1), node_name="left", geom_name="ball")
    shift = trimesh.transformations.translation_matrix
    made.add_geometry(noisy(2, uv=True), node_name="right", geom_name="painted",
                      transform=shift([4, 0, 0]))
    made.graph.update(frame_to="again", matrix=shift([0, 5, 0]), geometry="ball")
    made.export(tmp_path / "a.glb")
    return tmp_path / "a.glb"


def changed_json(path, change):
    """Change the JSON of a file, whose other bytes stay."""
    data = path.read_bytes()
    size = int.from_bytes(data[12:16], "little")
    tree = json.loads(data[20: 20 + size])
    change(tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + size:]
    path.write_bytes(data[:8] + (20 + len(text) + len(rest)).to_bytes(4, "little")
                     + len(text).to_bytes(4, "little") + data[16:20] + text + rest)


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_names_graph_materials_and_textures_stay(suffix, scene, tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        report = optimize_file(scene, tmp_path / f"b{suffix}")
    was = trimesh.load_scene(scene, process=False)
    now = trimesh.load_scene(tmp_path / f"b{suffix}", process=False)
    assert len(report.parts) == 2
    assert list(was.geometry) == list(now.geometry)
    assert set(was.graph.nodes_geometry) == set(now.graph.nodes_geometry)
    for node in was.graph.nodes_geometry:
        assert np.array_equal(was.graph[node][0], now.graph[node][0])
        assert was.graph[node][1] == now.graph[node][1]
    for name, part in was.geometry.items():
        assert not np.array_equal(part.vertices, now.geometry[name].vertices)
        assert len(part.faces) == len(now.geometry[name].faces)
    painted = now.geometry["painted"].visual
    assert painted.material.name == "paint"
    assert painted.material.baseColorTexture.size == (4, 4)
    error = np.abs(painted.uv - (now.geometry["painted"].vertices[:, :2] / 4 + 0.5))
    assert error.max() < 0.01


def test_what_trimesh_drops_is_named(scene, tmp_path):
    def change(tree):
        tree["animations"] = [{"name": "walk", "channels": [], "samplers": []}]
        tree["cameras"] = [{"name": "front", "type": "perspective",
                            "perspective": {"yfov": 1.0, "znear": 0.1}}]
        tree["extensionsUsed"] = ["EXT_made_up"]

    changed_json(scene, change)
    message = "does not keep extension 'EXT_made_up', animation 'walk', camera 'front'"
    with pytest.warns(DataNotKeptWarning, match=message):
        optimize_file(scene, tmp_path / "b.glb")


def test_a_scene_goes_into_no_file_of_a_mesh_and_a_mesh_into_none_of_a_scene(scene, tmp_path):
    noisy(3).export(tmp_path / "c.stl")
    for source, target, other in ((scene, "d.stl", ".glb"),
                                  (tmp_path / "c.stl", "d.glb", ".ply or .vtu")):
        with pytest.raises(MeshFileError, match=rf"cannot write a .* to .*; try a \{other} file"):
            optimize_file(source, tmp_path / target)
        assert not (tmp_path / target).exists()
    with pytest.raises(UnsupportedMeshError, match="Scene of 2 geometries"):
        optimize(scene)


def test_what_is_to_be_tried_with_the_path_of_a_scene_helps(scene, tmp_path, capsys):
    loaded = r"trimesh\.load_scene\(path\), or trimesh\.load_mesh\(path\)"
    for call in (quality, optimize):
        with pytest.raises(UnsupportedMeshError, match=f"Scene of 2 geometries .*try {loaded}"):
            call(scene)
        call(trimesh.load_mesh(scene))
    optimize(trimesh.load_scene(scene))
    assert main(["quality", str(scene)]) != 0
    assert "try an INPUT whose geometries are joined to one" in capsys.readouterr().err


def test_broken_files_are_refused_by_a_sentence(scene, tmp_path, capsys):
    data = scene.read_bytes()
    for cut in (0, 3, 11, 19, 200, len(data) // 2, len(data) - 1):
        (tmp_path / "cut.glb").write_bytes(data[:cut])
        with pytest.raises(MeshFileError, match="expected a complete file"):
            read_file(tmp_path / "cut.glb")
    assert main(["optimize", str(tmp_path / "cut.glb"), str(tmp_path / "b.glb")]) == 1
    assert "Traceback" not in capsys.readouterr().err
    assert not (tmp_path / "b.glb").exists()


def test_the_command_line_reports_on_each_geometry(scene, tmp_path, capsys):
    assert main(["optimize", str(scene), str(tmp_path / "b.glb"), "--report",
                 str(tmp_path / "r.json")]) == 0
    assert len(json.loads((tmp_path / "r.json").read_text())["parts"]) == 2
    assert capsys.readouterr().out.count("ended") == 2


@pytest.mark.parametrize("words", [["optimize"], ["remesh", "--scale", "1"]])
def test_commands_say_what_to_do_with_a_file_whose_geometries_touch(words, tmp_path, capsys):
    boxes = [trimesh.creation.box() for _ in range(2)]
    boxes[1].apply_translation([1, 0, 0])
    made = trimesh.Scene(boxes)
    made.export(tmp_path / "a.glb")
    command, *flags = words
    assert main([command, str(tmp_path / "a.glb"), str(tmp_path / "b.glb"), *flags,
                 "--boundary", "slide"]) == 2
    said = capsys.readouterr().err
    assert "expected --boundary fixed, try an INPUT whose geometries are joined to one" in said
    assert not (tmp_path / "b.glb").exists()
    assert main([command, str(tmp_path / "a.glb"), str(tmp_path / "b.glb"), *flags]) == 0


def held_json(path):
    data = path.read_bytes()
    return json.loads(data[20: 20 + int.from_bytes(data[12:16], "little")])


def test_a_mesh_of_several_primitives_stays_one_wherever_it_is_shown(scene, tmp_path):
    """Of two nodes that show the first mesh, one has a child of its own beside."""
    def change(tree):
        ball, painted = tree["meshes"]
        ball["primitives"] += painted["primitives"]
        tree["nodes"].append({"name": "below", "mesh": 1, "translation": [9, 0, 0]})
        own = next(node for node in tree["nodes"] if node.get("name") == "again")
        own.setdefault("children", []).append(len(tree["nodes"]) - 1)

    changed_json(scene, change)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        optimize_file(scene, tmp_path / "b.glb")
    was, now = held_json(scene), held_json(tmp_path / "b.glb")
    for tree in (was, now):
        tree["names"] = sorted(node["name"] for node in tree["nodes"])
        tree["shown"] = {node["name"]: tree["meshes"][node["mesh"]]["name"]
                         for node in tree["nodes"] if "mesh" in node}
        tree["parts"] = [(mesh["name"], len(mesh["primitives"])) for mesh in tree["meshes"]]
    assert {key: now[key] for key in ("names", "shown", "parts")} == {
        key: was[key] for key in ("names", "shown", "parts")}
    one, two = (trimesh.load_scene(path, process=False) for path in (scene, tmp_path / "b.glb"))
    assert two.bounds == pytest.approx(one.bounds, abs=0.05)
    assert len(one.graph.nodes_geometry) == len(two.graph.nodes_geometry) == 6


def test_what_one_mesh_loses_is_named_where_another_keeps_it(scene, tmp_path):
    def change(tree):
        ball, painted = (mesh["primitives"][0]["attributes"] for mesh in tree["meshes"])
        ball["COLOR_0"] = ball["POSITION"]
        painted["COLOR_0"] = painted["POSITION"]
        tree["asset"]["copyright"] = "me"
        tree["samplers"] = [{"magFilter": 9729}, {"wrapS": 33071}]
        tree["materials"][0]["normalTexture"] = {"index": 0, "scale": 0.5}

    changed_json(scene, change)
    message = ("does not keep the copyright of the file, sampler 1, scale of normalTexture of "
               "material 'paint', vertex attribute COLOR_0 of 1 primitive$")
    with pytest.warns(DataNotKeptWarning, match=message):
        optimize_file(scene, tmp_path / "b.glb")
