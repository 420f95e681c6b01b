"""Scenes of glTF by trimesh: read with their graph, materials and textures, and written again."""

from __future__ import annotations

import json
from collections import Counter
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from odt_plugins.errors import MeshFileError, counted

SUFFIXES = {".glb": "glb", ".gltf": "gltf"}
"""Suffixes, and the names of their formats."""

HELD = "gltf_held"
"""Attribute of a scene that tells what the file held that it was read from."""

WORDS = {"scenes": "scene", "nodes": "node", "meshes": "mesh", "materials": "material",
         "images": "image", "animations": "animation", "skins": "skin", "cameras": "camera"}
"""Parts of a file, and what one of them is called."""

UNNAMED = ("animations", "skins", "cameras")
"""Parts that count without a name, too."""

MODES = {0: "points", 1: "lines", 2: "line loops", 3: "line strips", 5: "triangle strips",
         6: "triangle fans"}
"""Primitives beside triangles."""

TRIANGLES = 4

PRIMITIVE = "from_gltf_primitive"
"""What trimesh calls a mesh that was a part of one."""

USUAL = {"wrapS": (10497,), "wrapT": (10497,), "magFilter": (9729,)}
"""Values of samplers that programs take where none are given."""


def installed() -> bool:
    """Say whether trimesh is there."""
    return find_spec("trimesh") is not None


def read(path: Path) -> Any:
    """Read a trimesh.Scene, with the vertices and faces that the file has.

    Raises
    ------
    MeshFileError    the file ends too early, or is none of glTF
    Exception        anything at all, on a file that is broken
    """
    import trimesh

    found = held(path)
    scene = trimesh.load_scene(path, process=False)
    if not scene.geometry:
        msg = "it holds no geometry"
        raise MeshFileError(msg)
    for mesh in scene.geometry.values():
        beside = getattr(mesh.visual, "vertex_attributes", {})
        # trimesh reads what there is beside a texture, and writes four bytes for each vertex.
        if "color" in beside and (
                beside["color"].dtype != "u1" or beside["color"].shape[1:] != (4,)):
            del beside["color"]
    setattr(scene, HELD, found)
    return scene


def write(path: Path, scene: Any) -> list[str]:
    """Write a scene.

    Returns
    -------
    list of str    what is lost of the file that it was read from, each by its name
    """
    from trimesh.exchange.gltf import export_glb, export_gltf

    before = Counter(getattr(scene, HELD, []))
    normals = "vertex attribute NORMAL" in before or None
    if path.suffix.lower() == ".glb":
        path.write_bytes(export_glb(scene, include_normals=normals, tree_postprocessor=_joined))
    else:
        files = export_gltf(scene, include_normals=normals, embed_buffers=True,
                            tree_postprocessor=_joined)
        path.write_bytes(files["model.gltf"])
    after = Counter(held(path))
    gone = before - after
    return [what if count == before[what] else f"{what} of {counted(count, 'primitive')}"
            for what, count in gone.items()
            if not any(what.endswith(f" of {other}") for other in gone)]


def _joined(tree: dict[str, Any]) -> None:
    """Join the primitives of a mesh again, for which trimesh writes separate nodes."""
    nodes, meshes = tree.get("nodes", []), tree.get("meshes", [])
    owns = [node.get("mesh") for node in nodes]
    single = [own is not None and not {"children", "matrix", "translation", "rotation",
                                       "scale"} & node.keys()
              and bool(meshes[own].get("extras", {}).get(PRIMITIVE))
              for own, node in zip(owns, nodes, strict=True)]
    known: dict[tuple[int, ...], int] = {}
    gone: set[int] = set()
    for node in nodes:
        parts = [child for child in node.get("children", []) if single[child]]
        if len(parts) < 2 or "mesh" in node:
            continue
        key = tuple(sorted(owns[child] for child in parts))
        if key not in known:
            known[key] = len(meshes)
            meshes.append(meshes[key[0]] | {
                "primitives": [part for i in key for part in meshes[i]["primitives"]]})
        node["mesh"] = known[key]
        node["children"] = [child for child in node["children"] if child not in parts]
        if not node["children"]:
            del node["children"]
        gone.update(parts)
    stays = [i for i in range(len(nodes)) if i not in gone]
    place = {i: k for k, i in enumerate(stays)}
    tree["nodes"] = [nodes[i] for i in stays]
    shown = {node["mesh"] for node in tree["nodes"] if "mesh" in node}
    parts = [i for key in known for i in key if i not in shown]
    first = {own: key[0] for key, own in known.items()}
    used = sorted({*range(len(meshes))} - {*parts}, key=lambda i: first.get(i, i))
    tree["meshes"] = [meshes[i] for i in used]
    for node in tree["nodes"]:
        if "mesh" in node:
            node["mesh"] = used.index(node["mesh"])
        if "children" in node:
            node["children"] = [place[child] for child in node["children"]]
    for scene in tree.get("scenes", []):
        scene["nodes"] = [place[i] for i in scene.get("nodes", [])]
    for mesh in tree["meshes"]:
        mesh.get("extras", {}).pop(PRIMITIVE, None)


def held(path: Path) -> list[str]:
    """What a file holds by its names: scenes, nodes, materials, extensions, attributes.

    Attributes of vertices are there once for every primitive that has them.

    Raises
    ------
    MeshFileError    the file ends too early, or is none of glTF
    """
    data = path.read_bytes()
    if path.suffix.lower() == ".glb":
        if data[:4] != b"glTF":
            msg = "it does not begin with glTF"
            raise MeshFileError(msg)
        stated = int.from_bytes(data[8:12], "little")
        if stated != len(data):
            msg = f"it declares {stated} bytes and holds {len(data)}"
            raise MeshFileError(msg)
        data = data[20: 20 + int.from_bytes(data[12:16], "little")]
    try:
        tree = json.loads(data)
        return _names(tree)
    except (ValueError, AttributeError, TypeError) as exc:
        msg = f"its JSON ends or breaks ({' '.join(str(exc).split())[:80]})"
        raise MeshFileError(msg) from exc


def _names(tree: Any) -> list[str]:
    out = [f"extension {name!r}" for name in tree.get("extensionsUsed", [])]
    out += ["extras of the file"] * bool(tree.get("extras"))
    out += [f"the {word} of the file" for word in tree.get("asset", {})
            if word not in ("version", "minVersion", "generator")]
    out += [f"sampler {i}" for i, sampler in enumerate(tree.get("samplers", []))
            if any(sampler.get(word, usual[0]) not in usual for word, usual in USUAL.items())]
    for kind, word in WORDS.items():
        for i, entry in enumerate(tree.get(kind, [])):
            title = f"{word} {entry['name']!r}" if entry.get("name") else f"{word} {i}"
            if entry.get("name") or kind in UNNAMED:
                out.append(title)
            if entry.get("extras"):
                out.append(f"extras of {title}")
            if kind == "materials":
                parts = entry | entry.get("pbrMetallicRoughness", {})
                out += [f"{key} of {part} of {title}" for part, value in parts.items()
                        if part.endswith("Texture") for key in value if key != "index"]
    out = list(dict.fromkeys(out))
    for mesh in tree.get("meshes", []):
        for primitive in mesh.get("primitives", []):
            out += [f"vertex attribute {name}" for name in primitive.get("attributes", {})]
            mode = primitive.get("mode", TRIANGLES)
            out += [f"primitives of {MODES[mode]}"] if mode in MODES else []
            out += [f"morph targets of mesh {mesh.get('name', '')!r}"] * bool(
                primitive.get("targets"))
    return out
