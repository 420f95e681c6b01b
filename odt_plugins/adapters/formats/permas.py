"""PERMAS' files, of which meshio reads nodes and elements: what it leaves out is named."""

from __future__ import annotations

import gzip
import re
from pathlib import Path
from typing import Any

from odt_plugins.adapters.formats.decks import unread

KNOWN = {"ENTER", "STRUCTURE", "COOR", "ELEMENT", "END", "EXIT", "FIN"}
"""Sections that hold the mesh, or only others."""


def completed(path: Path, mesh: Any) -> Any:
    """A mesh that meshio read, with the names of the sections that are not in it."""
    data = path.read_bytes()
    data = gzip.decompress(data) if path.suffix == ".gz" else data
    names = {name.decode().upper() for name in re.findall(rb"(?m)^[ \t]*\$[ \t]*([A-Za-z]\w*)",
                                                          data)}
    mesh.info = unread("the sections", names - KNOWN)
    return mesh
