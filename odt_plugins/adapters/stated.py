"""What mesh files say of themselves: the files that they refer to, and how much they hold."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from odt_plugins.errors import MeshFileError

COMMENTS = rb"(?:\s*#[^\n]*\n)*\s*"

VTK_XML = rb"\sNumberOf(?:Points|Cells|Verts|Lines|Strips|Polys|Tuples)\s*=\s*[\"'](\d+)[\"']"

PACKED = 1100
"""Most bytes of data in a byte of a file that is packed by zlib, as the arrays of VTK's are."""

COUNTS = {
    "ansys": rb"\((?:20|30)?1[0-3]\s*\(\s*[\da-fA-F]+\s+[\da-fA-F]+\s+([\da-fA-F]+)",
    "avsucd": rb"\A" + COMMENTS + rb"(\d+)\s+(\d+)",
    "dolfin-xml": rb"<(?:vertices|cells)\s+size\s*=\s*[\"'](\d+)",
    "gmsh": rb"\$(?:Nodes|Elements)\s+(\d+)(?:[ \t]+(\d+)(?:[ \t]+\d+)*)?[ \t]*\r?\n",
    "netgen": rb"\n[ \t]*[a-z][a-z_0-9]+\s+(\d+)",
    "off": rb"\AOFF[^\n]*\n" + COMMENTS + rb"(\d+)\s+(\d+)",
    "ply": rb"\nelement\s+\w+\s+(\d+)",
    "ugrid": rb"\A\s*(\d+)" + 6 * rb"\s+(\d+)",
    "vtp": VTK_XML,
    "vtk": rb"\n(?:POINTS|CELLS|CELL_TYPES|POINT_DATA|CELL_DATA)\s+(\d+)",
    "vtu": VTK_XML,
}
"""Where a format states how many items follow, or the last index."""

REFERENCES = {"abaqus": rb"(?i)\*INCLUDE[^\n=]*=\s*([^\s,]+)",
              "nastran": rb"(?im)^[ \t]*INCLUDE[ \t]+['\"]?([^'\"\r\n]+)",
              "xdmf": rb">\s*([^<>:\s]+):/"}
"""Where a format names another file that belongs to it."""


SAID = (
    (r"(?:could not convert string(?: to float:)?|invalid literal for int\(\) with base \d+:)"
     r" (?:np\.bytes_\()?b?(['\"])(.*?)\1.*", r"it has \2 in place of a number"),
    (r".*(?:inhomogeneous|the number of columns changed|cannot reshape array|zip\(\) argument|"
     r"index out of range|out of bounds|must match exactly|broadcast).*",
     "its lines do not fit together, or some are missing"),
    (r"\[Errno 2\] [^:]*: '(?:.*[\\/])?(.*)'", r"it goes with \1, which is not there"),
    (r"\[Errno -\d+\] (NetCDF: [^']*?): '.*", r"\1"),
)
"""What Python and its libraries say of broken files, and what it means."""

CUT = (r"\bends?\b|declares|announces|incomplete|to its end|\d+ bytes|lines for|\bholds\b|"
       r"truncated|HDF error")
"""What the reason has in it where a file is not whole."""

ELSEWHERE = r"it (?:includes|goes with) .*, which is not there|its data are in .*, which is missing"
"""The reason where another file is missing."""


def expect_counts(path: Path, name: str) -> int:
    """Hold what a file states against its size, before anything is allocated for it.

    Every item takes at least a byte, in each of the formats whose counts are known.

    Parameters
    ----------
    path : path
    name : str     of its format in meshio

    Returns
    -------
    int            bytes of the file and of those that belong to it

    Raises
    ------
    MeshFileError  it states more items than it has bytes
    """
    total = 0
    for part in parts_of(path, name):
        size = part.stat().st_size
        total += size
        # Counts within a packed file say nothing about the size that it is packed to.
        if name not in COUNTS or part.suffix == ".gz":
            continue
        for found in re.finditer(COUNTS[name], part.read_bytes()):
            base = 16 if name == "ansys" else 10
            most = size * PACKED if COUNTS[name] == VTK_XML else size
            if any(int(count, base) > most for count in found.groups() if count):
                said = " ".join(found[0].decode("ascii", "replace").split())
                msg = f"{part.name} says {said[-60:]!r} and has {size} bytes"
                raise MeshFileError(msg)
    return total


def parts_of(path: Path, name: str) -> list[Path]:
    """The files of a mesh that are there: the named one and all to which it refers."""
    if name == "tetgen":
        return [part for part in (path.with_suffix(".node"), path.with_suffix(".ele"))
                if part.is_file()]
    parts = [path]
    if name in REFERENCES:
        for part in parts:
            for other in re.findall(REFERENCES[name], part.read_bytes()):
                named = part.parent / other.decode("utf-8", "replace")
                if named not in parts and named.is_file():
                    parts.append(named)
    return parts


def declares_no_cells(path: Path, formats: Sequence[str]) -> bool:
    """Whether a VTK file says that it has no cells, on which meshio's readers break."""
    patterns = {
        "vtu": rb"""NumberOfCells\s*=\s*["'](\d+)["']""",
        "vtk": rb"""(?m)^CELLS\s+\d+\s+(\d+)\s*$""",
    }
    known = [patterns[name] for name in formats if name in patterns]
    content = path.read_bytes() if known else b""
    counts = [count for pattern in known for count in re.findall(pattern, content)]
    return bool(counts) and not any(int(count) for count in counts)


def meaning_of(reason: str) -> str:
    """What a parser says, in words about the file."""
    for said, meaning in SAID:
        found = re.fullmatch(said, reason)
        if found:
            return found.expand(meaning)
    return reason


def hope_of(reason: str, kinds: str, *, cut: bool) -> str:
    """What is expected, or to be tried, behind the reason for which a file is not read.

    Parameters
    ----------
    reason : str
    kinds : str    the formats as which it was read
    cut : bool     whether it is sure to be incomplete if it is of one of these
    """
    if ", try " in reason:
        return ""
    if "cells of type" in reason:
        return "; try a file without these cells"
    if re.match(ELSEWHERE, reason):
        return "; expected that file, too"
    whole = cut or re.search(CUT, reason) is not None
    return f"; expected {'a complete file' if whole else f'a file that is one of {kinds}'}"
