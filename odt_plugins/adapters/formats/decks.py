"""Decks of text: records that are exchanged word by word, and who takes the place of whom."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.change import Change, NotRewritable

Edit = tuple[int, int, bytes]
"""Where a piece of a file starts and stops, and what takes its place."""


HELD = "held"
"""Attribute of a meshio.Mesh: vertices that have to stay, since its file refers to them."""

ORDERS = {"tetra": 1, "tetra10": 2, "triangle": 1, "triangle6": 2}
"""Orders of the types of cells that may be optimised, the first that is there is."""

LINEAR = ("vertex", "line", "triangle", "quad", "tetra", "hexahedron", "wedge", "pyramid")

QUADRATIC = ("line3", "triangle6", "tetra10")


def edited(data: bytes, edits: Iterable[Edit]) -> bytes:
    """Put other text in the place of pieces of a file, which do not overlap."""
    out, at = [], 0
    for start, stop, text in sorted(edits, key=lambda edit: edit[:2]):
        out += [data[at:start], text]
        at = stop
    return b"".join([*out, data[at:]])


def substituted(
    text: bytes, spans: Sequence[tuple[int, int]], words: Mapping[int, bytes]
) -> bytes:
    """Exchange some words of a record, which are told by their places among all of its spans."""
    return edited(text, [(*spans[i], word) for i, word in words.items()
                         if text[spans[i][0]: spans[i][1]] != word])


def real(x: float, width: int = 24) -> bytes:
    """Text of at most `width` letters that reads as a number, or as the nearest that has one.

    Raises
    ------
    NotRewritable    there is no room for any digit
    """
    for digits in range(17, 0, -1):
        y = float(f"{x:.{digits}g}")
        plain = repr(y)
        forms = (plain, plain.replace("0.", ".", 1) if abs(y) < 1 else plain,
                 np.format_float_scientific(y, trim="0", exp_digits=1))
        best = next((form for form in forms if len(form) <= width), None)
        if best is not None:
            return best.encode()
    msg = f"{x!r} needs more than {width} letters"
    raise NotRewritable(msg)


def places(
    rows: NDArray[np.int64], fresh: NDArray[np.bool_], kinds: Sequence[Any]
) -> list[list[tuple[int, int]]]:
    """Say which records new cells of a block take.

    A cell stands where the cell stood from which its data come, and takes its name; the names of
    cells that went pass to new ones of their kind.

    Parameters
    ----------
    rows : (m',) int          cell of before of every cell of after
    fresh : (m',) bool        those that are other cells
    kinds : (m,)              what tells apart cells whose names must not be exchanged

    Returns
    -------
    list of lists    for every row of before (cell of after, row whose name it takes or -1)
    """
    taken = np.full(len(rows), -1, dtype=np.int64)
    used = np.zeros(len(kinds), dtype=np.bool_)
    for i in [*np.flatnonzero(~fresh).tolist(), *np.flatnonzero(fresh).tolist()]:
        if not used[rows[i]]:
            used[rows[i]] = True
            taken[i] = rows[i]
    free: dict[Any, list[int]] = {}
    for r in np.flatnonzero(~used).tolist()[::-1]:
        free.setdefault(kinds[r], []).append(r)
    out: list[list[tuple[int, int]]] = [[] for _ in kinds]
    for i, r in enumerate(rows.tolist()):
        if taken[i] < 0 and free.get(kinds[r]):
            taken[i] = free[kinds[r]].pop()
        out[r].append((i, int(taken[i])))
    return out


def expect_same_points(change: Change) -> None:
    """See whether all points are still there.

    Raises
    ------
    NotRewritable    points came or went
    """
    if change.renumbered:
        msg = "nodes came or went, to which other parts of the file may refer"
        raise NotRewritable(msg)


def order_of(kinds: Iterable[str]) -> int:
    """Order of the cells among some types that are optimised; 0 where there are none."""
    found = set(kinds)
    return next((order for kind, order in ORDERS.items() if kind in found), 0)


def fits(kind: str, order: int) -> bool:
    """Whether cells of a type may lie beside those of some order that are optimised."""
    return order == 0 or kind in LINEAR or (order == 2 and kind in QUADRATIC)
