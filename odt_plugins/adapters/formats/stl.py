"""STL files, of text or binary: solids are sets of cells, normals follow from the triangles."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.change import Change
from odt_plugins.adapters.formats.titles import CONTROL, written
from odt_plugins.errors import MeshFileError

HEADER, RECORD = 80, np.dtype(
    [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
"""Bytes at the begin of a binary file, and a triangle in it."""

ATTRIBUTE = "stl:attribute"
"""Array of the two bytes that a binary file has for every triangle, where some are not zero."""

NUMBER = rb"(\S+)\s+"
FACET = re.compile(
    rb"facet\s+normal\s+\S+\s+\S+\s+\S+\s+outer\s+loop\s+"
    + 3 * (rb"vertex\s+" + 3 * NUMBER) + rb"endloop\s+endfacet\b", re.IGNORECASE)
SOLID = re.compile(rb"^[ \t]*solid\b[ \t]*([^\r\n]*)", re.IGNORECASE | re.MULTILINE)


def read(path: Path) -> Any:
    """Read triangles, vertices of equal coordinates as one; several solids become sets of cells.

    Raises
    ------
    MeshFileError    the file ends within a triangle or a solid
    """
    data = path.read_bytes()
    count = _binary(data)
    if count is not None:
        rows = np.frombuffer(data, RECORD, count, HEADER + 4)
        arrays = {ATTRIBUTE: [rows["attribute"].copy()]} if rows["attribute"].any() else {}
        return _mesh(rows["corners"], {}, arrays)
    facets = _facets(data)
    words = [found.groups() for found in facets]
    corners = np.array(words, dtype=np.bytes_).astype(np.float64).reshape(-1, 3, 3)
    return _mesh(corners, _solids(data, facets), {})


def rewrite(source: Path, target: Path, change: Change) -> list[str]:
    """Replace the triangles that changed; names, header, attributes and text of others stay."""
    data = source.read_bytes()
    rows, points = change.cells[0], np.asarray(change.after.points)
    cells = np.asarray(change.after.cells[0].data)
    fresh = change.exchanged(0) | change.moved[cells].any(axis=1) | (np.diff(rows, prepend=-1) == 0)
    count = _binary(data)
    if count is not None:
        out = np.frombuffer(data, RECORD, count, HEADER + 4)[rows].copy()
        out["corners"][fresh] = points[cells[fresh]]
        out["normal"][fresh] = _normals(points[cells[fresh]])
        head = data[:HEADER] + np.uint32(len(rows)).astype("<u4").tobytes()
        target.write_bytes(head + out.tobytes() + data[HEADER + 4 + RECORD.itemsize * count:])
        return []
    facets = _facets(data)
    words = _words(change, facets)
    normals = _normals(points[cells])
    parts: list[list[bytes]] = [[] for _ in facets]
    end = b"\r\n" if b"\r\n" in data else b"\n"
    for row, cell, normal, new in zip(rows.tolist(), cells.tolist(), normals, fresh, strict=True):
        text = _facet([words[v] for v in cell], normal, end) if new else facets[row][0]
        parts[row].append(text)
    pieces, at = [], 0
    for found, texts in zip(facets, parts, strict=True):
        gap = data[at:found.start()]
        pieces += [gap if texts else gap.rstrip(), (end + b"  ").join(texts)]
        at = found.end()
    target.write_bytes(b"".join([*pieces, data[at:]]))
    return []


def write(path: Path, mesh: Any, binary: bool | None) -> list[str]:
    """Write the triangles of a mesh, as text unless binary, with sets that part them as solids."""
    kinds = [block.type for block in mesh.cells if len(block.data)]
    lost = [f"cells of type {kind}" for kind in sorted(set(kinds) - {"triangle"})]
    chosen = [i for i, block in enumerate(mesh.cells) if block.type == "triangle"]
    cells = np.concatenate([np.zeros((0, 3), np.int64), *(mesh.cells[i].data for i in chosen)])
    points = np.zeros((len(mesh.points), 3))
    points[:, : np.shape(mesh.points)[1]] = mesh.points
    corners = points[cells]
    normals = _normals(corners)
    if binary:
        out = np.zeros(len(cells), RECORD)
        out["corners"], out["normal"] = corners, normals
        if ATTRIBUTE in mesh.cell_data:
            out["attribute"] = np.concatenate([mesh.cell_data[ATTRIBUTE][i] for i in chosen])
        head = b"binary STL".ljust(HEADER) + np.uint32(len(cells)).astype("<u4").tobytes()
        path.write_bytes(head + out.tobytes())
        return lost
    solid = _parts(mesh, chosen, len(cells))
    with path.open("wb") as file:
        titles = written(solid, CONTROL)
        for key, rows in solid.items():
            name = titles[key]
            file.write(b"solid %s\n" % name.encode())
            for row in rows.tolist():
                words = [[repr(x).encode() for x in v] for v in corners[row].tolist()]
                file.write(b"  " + _facet(words, normals[row], b"\n") + b"\n")
            file.write(b"endsolid %s\n" % name.encode())
    return lost


def _parts(mesh: Any, chosen: list[int], count: int) -> dict[str, NDArray[np.int64]]:
    """Triangles of every set of cells if each is in one; all under no name otherwise."""
    start = np.cumsum([0, *(len(mesh.cells[i].data) for i in chosen)])
    sets = {}
    for name, members in mesh.cell_sets.items():
        rows = []
        for i, first in zip(chosen, start, strict=False):
            here = np.asarray([] if members[i] is None else members[i])
            rows.append(first + (np.flatnonzero(here) if here.dtype == np.bool_ else here))
        sets[name] = np.concatenate([np.zeros(0), *rows]).astype(np.int64)
    found = np.concatenate([np.zeros(0, np.int64), *sets.values()])
    whole = len(found) == count and len(np.unique(found)) == count
    return sets if sets and whole else {"": np.arange(count)}


def _binary(data: bytes) -> int | None:
    """Triangles of a binary file; None of one of text."""
    if len(data) < HEADER + 4:
        return None
    count = int(np.frombuffer(data, "<u4", 1, HEADER)[0])
    whole = len(data) == HEADER + 4 + RECORD.itemsize * count
    # Some writers put bytes behind the triangles; text has no zero byte.
    longer = b"\0" in data[:4096] and len(data) > HEADER + 4 + RECORD.itemsize * count
    return count if whole or longer else None


def _facets(data: bytes) -> list[re.Match[bytes]]:
    facets = list(FACET.finditer(data))
    begun = len(re.findall(rb"\bfacet\b", data, re.IGNORECASE))
    ended = data.rstrip().rpartition(b"\n")[2].lower().lstrip().startswith(b"endsolid")
    if begun != len(facets) or not ended:
        msg = f"it ends within its triangles, after {len(facets)} of them"
        raise MeshFileError(msg)
    return facets


def _solids(data: bytes, facets: list[re.Match[bytes]]) -> dict[str, NDArray[np.int64]]:
    """Triangles of every solid by its name; none for a single one."""
    starts = list(SOLID.finditer(data))
    if len(starts) < 2:
        return {}
    at = np.array([found.start() for found in facets])
    bounds = np.append(np.searchsorted(at, [s.start() for s in starts]), len(facets))
    out: dict[str, NDArray[np.int64]] = {}
    for i, found in enumerate(starts):
        name = found[1].decode(errors="replace").strip() or f"solid {i + 1}"
        name = name if name not in out else f"{name} ({i + 1})"
        out[name] = np.arange(bounds[i], bounds[i + 1])
    return out


def _mesh(corners: NDArray[Any], sets: dict[str, NDArray[np.int64]], arrays: Any) -> Any:
    from meshio import Mesh

    places, first, number = np.unique(
        corners.reshape(-1, 3), axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    points = places[order]
    cells: Any = [("triangle", np.argsort(order)[number.reshape(-1, 3)])]
    if not len(corners):
        cells, sets = [], {}
    return Mesh(points, cells, cell_data=arrays, cell_sets={k: [v] for k, v in sets.items()})


def _normals(corners: NDArray[Any]) -> NDArray[np.float64]:
    """Unit normals (m, 3) of triangles (m, 3, 3); zero for flat ones."""
    wide = corners.astype(np.float64)
    normal = np.cross(wide[:, 1] - wide[:, 0], wide[:, 2] - wide[:, 0])
    length = np.linalg.norm(normal, axis=1)[:, None]
    out: NDArray[np.float64] = np.zeros_like(normal)
    np.divide(normal, length, out=out, where=length > 0.0)
    return out


def _words(change: Change, facets: list[re.Match[bytes]]) -> dict[int, list[bytes]]:
    """Coordinates of every vertex of the result as text, those of the file where it stayed."""
    old = np.asarray(change.before.cells[0].data).ravel()
    vertex, first = np.unique(old, return_index=True)
    moved, number = change.moved, change.number
    out = {}
    for v, at in zip(vertex.tolist(), first.tolist(), strict=True):
        new = int(number[v])
        if new >= 0 and not moved[new]:
            row, corner = divmod(at, 3)
            out[new] = list(facets[row].groups()[3 * corner: 3 * corner + 3])
    points = np.asarray(change.after.points)
    for new in np.flatnonzero(moved).tolist():
        out[new] = [repr(x).encode() for x in points[new].tolist()]
    return out


def _facet(corners: list[list[bytes]], normal: NDArray[np.float64], end: bytes) -> bytes:
    lines = [b"facet normal " + " ".join(f"{x:.9g}" for x in normal).encode(), b"    outer loop"]
    lines += [b"      vertex " + b" ".join(words) for words in corners]
    return end.join([*lines, b"    endloop", b"  endfacet"])
