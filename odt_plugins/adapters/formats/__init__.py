"""Mesh files whose unchanged parts stay as they are: one file a format, or a family of formats.

A format has a reader, which takes a path and gives a meshio.Mesh, or a rewriter, or both. A
rewriter makes the target out of the source: with the points, the optimised cells and the arrays
of the result, and all else as the source has it.

Sources
-------
Exodus: L. Schoof, V. Yarberry, EXODUS II: A Finite Element Data Model, SAND92-2137 (1994).
MED: MED file format 4.1, EDF and CEA, documentation of the Salome platform.
MEDIT: P. Frey, Medit, an interactive mesh visualization software, INRIA RT-0253 (2001).
OBJ: Wavefront, Appendix B1, Object Files (1995). OFF: Geomview manual, chapter on its formats.
PLY: G. Turk, The PLY Polygon File Format (1994). STL: 3D Systems, StereoLithography Interface
Specification (1989). XDMF: XDMF model and format, version 3, xdmf.org.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from odt_plugins.adapters.formats import (
    exodus,
    exodus_copy,
    exodus_write,
    med,
    med_copy,
    medit,
    obj,
    off,
    ply,
    stl,
    vol,
    xdmf,
    xdmf_copy,
)
from odt_plugins.adapters.formats.change import Change

READERS: dict[str, Callable[[Path], Any]] = {
    "exodus": exodus.read, "med": med.read, "medit": medit.read, "obj": obj.read,
    "off": off.read, "ply": ply.read, "stl": stl.read, "xdmf": xdmf.read,
}
"""Readers that take the place of meshio's, by the name of the format in meshio."""

REWRITERS: dict[str, Callable[[Path, Path, Change], list[str]]] = {
    "exodus": exodus_copy.rewrite, "med": med_copy.rewrite, "medit": medit.rewrite,
    "netgen": vol.rewrite, "obj": obj.rewrite, "off": off.rewrite, "ply": ply.rewrite,
    "stl": stl.rewrite, "xdmf": xdmf_copy.rewrite,
}
"""Rewriters by the name of the format in meshio: source, target and change, to what is lost."""

WRITERS: dict[str, Callable[[Path, Any, bool | None], list[str]]] = {
    "exodus": exodus_write.write, "ply": ply.write, "stl": stl.write,
}
"""Writers that take the place of meshio's: path, mesh and whether binary, to what is lost."""
