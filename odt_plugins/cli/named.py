"""Values of flags that name an array of the input or a file of indices."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

from odt_plugins.cli.terminal import one_line
from odt_plugins.options import DENSITIES


def resolve_arrays(source: Path, options: dict[str, Any]) -> dict[str, Any]:
    """Replace names of arrays and of index files by their values."""
    from odt_plugins.adapters import files

    options = dict(options)
    host = None
    if options.get("density", DENSITIES[0]) not in DENSITIES:
        host = files.read(source)
        options["density"] = _file_array(host, options["density"], "density", "point", "cell")
    for name, place in (("fixed", "point"), ("selection", "cell")):
        given = options[name]
        if given is None:
            continue
        if Path(given).is_file():
            options[name] = _indices(Path(given), name)
        else:
            host = host or files.read(source)
            options[name] = _file_array(host, given, name, place) != 0
    return options


def _file_array(host: Any, name: str, option: str, *places: str) -> Any:
    """Take a point array (n,) or a cell array (m,) of a mesh file by its name."""
    mesh, known = host.source, []
    for place in places:
        data = mesh.point_data if place == "point" else mesh.cell_data
        known += [f"{key} ({place})" for key in data]
        if name not in data:
            continue
        values = np.asarray(data[name]) if place == "point" else np.concatenate(
            [np.asarray(data[name][block]) for block in host.layout])
        bad = np.flatnonzero(values != values)
        msg = ""
        if values.ndim != 1:
            msg = f"array {name!r} has shape {values.shape}; expected one value for each"
        elif values.dtype.kind not in "biuf":
            msg = f"array {name!r} has type {values.dtype}; expected numbers"
        elif bad.size and option != "density":
            msg = f"array {name!r} is nan at index {bad[0]} ({bad.size} of them); expected numbers"
        if msg:
            raise click.BadParameter(msg, param_hint=f"--{option}")
        return values
    what = " or ".join(places)
    file = "" if option == "density" else " or a file of indices"
    msg = (f"got {name!r}; expected the name of a {what} array of INPUT{file}, it has "
           f"{', '.join(known) or 'none'}")
    raise click.BadParameter(msg, param_hint=f"--{option}")


def _indices(path: Path, option: str) -> Any:
    """Read indices from a .npy file or from text, one or more on a line, # for remarks."""
    try:
        if path.suffix == ".npy":
            values = np.load(path, allow_pickle=False)
        else:
            words = [line.partition("#")[0].split()
                     for line in path.read_text(encoding="utf-8").splitlines()]
            values = np.array([int(w) for line in words for w in line], dtype=np.int64)
    except (OSError, ValueError, EOFError) as exc:
        msg = f"cannot read indices from {path}: {one_line(exc)}; expected whole numbers or .npy"
        raise click.BadParameter(msg, param_hint=f"--{option}") from exc
    if not values.size:
        msg = f"{path} holds no index; expected at least one, leave out --{option} to give none"
        raise click.BadParameter(msg, param_hint=f"--{option}")
    return values
