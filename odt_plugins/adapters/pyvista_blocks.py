"""pyvista.MultiBlock, also nested: every block of tetrahedra by itself, or else of triangles.

Everything survives: names and order of the blocks, field data, in each block what
:mod:`odt_plugins.adapters.pyvista_mesh` keeps. All other blocks come back as copies: None, images,
and surfaces and lines beside blocks of tetrahedra. Blocks that touch still do, since the boundary
of each stays; where it would slide they are refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters import pyvista_mesh
from odt_plugins.adapters.host import HostMesh, Result, is_instance
from odt_plugins.errors import UnsupportedMeshError, counted

PART, PARTS = "block", "blocks"
"""What a part is called, and several of them."""

TOGETHER = "mesh.combine(merge_points=True) with an array of labels"
"""What makes one mesh of blocks that touch."""

Path = tuple[int, ...]
"""Where a block stands: its index in every MultiBlock on the way to it."""


def matches(mesh: object) -> bool:
    """Say whether this is a pyvista MultiBlock."""
    return is_instance(mesh, "pyvista", "MultiBlock")


def read(mesh: Any, regions: str | Sequence[str] | None = None) -> NoReturn:
    """Refuse what needs a single mesh."""
    msg = (f"got a MultiBlock of {counted(mesh.n_blocks, 'block')} where a single mesh is needed, "
           f"try mesh.combine().triangulate()")
    raise UnsupportedMeshError(msg)


def write(result: Result, host: HostMesh) -> NoReturn:
    """Refuse: :func:`replaced` makes the result."""
    raise NotImplementedError


def chosen(mesh: Any) -> dict[Path, str]:
    """Places and names of the blocks to optimise.

    Raises
    ------
    UnsupportedMeshError    there are none
    """
    found = {path: (name, _dimension(block)) for path, name, block in _leaves(mesh)}
    most = max((dim for _, dim in found.values()), default=0)
    if most == 0:
        msg = (f"got a MultiBlock of {counted(mesh.n_blocks, 'block')} without tetrahedra and "
               f"triangles; expected at least one, try mesh.combine().triangulate()")
        raise UnsupportedMeshError(msg)
    return {path: name for path, (name, dim) in found.items() if dim == most}


def part_at(mesh: Any, path: Path) -> Any:
    """The block at a place."""
    for i in path:
        mesh = mesh[i]
    return mesh


def placed(mesh: Any, path: Path, points: NDArray[Any]) -> list[NDArray[np.float64]]:
    """Where points (n, 3) of a block lie in the whole."""
    return [np.asarray(points, dtype=np.float64)]


def replaced(mesh: Any, results: dict[Path, Any]) -> Any:
    """Copy the caller's object and put the results in the places of the blocks."""
    out = _copied(mesh)
    for path, block in results.items():
        part_at(out, path[:-1]).replace(path[-1], block)
    return out


def _copied(mesh: Any) -> Any:
    """A deep copy, block by block: pyvista makes none of tables that stand deeper than here."""
    if mesh is None or not matches(mesh):
        return mesh if mesh is None else mesh.copy(deep=True)
    out = type(mesh)()
    out.n_blocks = mesh.n_blocks
    for i in range(mesh.n_blocks):
        out[i] = _copied(mesh[i])
        if mesh.HasMetaData(i):
            out.GetMetaData(i).Copy(mesh.GetMetaData(i), 1)
    out.GetFieldData().DeepCopy(mesh.GetFieldData())
    out.copy_meta_from(mesh, deep=True)
    return out


def _leaves(mesh: Any, at: Path = ()) -> list[tuple[Path, str, Any]]:
    """Place, name and block of all that is no MultiBlock itself."""
    out: list[tuple[Path, str, Any]] = []
    for i in range(mesh.n_blocks):
        inner = [((*at, i), mesh.get_block_name(i) or f"block {i}", mesh[i])]
        out += _leaves(mesh[i], (*at, i)) if matches(mesh[i]) else inner
    return out


def _dimension(block: Any) -> int:
    """3 for a grid with tetrahedra, 2 for triangles, 0 for all others."""
    if not pyvista_mesh.matches(block):
        return 0
    if is_instance(block, "pyvista", "UnstructuredGrid"):
        types = np.unique(np.asarray(block.celltypes)).tolist()
        return max((pyvista_mesh.DIMENSION.get(kind, 0) for kind in types), default=0)
    return 2 if pyvista_mesh.has_triangles(block) else 0
