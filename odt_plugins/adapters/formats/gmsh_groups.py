"""Overlapping groups in files of Gmsh of version 2.2, which have an element once for each group."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.gmsh_tables import ENTITY, PHYSICAL

UNNAMED = "physical {}"
"""Name of the set of a group without a name."""


def tag_of(name: str) -> int | None:
    """Tag of the group without a name that a set is; None of another one."""
    found = re.fullmatch(UNNAMED.format(r"(\d+)"), name)
    return int(found[1]) if found else None


def without_copies(mesh: Any) -> Any:
    """Join elements of one entity with the same nodes that are of several groups, now cell sets.

    Parameters
    ----------
    mesh : meshio.Mesh    as it is read

    Returns
    -------
    meshio.Mesh           the same where no element is there several times
    """
    if PHYSICAL not in mesh.cell_data or ENTITY not in mesh.cell_data:
        return mesh
    kinds = sorted({block.type for block in mesh.cells})
    keep = [np.ones(len(block.data), dtype=np.bool_) for block in mesh.cells]
    inside: dict[tuple[int, int], list[NDArray[np.bool_]]] = {}
    for kind in kinds:
        own = [i for i, block in enumerate(mesh.cells) if block.type == kind]
        sizes = [len(mesh.cells[i].data) for i in own]
        rows = np.concatenate([np.sort(mesh.cells[i].data, axis=1) for i in own])
        entity, group = (np.concatenate([np.asarray(mesh.cell_data[name][i]) for i in own])
                         for name in (ENTITY, PHYSICAL))
        keys = np.column_stack([entity, rows])
        _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        inverse = inverse.ravel()
        pairs = np.unique(np.column_stack([inverse, group]), axis=0)
        if len(first) == len(rows) or len(pairs) < len(rows):
            continue
        kept = np.zeros(len(rows), dtype=np.bool_)
        kept[first] = True
        ends = np.cumsum(sizes)[:-1]
        for values in mesh.cell_data.values():
            whole = np.concatenate([np.asarray(values[i]) for i in own])
            if whole.dtype.kind == "f":
                # A view has its values at any one of the copies.
                told = np.flatnonzero(~np.isnan(whole.reshape(len(whole), -1)).any(axis=1))
                whole[first[inverse[told]]] = whole[told]
                for i, part in zip(own, np.split(whole, ends), strict=True):
                    values[i] = part
        for i, part in zip(own, np.split(kept, ends), strict=True):
            keep[i] = part
        for tag in np.unique(group).tolist():
            has = np.zeros(len(first), dtype=np.bool_)
            has[inverse[group == tag]] = True
            masks = inside.setdefault((int(mesh.cells[own[0]].dim), tag), [
                np.zeros(len(block.data), dtype=np.bool_) for block in mesh.cells])
            for i, part in zip(own, np.split(has[inverse], ends), strict=True):
                masks[i] = part
    return _thinned(mesh, keep, inside) if inside else mesh


def _thinned(mesh: Any, keep: list[NDArray[np.bool_]], inside: Any) -> Any:
    """Keep some of the cells, without the blocks that have none then, and let groups be sets."""
    from meshio import Mesh

    blocks = [i for i, mask in enumerate(keep) if mask.any()]
    names = {(int(value[1]), int(value[0])): name for name, value in mesh.field_data.items()}
    for i, block in enumerate(mesh.cells):
        for tag in np.unique(mesh.cell_data[PHYSICAL][i]).tolist():
            masks = inside.setdefault((int(block.dim), tag), [
                np.zeros(len(other.data), dtype=np.bool_) for other in mesh.cells])
            masks[i] |= np.asarray(mesh.cell_data[PHYSICAL][i]) == tag
    sets: dict[str, Any] = {}
    for (dim, tag), masks in inside.items():
        name = names.get((dim, tag), UNNAMED.format(tag))
        old = sets.get(name, [False] * len(masks))
        sets[name] = [one | two for one, two in zip(old, masks, strict=True)]
    sets = {name: [np.flatnonzero(masks[i][keep[i]]) for i in blocks]
            for name, masks in sets.items() if name != UNNAMED.format(0)}
    out = Mesh(mesh.points, [(mesh.cells[i].type, mesh.cells[i].data[keep[i]]) for i in blocks],
               mesh.point_data, {name: [np.asarray(values[i])[keep[i]] for i in blocks]
                                 for name, values in mesh.cell_data.items()},
               mesh.field_data, cell_sets=sets)
    out.gmsh_periodic, out.info = mesh.gmsh_periodic, mesh.info
    return out


def with_copies(mesh: Any) -> Any:
    """Give a mesh for version 2.2 each element once for each group, as :func:`without_copies` read.

    Parameters
    ----------
    mesh : meshio.Mesh    not changed

    Returns
    -------
    meshio.Mesh           without cell sets; the same where no group overlaps another
    """
    from meshio import CellBlock, Mesh

    cells, arrays = [*mesh.cells], {name: [*values] for name, values in mesh.cell_data.items()}
    for name, members in mesh.cell_sets.items():
        tag = tag_of(name)
        group = mesh.field_data.get(name) if tag is None else [tag, -1]
        for i, block in enumerate(mesh.cells):
            if group is None or members[i] is None or group[1] not in (-1, block.dim):
                continue
            given = np.asarray(members[i])
            rows = np.flatnonzero(given) if given.dtype == np.bool_ else given.astype(np.int64)
            rows = rows[np.abs(mesh.cell_data[PHYSICAL][i])[rows] != group[0]]
            if not len(rows):
                continue
            cells.append(CellBlock(block.type, np.asarray(block.data)[rows]))
            for title, values in arrays.items():
                part = np.asarray(values[i])[rows]
                values.append(np.full_like(part, group[0]) if title == PHYSICAL else part)
    if len(cells) == len(mesh.cells):
        return mesh
    out = Mesh(mesh.points, cells, mesh.point_data, arrays, mesh.field_data)
    out.gmsh_periodic, out.info = mesh.gmsh_periodic, mesh.info
    return out
