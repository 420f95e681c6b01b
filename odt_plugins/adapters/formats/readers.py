"""The readers of meshio by the names of their formats."""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain
from typing import Any

MODULES = {"dolfin-xml": "dolfin"}
"""Modules that are called otherwise than their formats."""


def readable(name: str) -> bool:
    """Say whether meshio reads files of a format."""
    import meshio

    own = getattr(meshio, MODULES.get(name, name), None)
    return hasattr(own, "read") or name in _others()


def reader_of(name: str) -> Callable[..., Any]:
    """What reads a file of a format that is :func:`readable`."""
    import meshio

    if name in _others():
        return lambda path: meshio.read(path, file_format=name)
    reader: Callable[..., Any] = getattr(meshio, MODULES.get(name, name)).read
    return reader


def _others() -> set[str]:
    """Formats that others have registered."""
    import meshio

    return {name for name in chain(*meshio.extension_to_filetypes.values())
            if not hasattr(meshio, MODULES.get(name, name))}
