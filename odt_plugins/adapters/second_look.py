"""What meshio reads of files that VTK wrote: an independent reader sees what VTK's own does not."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.readers import reader_of

WORDS = {b"char": b"vtktypeint8", b"signed_char": b"vtktypeint8", b"unsigned_char": b"vtktypeuint8",
         b"short": b"vtktypeint16", b"unsigned_short": b"vtktypeuint16", b"int": b"vtktypeint32",
         b"unsigned_int": b"vtktypeuint32", b"long": b"vtktypeint64",
         b"unsigned_long": b"vtktypeuint64"}
"""Words of legacy files for which meshio knows others."""

NUMBERS = re.compile(rb"^(\w[^\n\0]* )(" + b"|".join(WORDS) + rb")( \d+)?$", re.MULTILINE)
"""Lines of legacy files that tell the type of the numbers that follow."""

OLD = (b"1", b"2", b"3", b"4")
"""Versions before 5, which programs read that do not know later ones."""


def other_in_meshio(path: Path, name: str, mesh: Any) -> str:
    """Read a file by meshio, and name what is other than VTK reads it.

    In legacy files of version 5 it knows other words for some types of numbers.
    """
    import tempfile
    from urllib.parse import unquote

    with tempfile.TemporaryDirectory() as folder:
        copy = path
        if name == "vtk" and not path.read_bytes()[:40].split()[4].startswith(OLD):
            copy = Path(folder) / path.name
            copy.write_bytes(re.sub(NUMBERS, lambda found: b"%s%s%s" % (
                found[1], WORDS[found[2]], found[3] or b""), path.read_bytes()))
        try:
            other = reader_of(name)(str(copy))
            cells, data = other.cells_dict, other.cell_data_dict
        # It knows less than VTK, such as arrays of text.
        except Exception:
            return ""
    pairs = [("the points", other.points, mesh.points)]
    pairs += [(f"cells of type {kind}", cells.get(kind), nodes)
              for kind, nodes in mesh.cells_dict.items()]
    pairs += [(f"point data {key!r}", values, mesh.point_data.get(unquote(key)))
              for key, values in other.point_data.items()]
    mine = mesh.cell_data_dict
    pairs += [(f"cell data {key!r}", values, mine.get(unquote(key), {}).get(kind))
              for key, parts in data.items() for kind, values in parts.items()]
    return ", ".join(what for what, one, two in pairs if not _alike(np.ravel(one), np.ravel(two)))


def _alike(one: NDArray[Any], two: NDArray[Any]) -> bool:
    """Whether all values are the same, NaN being the same as NaN."""
    numbers = one.dtype.kind in "fc" and two.dtype.kind in "fc"
    return np.array_equal(one, two, equal_nan=numbers)
