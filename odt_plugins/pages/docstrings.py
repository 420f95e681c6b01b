"""Docstrings as Sphinx reads them: types and meanings, which stand in one line here, apart."""

from __future__ import annotations

import re
from typing import Any

TABLES = ("Parameters", "Attributes", "Returns", "Raises", "Warns")
"""Sections whose entries begin at the left, with the meaning behind two or more spaces."""

MARKED = re.compile(r"``|^\s*(>>>|\.\.\.)")
"""Lines with words that stay as they are."""

ENTRY = re.compile(r"(\S.*?)\s{2,}(\S.*)")


def apart(lines: list[str]) -> list[str]:
    """Put the meaning of an entry below its name and type; bars of absolute values are no markup.

    Parameters
    ----------
    lines : list of str    of a docstring, without its common indentation
    """
    out: list[str] = []
    section, split = "", False
    for i, given in enumerate(lines):
        line = given if MARKED.search(given) else given.replace("|", r"\|")
        below = lines[i + 1] if i + 1 < len(lines) else ""
        if below and set(below) == {"-"} and not line.startswith(" "):
            section, split = line.strip(), False
        found = ENTRY.fullmatch(line) if section in TABLES else None
        if found:
            out += [found[1], f"    {found[2]}"]
            split = True
        elif split and line.startswith(" "):
            out.append(f"    {line.strip()}")
        else:
            split = split and not line.strip()
            out.append(line)
    return out


def process(_app: Any, _what: str, _name: str, _object: Any, _how: Any, lines: list[str]) -> None:
    """Do so before Sphinx looks for sections."""
    lines[:] = apart(lines)


def setup(app: Any) -> None:
    """Connect :func:`process`, as Sphinx asks its extensions to."""
    app.connect("autodoc-process-docstring", process, priority=400)
