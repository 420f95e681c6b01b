"""Scenes of glTF by trimesh: read with their graph, materials and textures, and written again."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from odt_plugins.errors import MeshFileError

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


def installed() -> bool:
    """Say whether trimesh is there."""
    return find_spec("trimesh") is not None


def read(path: Path) -> Any:
    """Read a scene, with the vertices and faces that the file has.

    Returns
    -------
    trimesh.Scene

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
    setattr(scene, HELD, found)
    return scene


def write(path: Path, scene: Any) -> list[str]:
    """Write a scene.

    Returns
    -------
    list of str    what is lost of the file that it was read from, each by its name
    """
    from trimesh.exchange.gltf import export_glb, export_gltf

    before = getattr(scene, HELD, [])
    normals = "vertex attribute NORMAL" in before or None
    if path.suffix.lower() == ".glb":
        path.write_bytes(export_glb(scene, include_normals=normals))
    else:
        files = export_gltf(scene, include_normals=normals, embed_buffers=True)
        path.write_bytes(files["model.gltf"])
    after = held(path)
    return [what for what in before if what not in after]


def held(path: Path) -> list[str]:
    """What a file holds by its names: scenes, nodes, materials, attributes, extensions.

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
        return list(dict.fromkeys(_names(tree)))
    except (ValueError, AttributeError, TypeError) as exc:
        msg = f"its JSON ends or breaks ({' '.join(str(exc).split())[:80]})"
        raise MeshFileError(msg) from exc


def _names(tree: Any) -> list[str]:
    out = [f"extension {name!r}" for name in tree.get("extensionsUsed", [])]
    for kind, word in WORDS.items():
        for i, entry in enumerate(tree.get(kind, [])):
            title = f"{word} {entry['name']!r}" if entry.get("name") else f"{word} {i}"
            if entry.get("name") or kind in UNNAMED:
                out.append(title)
            if entry.get("extras"):
                out.append(f"extras of {title}")
    for mesh in tree.get("meshes", []):
        for primitive in mesh.get("primitives", []):
            out += [f"vertex attribute {name}" for name in primitive.get("attributes", {})]
            mode = primitive.get("mode", TRIANGLES)
            out += [f"primitives of {MODES[mode]}"] if mode in MODES else []
            out += [f"morph targets of mesh {mesh.get('name', '')!r}"] * bool(
                primitive.get("targets"))
    return out
