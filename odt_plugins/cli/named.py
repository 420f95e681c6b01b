"""Values of flags that name an array of the input or a file of indices."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click


def resolve_arrays(source: Path, options: dict[str, Any]) -> dict[str, Any]:
    """Replace names of arrays and of index files by their values."""
    from odt_plugins.distributed.named import resolve_named

    return resolve_named(source, options, lambda option, what: click.BadParameter(
        what, param_hint=f"--{option}"))
