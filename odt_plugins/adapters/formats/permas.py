"""PERMAS' files, of which meshio reads nodes and elements: what it leaves out is named."""

from __future__ import annotations

import gzip
import re
from pathlib import Path
from typing import Any

import numpy as np

from odt_plugins.adapters.formats.decks import unread
from odt_plugins.adapters.formats.vol_tables import content

KNOWN = {"ENTER", "STRUCTURE", "COOR", "ELEMENT", "END", "EXIT", "FIN"}
"""Sections that hold the mesh, or only others."""

ORDER = {"triangle6": [0, 3, 1, 4, 2, 5], "tetra10": [0, 4, 1, 5, 2, 6, 7, 8, 9, 3],
         "quad9": [0, 4, 1, 7, 8, 5, 3, 6, 2],
         "wedge15": [0, 6, 1, 7, 2, 8, 9, 10, 11, 3, 12, 4, 13, 5, 14]}
"""Nodes of elements of second order as they follow each other in files, corner by corner."""


def completed(path: Path, mesh: Any) -> Any:
    """A mesh that meshio read, its corners first, with the names of sections that are not in it."""
    data = content(path)
    names = {name.decode().upper() for name in re.findall(rb"(?m)^[ \t]*\$[ \t]*([A-Za-z]\w*)",
                                                          data)}
    for block in mesh.cells:
        if block.type in ORDER:
            block.data = np.asarray(block.data)[:, np.argsort(ORDER[block.type])]
    mesh.info = unread("the sections", names - KNOWN)
    return mesh


def write(path: Path, mesh: Any, binary: bool | None) -> list[str]:
    """Write a mesh by meshio, and pack the file where its suffix says so."""
    import meshio

    del binary
    meshio.write(path, mesh, file_format="permas")
    if path.suffix.lower() == ".gz":
        path.write_bytes(gzip.compress(path.read_bytes()))
    return []
