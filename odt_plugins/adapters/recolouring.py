"""Colours of vertices and of cells, which files of surfaces have under names of their own."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats import obj, off, ply

OPAQUE = 255
"""Alpha of what cannot be seen through."""


def recoloured(mesh: Any, name: str) -> Any:
    """A mesh whose colours have the names and the type that a format has for them.

    Parameters
    ----------
    mesh : meshio.Mesh    not changed
    name : str            of the format in meshio; those that have no names of their own take all
    """
    if name not in ("obj", "off", "ply"):
        return mesh
    out = mesh.copy()
    sizes = [len(block.data) for block in mesh.cells]
    points, names = _colours(mesh.point_data)
    if points is not None:
        out.point_data = {key: values for key, values in out.point_data.items() if key not in names}
        out.point_data |= _named(points, name)
    joined = {key: np.concatenate([np.asarray(part) for part in values])
              for key, values in mesh.cell_data.items() if sizes}
    cells, names = _colours(joined)
    if cells is not None and name != "obj":
        out.cell_data = {key: values for key, values in out.cell_data.items() if key not in names}
        out.cell_data |= {key: np.split(values, np.cumsum(sizes)[:-1])
                          for key, values in _named(cells, name).items()}
    return out


def _colours(arrays: dict[str, Any]) -> tuple[NDArray[np.uint8] | None, tuple[str, ...]]:
    """Bytes (n, 3) or (n, 4) of the first colours among arrays, and the names of these."""
    red, *_, alpha = ply.COLOURS
    if all(np.asarray(arrays.get(key, 0.0)).dtype == np.uint8 for key in ply.COLOURS[:3]):
        names = ply.COLOURS if alpha in arrays else ply.COLOURS[:3]
        return np.stack([np.asarray(arrays[key]) for key in names], axis=1), names
    for key, given in arrays.items():
        values = np.asarray(given)
        if values.ndim != 2 or values.shape[1] not in (3, 4) or red in arrays:
            continue
        if values.dtype == np.uint8:
            return values, (key,)
        known = key in (obj.COLOURS, off.COLOURS) and values.dtype.kind == "f"
        if known and values.size and 0.0 <= values.min() and values.max() <= 1.0:
            return np.rint(values * 255.0).astype(np.uint8), (key,)
    return None, ()


def _named(colours: NDArray[np.uint8], name: str) -> dict[str, NDArray[Any]]:
    """Colours as arrays of a format; alpha remains one by itself where it has no place."""
    if name == "ply":
        return dict(zip(ply.COLOURS, colours.T, strict=False))
    if name == "off":
        return {off.COLOURS: colours}
    clear = colours.shape[1] == 4 and bool((colours[:, 3] != OPAQUE).any())
    alpha = {ply.COLOURS[3]: colours[:, 3]} if clear else {}
    return {obj.COLOURS: colours[:, :3] / 255.0} | alpha
