"""Files of every format that meshio writes, and what may befall them."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path
from typing import Any

import meshio
import numpy as np

FORMATS: dict[str, tuple[str, str, dict[str, Any]]] = {
    "abaqus": (".inp", "abaqus", {}),
    "ansys": (".msh", "ansys", {"binary": True}),
    "ansys text": (".msh", "ansys", {"binary": False}),
    "avs": (".avs", "avsucd", {}),
    "cgns": (".cgns", "cgns", {}),
    "dolfin": (".xml", "dolfin-xml", {}),
    "exodus": (".e", "exodus", {}),
    "flac3d": (".f3grid", "flac3d", {"binary": True}),
    "flac3d text": (".f3grid", "flac3d", {"binary": False}),
    "gmsh 2.2": (".msh", "gmsh22", {"binary": True}),
    "gmsh 2.2 text": (".msh", "gmsh22", {"binary": False}),
    "gmsh 4.1": (".msh", "gmsh", {"binary": True}),
    "gmsh 4.1 text": (".msh", "gmsh", {"binary": False}),
    "h5m": (".h5m", "h5m", {}),
    "hmf": (".hmf", "hmf", {}),
    "mdpa": (".mdpa", "mdpa", {"binary": False}),
    "med": (".med", "med", {}),
    "medit": (".meshb", "medit", {}),
    "medit text": (".mesh", "medit", {}),
    "nastran": (".bdf", "nastran", {}),
    "netgen": (".vol", "netgen", {}),
    "netgen packed": (".vol.gz", "netgen", {}),
    "obj": (".obj", "obj", {}),
    "off": (".off", "off", {}),
    "permas": (".dato", "permas", {}),
    "ply": (".ply", "ply", {"binary": True}),
    "ply text": (".ply", "ply", {"binary": False}),
    "stl": (".stl", "stl", {"binary": True}),
    "stl text": (".stl", "stl", {"binary": False}),
    "su2": (".su2", "su2", {}),
    "tecplot": (".dat", "tecplot", {}),
    "tetgen cells": (".ele", "tetgen", {}),
    "tetgen points": (".node", "tetgen", {}),
    "ugrid": (".b8.ugrid", "ugrid", {}),
    "ugrid text": (".ugrid", "ugrid", {}),
    "vtk 4.2": (".vtk", "vtk42", {"binary": True}),
    "vtk 4.2 text": (".vtk", "vtk42", {"binary": False}),
    "vtk 5.1": (".vtk", "vtk51", {"binary": True}),
    "vtk 5.1 text": (".vtk", "vtk51", {"binary": False}),
    "vtu": (".vtu", "vtu", {"binary": True}),
    "vtu text": (".vtu", "vtu", {"binary": False}),
    "wkt": (".wkt", "wkt", {}),
    "xdmf": (".xdmf", "xdmf", {}),
    "xdmf text": (".xdmf", "xdmf", {"data_format": "XML"}),
}
"""Suffix, name in meshio and options of its writer."""

TRIANGLES = ("off", "obj", "ply", "ply text", "stl", "stl text", "wkt")
"""Formats that hold triangles only; "flac3d", "tetgen" and "cgns" hold tetrahedra only."""


def written(name: str, mesh: meshio.Mesh) -> dict[str, bytes]:
    """Write a mesh as one of FORMATS.

    Returns
    -------
    dict of bytes    files by their names: first the one to be read, then those that go with it

    Raises
    ------
    Exception        anything at all, when the format does not hold such a mesh
    """
    suffix, kind, options = FORMATS[name]
    # Some writers of meshio write what NumPy prints, which was a plain number before NumPy 2.
    with tempfile.TemporaryDirectory() as folder, np.printoptions(legacy="1.25"):
        path = Path(folder) / f"mesh{suffix}"
        meshio.write(path, mesh.copy(), file_format=kind, **options)
        parts = sorted(Path(folder).iterdir(), key=lambda part: part.name != path.name)
        return {part.name: part.read_bytes() for part in parts}


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Do one thing to a file: cut it, change bytes, move lines about, or change a number."""
    return HARMS[rng.integers(len(HARMS))](data, rng)


def _cut(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: _place(data, rng)]


def _hole(data: bytes, rng: np.random.Generator) -> bytes:
    a, b = sorted((_place(data, rng), _place(data, rng)))
    return data[:a] + data[b:]


def _flipped(data: bytes, rng: np.random.Generator) -> bytes:
    out = bytearray(data)
    for _ in range(rng.integers(1, 9)):
        if out:
            out[_place(data, rng)] ^= 1 << rng.integers(8)
    return bytes(out)


def _inserted(data: bytes, rng: np.random.Generator) -> bytes:
    i = _place(data, rng)
    return data[:i] + rng.bytes(rng.integers(1, 20)) + data[i:]


def _cut_at_a_line(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.splitlines(keepends=True)
    return b"".join(lines[: rng.integers(min(len(lines), 30) + 1)])


def _lines_moved(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.splitlines(keepends=True) or [b""]
    i, j = rng.integers(len(lines), size=2)
    line = lines[i]
    if rng.random() < 0.5:
        del lines[i]
    lines.insert(j, line)
    return b"".join(lines)


def _another_number(data: bytes, rng: np.random.Generator) -> bytes:
    """Numbers near the start, where formats state their counts, as often as all others."""
    numbers = list(re.finditer(rb"[-+.\deE]*\d[-+.\deE]*", data))
    if not numbers:
        return data
    some = numbers[:20] if rng.random() < 0.5 else numbers
    found = some[rng.integers(len(some))]
    others = [b"0", b"-1", b"-", b"", b"1", b"7", b"1e5", b"100000", b"2147483648", b"3000000000",
              b"1000000000000", b"99999999999999999999999", b"nan", b"inf", b"1e400", b"x",
              found[0] * 2, found[0][:-1]]
    return data[: found.start()] + others[rng.integers(len(others))] + data[found.end():]


def _another_integer(data: bytes, rng: np.random.Generator) -> bytes:
    """Write an integer of four or eight bytes over those that are there."""
    i = _place(data, rng) // 4 * 4
    number = int(rng.choice([-1, 0, 1, 255, 10**5, 2**31 - 1, 2**40, 2**62]))
    some = number.to_bytes(8, "little", signed=True)[: rng.choice([4, 8])]
    if rng.random() < 0.3:
        some = some[::-1]
    return data[:i] + some + data[i + len(some):]


def _twice(data: bytes, rng: np.random.Generator) -> bytes:
    return data + data[_place(data, rng):]


HARMS = (_cut, _hole, _flipped, _inserted, _cut_at_a_line, _lines_moved, _another_number,
         _another_number, _another_integer, _twice)


def _place(data: bytes, rng: np.random.Generator) -> int:
    """A byte of a file; every other time one near its start, where its header is."""
    near = min(len(data), 400) if rng.random() < 0.5 else len(data)
    return int(rng.integers(max(near, 1)))
