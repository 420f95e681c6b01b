"""MEDIT solutions, .sol and .solb beside .mesh and .meshb: numbers, vectors, tensors of vertices.

A symmetric tensor is m11 m12 m22 in the plane and m11 m12 m22 m13 m23 m33 in space, as
:mod:`odt_plugins.engine.cells.tensors` packs it; any other one has its rows.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import DataNotKeptWarning, MeshFileError, warn

NAME = "sol"
"""Array of the one solution of a file; those of several are sol1, sol2, ..."""

KIND = "SolAtVertices"

AT = ("Vertices", "Edges", "Triangles", "Quadrilaterals", "Tetrahedra", "Prisms", "Hexahedra")
"""What solutions are at."""

CODES = {"Dimension": 3, "End": 54} | {f"SolAt{name}": 62 + i for i, name in enumerate(AT)}
"""Keywords of binary files."""

SUFFIX = {".mesh": ".sol", ".meshb": ".solb"}
"""Suffix of the solutions of a file, tried first; the other one is read as well."""

TEXT = re.compile(rb"#[^\r\n]*")


def widths(dim: int) -> dict[int, int]:
    """How many numbers every type of solution has: number, vector, symmetric and other tensor."""
    return {1: 1, 2: dim, 3: dim * (dim + 1) // 2, 4: dim * dim}


def is_solution(name: str, values: Any, dim: int) -> bool:
    """Whether a point array goes into such a file."""
    array = np.asarray(values)
    wide = 1 if array.ndim == 1 else array.shape[1] if array.ndim == 2 else 0
    return bool(re.fullmatch(rf"{NAME}\d*", name)) and array.dtype.kind == "f" and (
        wide in widths(dim).values())


def read(path: Path, n: int, space: int) -> dict[str, NDArray[np.float64]]:
    """Solutions at the vertices of a mesh, from the file beside it if there is one.

    Parameters
    ----------
    path : path            of the mesh
    n : int                how many vertices it has
    space : int            how many coordinates they have

    Returns
    -------
    dict                   (n,), (n, d), (n, d (d + 1) / 2) or (n, d^2) by their names

    Raises
    ------
    MeshFileError          the file is broken

    Warns
    -----
    DataNotKeptWarning     the file is of another mesh, or has solutions elsewhere than at vertices
    """
    own = SUFFIX.get(path.suffix.lower(), ".sol")
    places = [path.with_suffix(suffix) for suffix in (own, *({".sol", ".solb"} - {own}))]
    there = [place for place in places if place.is_file()]
    if not there:
        return {}
    data = there[0].read_bytes()
    try:
        binary = there[0].suffix == ".solb"
        dim, kinds, table, others = _binary(data) if binary else _text(data)
    except (ValueError, IndexError, KeyError, struct.error) as exc:
        msg = f"{there[0].name} ends before the values that it says, or has others than numbers"
        raise MeshFileError(msg) from exc
    if len(table) != n or not kinds:
        what = f"values for {len(table)} vertices, not for {n}" if kinds else "none at vertices"
        warn(f"{there[0].name} is not read, it has {what}", DataNotKeptWarning)
        return {}
    if others:
        warn(f"{there[0].name} has {', '.join(sorted(others))}, of which nothing is read",
             DataNotKeptWarning)
    out, start = {}, 0
    for i, kind in enumerate(kinds, 1):
        width = widths(dim)[kind]
        part = table[:, start:start + width]
        if (dim, space) == (2, 3):
            part = _in_space(part, kind)
        out[NAME if len(kinds) == 1 else f"{NAME}{i}"] = part[:, 0] if kind == 1 else part
        start += width
    return out


def write(path: Path, dim: int, arrays: Mapping[str, Any]) -> None:
    """Write the solutions among some point arrays beside a mesh file, if there are any."""
    chosen = {name: np.asarray(values, dtype=np.float64) for name, values in arrays.items()
              if is_solution(name, values, dim)}
    if not chosen:
        return
    parts = [chosen[name] for name in sorted(chosen, key=lambda name: int(name[len(NAME):] or 0))]
    parts = [part.reshape(len(part), -1) for part in parts]
    of_width = {width: kind for kind, width in widths(dim).items()}
    kinds = [of_width[part.shape[1]] for part in parts]
    table = np.concatenate(parts, axis=1)
    target = path.with_suffix(SUFFIX.get(path.suffix.lower(), ".sol"))
    if target.suffix == ".solb":
        target.write_bytes(_packed(dim, kinds, table))
        return
    head = f"MeshVersionFormatted 2\n\nDimension {dim}\n\n{KIND}\n{len(table)}\n"
    head += " ".join(map(str, [len(kinds), *kinds])) + "\n"
    body = "\n".join(" ".join(map(repr, row)) for row in table.tolist())
    target.write_text(f"{head}{body}\n\nEnd\n", encoding="ascii")


def _text(data: bytes) -> tuple[int, list[int], NDArray[np.float64], set[str]]:
    """Dimension, types and values (n, ...) of a file of text, and its other solutions."""
    words = TEXT.sub(b"", data).split()
    dim = int(words[words.index(b"Dimension") + 1])
    others = {word.decode("ascii") for word in words if word.startswith(b"SolAt")} - {KIND}
    if KIND.encode() not in words:
        return dim, [], np.zeros((0, 0)), others
    start = words.index(KIND.encode()) + 1
    n, count = int(words[start]), int(words[start + 1])
    kinds = [int(word) for word in words[start + 2:start + 2 + count]]
    width = sum(widths(dim)[kind] for kind in kinds)
    first = start + 2 + count
    plain = [word.replace(b"D", b"e").replace(b"d", b"e") for word in
             words[first:first + n * width]]
    table = np.array(plain, dtype=np.bytes_).astype(np.float64).reshape(n, width)
    return dim, kinds, table, others


def _binary(data: bytes) -> tuple[int, list[int], NDArray[np.float64], set[str]]:
    """As :func:`_text`, of a binary file of either order of bytes."""
    order = "<" if struct.unpack_from("<i", data)[0] == 1 else ">"
    version = struct.unpack_from(order + "i", data, 4)[0]
    place = "q" if version >= 3 else "i"
    dim, at = 0, 8
    kinds: list[int] = []
    table, others = np.zeros((0, 0)), set()
    names = {code: name for name, code in CODES.items()}
    head = struct.calcsize("<i" + place)
    # Those of mmg end with a code alone, behind which there is no place.
    while not kinds or at + head <= len(data):
        code, following = struct.unpack_from(order + "i" + place, data, at)
        inside = at + head
        name = names.get(code, "")
        if name == "Dimension":
            dim = struct.unpack_from(order + "i", data, inside)[0]
        elif name == KIND:
            size = "q" if version >= 4 else "i"
            n, count = struct.unpack_from(order + size + "i", data, inside)
            inside += struct.calcsize("<" + size + "i")
            kinds = list(struct.unpack_from(order + f"{count}i", data, inside))
            width = sum(widths(dim)[kind] for kind in kinds)
            real = np.dtype(order + ("f4" if version == 1 else "f8"))
            found = np.frombuffer(data, real, n * width, inside + 4 * count)
            table = found.astype(np.float64).reshape(n, width)
        elif name.startswith("SolAt"):
            others.add(name)
        if name == "End" or following <= at:
            break
        at = following
    return dim, kinds, table, others


def _in_space(part: NDArray[np.float64], kind: int) -> NDArray[np.float64]:
    """Vectors and tensors of the plane in space, 0 normal to it."""
    if kind == 4:
        return np.pad(part.reshape(-1, 2, 2), ((0, 0), (0, 1), (0, 1))).reshape(-1, 9)
    return np.pad(part, ((0, 0), (0, widths(3)[kind] - part.shape[1])))


def _packed(dim: int, kinds: list[int], table: NDArray[np.float64]) -> bytes:
    """A binary file of version 2: code, where the next one starts, and what belongs to it."""
    first = 8 + 12
    head = struct.pack("<iiiii", 1, 2, CODES["Dimension"], first, dim)
    body = struct.pack(f"<ii{len(kinds)}i", len(table), len(kinds), *kinds)
    body += table.astype("<f8").tobytes()
    following = first + 8 + len(body)
    return head + struct.pack("<ii", CODES[KIND], following) + body + struct.pack(
        "<ii", CODES["End"], 0)
