"""Options that name an array of a mesh file, or a file of indices."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from odt_plugins.errors import InvalidOptionError
from odt_plugins.options import DENSITIES

Refused = Callable[[str, str], Exception]
"""Makes an error of the name of an option and of what is wrong with its value."""

MASKS = {"fixed": "point", "selection": "cell"}
"""Options that hold a mask, and where an array that they name is."""


def wrong_option(option: str, what: str) -> Exception:
    """The error of a value that is none of an option."""
    return InvalidOptionError(f"{option}: {what}")


def resolve_named(
    source: Path, options: dict[str, Any], refused: Refused = wrong_option
) -> dict[str, Any]:
    """Replace names of arrays of a file, and of files of indices, by their values.

    Parameters
    ----------
    source : path         of the mesh file
    options : dict        of :func:`odt_plugins.optimize`; values that are no texts stay
    refused : callable    makes the error of a name that names nothing, or no such array
    """
    from odt_plugins.adapters import files

    options = dict(options)
    host = None
    if options.get("density", DENSITIES[0]) not in DENSITIES:
        host = files.read(source)
        options["density"] = _file_array(
            host, options["density"], "density", ("point", "cell"), refused)
    for name, place in MASKS.items():
        given = options.get(name)
        if not isinstance(given, str):
            continue
        if Path(given).is_file():
            options[name] = _indices(Path(given), name, refused)
        else:
            host = host or files.read(source)
            options[name] = _file_array(host, given, name, (place,), refused) != 0
    return options


def _file_array(
    host: Any, name: str, option: str, places: tuple[str, ...], refused: Refused
) -> Any:
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
            raise refused(option, msg)
        return values
    what = " or ".join(places)
    file = "" if option == "density" else " or a file of indices"
    raise refused(option, f"got {name!r}; expected the name of a {what} array of INPUT{file}, it "
                          f"has {', '.join(known) or 'none'}")


def _indices(path: Path, option: str, refused: Refused) -> Any:
    """Read indices from a .npy file or from text, one or more on a line, # for remarks."""
    try:
        if path.suffix == ".npy":
            values = np.load(path, allow_pickle=False)
        else:
            words = [line.partition("#")[0].split()
                     for line in path.read_text(encoding="utf-8-sig").splitlines()]
            values = np.array([int(w) for line in words for w in line], dtype=np.int64)
    except (OSError, ValueError, EOFError) as exc:
        what = " ".join(str(exc).split())
        msg = f"cannot read indices from {path}: {what}; expected whole numbers or .npy"
        raise refused(option, msg) from exc
    if not values.size:
        raise refused(option, f"{path} holds no index; expected at least one, leave out --{option} "
                              "to give none")
    return values
