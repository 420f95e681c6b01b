"""Arrays of other libraries, `(points, cells)` or `(points, cells, regions)`: PyTorch, CuPy, JAX,
tensors of open3d.

Any array that has `__dlpack__` is read through it, without a copy where it is in the memory of the
processor. The class of the sequence, kinds and types of the arrays and their devices survive.
Gradients do not: tensors that require them are refused.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters import arrays
from odt_plugins.adapters.host import HostMesh, Result
from odt_plugins.errors import InvalidMeshError, UnsupportedMeshError


def matches(mesh: object) -> bool:
    """Say whether this is a tuple or list of two or three arrays, some of other libraries."""
    return (
        isinstance(mesh, tuple | list)
        and len(mesh) in (2, 3)
        and all(hasattr(part, "__dlpack__") or isinstance(part, list | tuple) for part in mesh)
        and any(hasattr(part, "__dlpack__") for part in mesh)
    )


def read(mesh: Any, regions: str | Sequence[str] | None = None) -> HostMesh:
    """Take the arrays as they are; a third one holds the region labels (m,).

    Raises
    ------
    InvalidMeshError        an array cannot be read
    UnsupportedMeshError    there is no way to make arrays of its kind
    """
    parts = [_as_numpy(part, name) for part, name
             in zip(mesh, ("points", "cells", "regions"), strict=False)]
    same = type(mesh)._make(parts) if hasattr(type(mesh), "_make") else type(mesh)(parts)
    return replace(arrays.read(same, regions), layout=mesh)


def write(result: Result, host: HostMesh) -> Any:
    """Give back a sequence of the same class with arrays of the same kinds, where these were."""
    found = arrays.write(result, host)
    given = [*host.layout, host.layout[1]]
    parts = [_like(old, new) for old, new in zip(given, found, strict=False)]
    return type(found)._make(parts) if hasattr(type(found), "_make") else type(found)(parts)


def _as_numpy(part: Any, name: str) -> Any:
    """The numbers of an array of any library; lists and numpy's own arrays as they are."""
    if isinstance(part, np.ndarray | list | tuple):
        return part
    if _maker(part) is None:
        msg = (f"got {name} of type {type(part).__name__}, of which a library without asarray "
               f"makes no new ones; expected arrays of numpy, try numpy.from_dlpack on each")
        raise UnsupportedMeshError(msg)
    try:
        return np.from_dlpack(part)
    # What a library raises where it cannot export is up to the library.
    except Exception as exc:
        why = " ".join(str(exc).split())
        if hasattr(part, "__dlpack_device__") and int(part.__dlpack_device__()[0]) != 1:
            return _from_device(part, name)
        advice = f"{name}.detach()" if "grad" in why else "converting them to a type of numpy's"
        msg = f"got {name} that numpy cannot read ({why}); try {advice}"
        raise InvalidMeshError(msg) from exc


def _from_device(part: Any, name: str) -> Any:
    """A copy of an array that lies elsewhere, such as on a graphics card.

    Raises
    ------
    InvalidMeshError    there is no way
    """
    for method in ("get", "cpu", "__array__"):
        try:
            found = np.asarray(getattr(part, method)())
        except (AttributeError, TypeError, ValueError, RuntimeError, BufferError):
            continue
        if found.dtype.kind in "biuf":
            return found
    msg = f"got {name} on a device that they cannot be copied from; try copying them to the CPU"
    raise InvalidMeshError(msg)


def _like(old: Any, new: Any) -> Any:
    """An array of the kind of an old one, on its device."""
    if isinstance(old, np.ndarray | list | tuple):
        return new
    values: NDArray[Any] = np.ascontiguousarray(new)
    make: Any = _maker(old)
    if not hasattr(old, "device"):
        return make(values)
    try:
        return make(values, device=old.device)
    except TypeError:
        made = make(values)
        return made.to(old.device) if hasattr(made, "to") else made


def _maker(old: Any) -> Any:
    """What makes arrays of the kind of one of another library; None where nothing does."""
    library = (old.__array_namespace__() if hasattr(old, "__array_namespace__")
               else sys.modules[type(old).__module__.partition(".")[0]])
    return getattr(library, "asarray", None) or getattr(old, "from_numpy", None)
