"""Mesh files whose unchanged parts stay as they are: one file a format, or a family of formats.

A format has a reader, which takes a path and gives a meshio.Mesh, or a rewriter, or both. A
rewriter makes the target out of the source: with the points, the optimised cells and the arrays
of the result, and all else as the source has it.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from odt_plugins.adapters.formats.change import Change

READERS: dict[str, Callable[[Path], Any]] = {}
"""Readers that take the place of meshio's, by the name of the format in meshio."""

REWRITERS: dict[str, Callable[[Path, Path, Change], list[str]]] = {}
"""Rewriters by the name of the format in meshio: source, target and change, to what is lost."""
