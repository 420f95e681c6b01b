"""The objects that callers bring: arrays of many types, and those of the toolkits."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import Any, NamedTuple

import contract
import meshio
import numpy as np

from attack.judge import Mesh, places
from attack.shapes import RandomMesh

Rng = np.random.Generator

NOT_ANY = ("dlpack", "file", "gmsh", "netgen", "ngsolve", "skfem")
"""Hosts that are none here, or whose objects cannot be made of any mesh with any labels."""


class Caller(NamedTuple):
    """An object, and how it is read.

    Attributes
    ----------
    mesh : object              what is optimised
    view : callable            reads it or the result by its own means, a Mesh
    labels : (m,) or None      to be given as the option `regions`
    data_faults : callable     (before, after, names of what may change): what was not kept
    """

    mesh: Any
    view: Callable[[Any], Mesh]
    labels: np.ndarray | None
    data_faults: Callable[[Any, Any, tuple[str, ...]], list[str]]


def random_caller(mesh: RandomMesh, rng: Rng) -> Caller:
    """A mesh as an object of a toolkit with data of every kind, or as arrays of any type."""
    labels = mesh.labels
    d = mesh.cells.shape[1] - 1
    names = contract.CURVED if mesh.points.shape[1] > d else contract.HOSTS
    hosts = [name for name in names
             if contract.HOSTS[name].dim == d and not name.startswith(NOT_ANY)]
    sound = mesh.cells.size and 0 <= mesh.cells.min() <= mesh.cells.max() < len(mesh.points)
    if sound and rng.random() < 0.25 and (labels is None or len(labels) == len(mesh.cells)):
        return _of_toolkit(str(rng.choice(hosts)), mesh)
    if sound and labels is None and rng.random() < 0.1:
        return _with_others(mesh, rng)
    kinds = [np.float32] * 8 + [np.float64, np.float16, np.longdouble, np.int64, ">f8"]
    points = mesh.points
    if rng.random() < 0.3:
        kind = np.dtype(kinds[rng.integers(len(kinds))])
        if kind.kind == "i":
            extent = float(np.ptp(points))
            share = points / extent if 1e-300 < extent < np.inf else 0.0 * np.nan_to_num(points)
            points = np.round(np.clip(share * 1000, -1e9, 1e9))
        with np.errstate(all="ignore"):
            points = points.astype(kind)
    if rng.random() < 0.1:
        points = np.asfortranarray(points)
    index = [np.int32, np.uint16, np.uint64, np.float64, ">i4", np.int8]
    cells = mesh.cells
    if rng.random() < 0.3:
        with np.errstate(all="ignore"):
            cells = cells.astype(index[rng.integers(len(index))])
    container = tuple if rng.random() < 0.7 else list
    parts = [points, cells]
    apart = labels
    if labels is not None and rng.random() < 0.5:
        parts.append(labels.astype(rng.choice(["i4", "i8", "i2", "f8"])))
        apart = None

    def view(found: Any) -> Mesh:
        return Mesh(np.asarray(found[0]), np.asarray(found[1]),
                    np.asarray(found[2]) if len(found) == 3 else apart if found is caller else None)

    def faults(old: Any, new: Any, _interpolated: tuple[str, ...]) -> list[str]:
        same = type(old) is type(new) and len(new) == len(old) + (apart is not None)
        same = same and old[0].dtype == new[0].dtype and old[1].dtype.kind == new[1].dtype.kind
        return [] if same else ["another type came back"]

    caller = container(parts)
    return Caller(caller, view, apart, faults)


def _of_toolkit(name: str, mesh: RandomMesh) -> Caller:
    """An object of a toolkit with data of every kind, as the tests of the adapters make them."""
    host = contract.HOSTS[name]
    labels = np.zeros(len(mesh.cells), dtype=int) if mesh.labels is None else mesh.labels

    def view(found: Any) -> Mesh:
        # The normals of flat cells, which some views make unit vectors of.
        with np.errstate(all="ignore"):
            seen = host.view(found)
        return Mesh(seen.points, seen.cells, seen.cell_data[host.region] if host.region else None)

    def faults(old: Any, new: Any, interpolated: tuple[str, ...]) -> list[str]:
        with np.errstate(all="ignore"):
            a, b = host.view(old), host.view(new)
        found = []
        for kind in ("point_data", "cell_data", "field_data"):
            x, y = getattr(a, kind), getattr(b, kind)
            if sorted(x) != sorted(y) or any(not _alike(x[k].dtype, y[k].dtype) for k in x):
                found.append(f"{kind} {sorted(x)} came back as {sorted(y)}")
            if kind == "point_data" and len(a.points) == len(b.points) and not found:
                still = (a.points == b.points).all(axis=1) & ("fields" not in interpolated)
                rows = {k: still | (x[k].dtype.kind != "f" and k != "colour") for k in x}
                found += [f"point data {k} changed" for k, row in rows.items()
                           if k not in interpolated and not np.array_equal(x[k][row], y[k][row])]
        return found

    with np.errstate(all="ignore"):
        return Caller(host.make((mesh.points, mesh.cells, labels)), view, None, faults)


def _alike(old: np.dtype, new: np.dtype) -> bool:
    """Whether types of data are the same, but for texts, whose types tell the longest of them."""
    return old == new or old.kind == new.kind == "U"


def _same_vertices(old: np.ndarray, new: np.ndarray, *, removed: bool) -> bool:
    """Whether numbers of vertices are as before, less those that may be removed before them."""
    if not removed:
        return np.array_equal(old, new)
    falls = (old - new).ravel()[np.argsort(old, axis=None)]
    return bool((np.diff(falls, prepend=0) >= 0).all())


def _with_others(mesh: RandomMesh, rng: Rng) -> Caller:
    """A meshio.Mesh with lines, triangles and vertices beside the cells: they must stay faces."""
    kinds = {4: "tetra", 3: "triangle", 2: "line", 1: "vertex"}
    size = mesh.cells.shape[1]
    blocks = [(kinds[size], mesh.cells)]
    for k in range(1, size):
        if rng.random() < 0.6:
            rows = mesh.cells[rng.integers(len(mesh.cells), size=rng.integers(1, 6))]
            blocks.insert(rng.integers(len(blocks) + 1),
                          (kinds[k], np.array([rng.permutation(row)[:k] for row in rows])))

    def view(found: Any) -> Mesh:
        return Mesh(found.points, found.cells_dict[kinds[size]])

    def faults(old: Any, new: Any, changing: tuple[str, ...]) -> list[str]:
        found = []
        for a, b in zip(old.cells, new.cells, strict=True):
            k = a.data.shape[1]
            if a.type != b.type or (k < size and a.data.shape != b.data.shape):
                found.append(f"{len(a.data)} {a.type} came back as {len(b.data)} {b.type}")
            elif k < size and not _same_vertices(a.data, b.data, removed="vertices" in changing):
                found.append(f"{a.type} cells have other vertices")
            elif 1 < k < size:
                # Of a surface that is a soup vertices at the same place are as good as each other.
                name = places(new.points) if size == 3 else np.arange(len(new.points))
                faces = {f for row in name[new.cells_dict[kinds[size]]].tolist()
                         for f in combinations(sorted(row), k)}
                if any(tuple(sorted(row)) not in faces for row in name[b.data].tolist()):
                    found.append(f"a {a.type} is no face any more")
        return found

    return Caller(meshio.Mesh(mesh.points, blocks), view, None, faults)
