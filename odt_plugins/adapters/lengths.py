"""Whether arrays and sets have as many entries as there are vertices or cells."""

from __future__ import annotations

from collections.abc import Container, Sequence
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import InvalidMeshError, UnsupportedMeshError, counted, plain_values

NOT_CELL_INDICES = ("gmsh:bounding_entities",)
"""Cell sets that hold something else than indices of cells."""


def expect_one_each(
    name: str, values: Any, count: int, word: str, plural: str | None = None
) -> NDArray[Any]:
    """The values as an array of one entry for each of so many things, which `word` calls.

    Raises
    ------
    InvalidMeshError    there are more or fewer, or some of a masked array are masked
    """
    found = np.asarray(plain_values(name, values, InvalidMeshError))
    if found.shape[:1] != (count,):
        have = counted(len(found) if found.ndim else 0, "entry", "entries")
        msg = f"{name} has {have} for {counted(count, word, plural)}; expected one a {word}"
        raise InvalidMeshError(msg)
    return found


def of_one_shape(name: str, parts: Sequence[Any]) -> list[NDArray[Any]]:
    """Cell data of several blocks, of which (m,) and (m, 1) are alike, and none is of any shape.

    Raises
    ------
    InvalidMeshError    they have other shapes
    """
    arrays = [*map(np.asarray, parts)]
    if len({array.shape[1:] for array in arrays}) < 2:
        return arrays
    arrays = [array.ravel() if array.size == len(array) else array for array in arrays]
    shapes = {array.shape[1:] for array in arrays if len(array)}
    if len(shapes) > 1:
        msg = (f"cell data {name!r} has blocks of shapes "
               f"{' and '.join(sorted(str(array.shape) for array in arrays))}; expected as many "
               f"numbers for each cell, try an array for each shape")
        raise InvalidMeshError(msg)
    return [array.reshape(-1, *next(iter(shapes), ())) for array in arrays]


def alike(mesh: Any) -> Any:
    """A meshio.Mesh whose cell data have one shape in all blocks; it itself where they have."""
    parts = {name: of_one_shape(name, values) for name, values in mesh.cell_data.items()}
    if all(part.shape == np.shape(own) for name, values in mesh.cell_data.items()
           for part, own in zip(parts[name], values, strict=True)):
        return mesh
    out = copy(mesh)
    out.cell_data = parts
    return out


def from_start(members: NDArray[Any], size: int) -> NDArray[Any]:
    """Indices from the start, where negative ones are from the end as in NumPy; a mask as it is."""
    if members.dtype == np.bool_:
        return members
    wide = members.astype(np.int64) if members.dtype.kind in "iu" else members
    return np.where(wide < 0, wide + size, wide)


def expect_members(what: str, members: NDArray[Any], size: int) -> None:
    """See whether members are indices of so many things, or a mask of them.

    Raises
    ------
    InvalidMeshError    they are neither
    """
    if members.dtype == np.bool_ and members.shape == (size,):
        return
    bad = members[(members < 0) | (members >= size)]
    if members.dtype == np.bool_ or bad.size:
        has = f"a mask of shape {members.shape}" if members.dtype == np.bool_ else (
            f"index {bad[0]} ({bad.size} out of range)")
        msg = (f"{what.format(has)}; expected indices from 0 to {size - 1} or a mask of shape "
               f"({size},)")
        raise InvalidMeshError(msg)


def check_arrays_of_vtk(mesh: Any) -> None:
    """See whether all arrays with a name can be read and have a value for each point or cell.

    VTK leaves out what an array has beyond.

    Parameters
    ----------
    mesh : pyvista mesh, or Dataset of VTK

    Raises
    ------
    InvalidMeshError        one is too short
    UnsupportedMeshError    one holds neither numbers nor texts
    """
    for word, data, count in (("point", mesh.point_data, mesh.n_points),
                              ("cell", mesh.cell_data, mesh.n_cells)):
        for array in map(data.VTKObject.GetAbstractArray, data.keys()):
            name = f"{word} data {array.GetName()!r}"
            if not (array.IsA("vtkDataArray") or array.IsA("vtkStringArray")):
                msg = (f"got {name} in a {array.GetClassName()}; expected numbers or texts, try "
                       f"removing it")
                raise UnsupportedMeshError(msg)
            if array.GetNumberOfTuples() < count:
                expect_one_each(name, range(array.GetNumberOfTuples()), count, word)


def check_lengths(mesh: Any, chosen: Container[int]) -> None:
    """See whether all arrays and sets of a meshio.Mesh are of its points and cells.

    Parameters
    ----------
    mesh : meshio.Mesh
    chosen : container of int    blocks whose cells need data; others may have None

    Raises
    ------
    InvalidMeshError             they are not
    """
    n, sizes = len(mesh.points), [len(block.data) for block in mesh.cells]
    for name, values in mesh.point_data.items():
        expect_one_each(f"point data {name!r}", values, n, "point")
    for name, members in mesh.point_sets.items():
        given = from_start(np.asarray([] if members is None else members), n)
        expect_members(f"point set {name!r} has {{}}", given, n)
    for kind, data in (("data", mesh.cell_data), ("set", mesh.cell_sets)):
        for name, parts in data.items():
            if name in NOT_CELL_INDICES:
                continue
            have = len(parts) if hasattr(parts, "__len__") else 0
            if have != len(sizes):
                msg = (f"cell {kind} {name!r} has {counted(have, 'block')} for a mesh of "
                       f"{len(sizes)}; expected one each")
                raise InvalidMeshError(msg)
            for i, (own, size) in enumerate(zip(parts, sizes, strict=True)):
                if kind == "set":
                    expect_members(f"cell set {name!r} has {{}} in block {i}",
                                   np.asarray([] if own is None else own), size)
                elif own is not None or i in chosen:
                    expect_one_each(f"cell data {name!r} of block {i}", own, size, "cell")
