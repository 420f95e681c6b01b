"""Files that OBJ and PLY files name, materials and pictures of textures, beside copies of these."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

from odt_plugins.adapters.formats.change import Change
from odt_plugins.errors import DataNotKeptWarning, warn

NAMES = re.compile(rb"^[ \t]*(?:mtllib|comment TextureFile)[ \t]+(.*\S)", re.MULTILINE)
"""Lines of an OBJ file, or of the header of a PLY file, that name others."""

PICTURES = re.compile(
    rb"^[ \t]*(?:map_\w+|bump|disp|decal|refl|norm)[ \t]+(.*\S)", re.MULTILINE | re.IGNORECASE)
"""Lines of a file of materials that name pictures, behind options."""

Rewriter = Callable[[Path, Path, Change], list[str]]


def with_named(rewrite: Rewriter) -> Rewriter:
    """Make a rewriter that copies the named files as well; its target is in a work folder."""

    def both(source: Path, target: Path, change: Change) -> list[str]:
        lost = rewrite(source, target, change)
        header = source.read_bytes().partition(b"end_header")[0]
        copy_named(source.parent, target.parent, NAMES.findall(header))
        return lost

    return both


def copy_named(source: Path, work: Path, lines: list[bytes]) -> None:
    """Copy the files that lines name into a work folder, and the pictures that these name.

    Those that are in the folder around it stay, as where it is `source`.

    Warns
    -----
    DataNotKeptWarning    a file is in another folder than the one that names it
    """
    for name in _there(source, lines):
        file, place = source / name, work.parent / name
        if place.exists():
            continue
        if Path(name).name != name:
            warn(f"{name} is not copied beside the result, which names it", DataNotKeptWarning)
            continue
        shutil.copyfile(file, work / name)
        if file.suffix.lower() == ".mtl":
            copy_named(source, work, PICTURES.findall(file.read_bytes()))


def _there(folder: Path, lines: list[bytes]) -> list[str]:
    """Names of files, from a folder on, among the words of lines and what lines end with."""
    found: dict[str, None] = {}
    for line in lines:
        words = line.decode(errors="replace").split()
        ends = (" ".join(words[i:]) for i in range(len(words)))
        found |= dict.fromkeys(name for name in (*ends, *words) if (folder / name).is_file())
    return list(found)
