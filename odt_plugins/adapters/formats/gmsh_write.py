"""Sections of Gmsh's files of version 4.1 as they are written, as text or in bytes.

https://gmsh.info/doc/texinfo/gmsh.html#MSH-file-format
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.gmsh_read import order_of, type_names


def section(name: str, binary: bool, *parts: bytes) -> bytes:
    """Put the parts of a section together, of which those of text end with a line."""
    return b"".join([f"${name}\n".encode(), *parts, b"\n" * binary, f"$End{name}\n".encode()])


def names(groups: dict[str, Any]) -> bytes:
    """Write the names of groups, in the order of dimensions and tags.

    Parameters
    ----------
    groups : of (tag, dimension)    by name
    """
    known = sorted((int(dim), int(tag), name) for name, (tag, dim) in groups.items())
    lines = "".join(f'{dim} {tag} "{name}"\n' for dim, tag, name in known)
    return section("PhysicalNames", False, f"{len(known)}\n{lines}".encode())


def rows(values: Any, kind: str, binary: bool) -> bytes:
    """Write a table of numbers: a line for each row of text, the shortest text of each number."""
    table = np.atleast_2d(np.asarray(values, dtype=kind))
    if binary:
        return table.tobytes()
    return "".join(" ".join(map(repr, row)) + "\n" for row in table.tolist()).encode()


def head(numbers: Sequence[int], count: int, binary: bool) -> bytes:
    """Write what stands before rows: numbers of four bytes, and how many rows follow, of eight."""
    if binary:
        return rows(numbers, "i4", binary) + rows(count, "u8", binary)
    return rows([*numbers, count], "i8", binary)


def nodes(points: NDArray[Any], entities: NDArray[Any], binary: bool) -> bytes:
    """Write nodes, those of each entity together, numbered from 1 on as they come.

    Parameters
    ----------
    points : (n, 3) float
    entities : (n, 2) int    dimension and tag
    binary : bool
    """
    n, known = len(points), np.unique(entities, axis=0)
    parts = [rows([len(known), n, 1, n], "u8", binary)]
    for entity in known:
        here = np.flatnonzero((entities == entity).all(axis=1))
        parts += [head([*entity.tolist(), 0], len(here), binary),
                  rows(here[:, None] + 1, "u8", binary), rows(points[here], "f8", binary)]
    return section("Nodes", binary, *parts)


def elements(blocks: Sequence[Any], tags: Iterable[NDArray[Any]], binary: bool) -> bytes:
    """Write elements, numbered from 1 on as they come.

    Parameters
    ----------
    blocks : of meshio.CellBlock    each of one entity
    tags : of (m,) int              of that entity, for each block
    binary : bool
    """
    kinds = {name: number for number, name in type_names().items()}
    count, first = sum(len(block.data) for block in blocks), 1
    parts = [rows([len(blocks), count, 1, count], "u8", binary)]
    for block, tag in zip(blocks, tags, strict=True):
        m, width = block.data.shape
        cells = block.data[:, order_of(block.type, width)] + 1
        parts += [head([block.dim, int(tag[0]), kinds[block.type]], m, binary),
                  rows(np.column_stack([np.arange(first, first + m), cells]), "u8", binary)]
        first += m
    return section("Elements", binary, *parts)


def periodic(links: Sequence[tuple[Any, ...]], binary: bool) -> bytes:
    """Write which nodes of entities repeat those of others.

    Parameters
    ----------
    links : of (int, (int, int), affine, (m, 2) int)    dimension, entities, numbers of a
                                                        transformation or None, pairs of nodes
    binary : bool
    """
    parts = [rows(len(links), "u8", binary)]
    for dim, entities, affine, pairs in links:
        values = np.zeros(0) if affine is None else np.asarray(affine, dtype=np.float64)
        told = rows(len(values), "u8", binary)
        parts += [rows([dim, *entities], "i4", binary),
                  told if binary or not len(values) else told.rstrip() + b" ",
                  rows(values, "f8", binary) if len(values) else b"",
                  rows(len(pairs), "u8", binary),
                  rows(np.reshape(pairs, (-1, 2)) + 1, "u8", binary) if len(pairs) else b""]
    return section("Periodic", binary, *parts)


def values(name: str, title: str, array: NDArray[Any], binary: bool) -> bytes:
    """Write values of nodes or elements, in the order of these.

    Parameters
    ----------
    name : str           of the section
    title : str          of the values
    array : (n,) or (n, w) float
    binary : bool
    """
    numbers = np.arange(1, len(array) + 1)
    table = np.asarray(array, dtype=np.float64).reshape(len(array), -1)
    told = f'1\n"{title}"\n1\n0.0\n3\n0\n{table.shape[1]}\n{len(table)}\n'.encode()
    if binary:
        made = np.empty(len(table), dtype=[("number", "i4"), ("values", "f8", table.shape[1:])])
        made["number"], made["values"] = numbers, table
        return section(name, binary, told, made.tobytes())
    lines = ("".join((str(number), " ", " ".join(map(repr, row)), "\n"))
             for number, row in zip(numbers.tolist(), table.tolist(), strict=True))
    return section(name, binary, told, "".join(lines).encode())
