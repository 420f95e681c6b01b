"""What binds the minimum: the worst cells of a mesh and the reason that each stays as it is."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.figures import EDGES, CellFigures, angles, radius_ratio
from odt_plugins.promise.locked_facets import locked_facets

N_WORST = 10
"""Cells named for each figure: radius ratio, smallest and largest angle."""

NEAR = 0.9
"""A cell is bound by one of its facets when it reaches this share of what the facet allows."""


@dataclass(frozen=True)
class BindingCell:
    """One cell that binds a figure.

    Attributes
    ----------
    cell : int                           index in the result
    vertices : tuple of int
    binds : tuple of str                 the figures: quality, min_angle, max_angle
    quality, min_angle, max_angle        radius ratio; (dihedral) angles in degrees
    n_movable : int                      how many of its vertices may move
    reason : str                         why it stays
    hint : str                           option that frees it, as a keyword, "" for none
    """

    cell: int
    vertices: tuple[int, ...]
    binds: tuple[str, ...]
    quality: float
    min_angle: float
    max_angle: float
    n_movable: int
    reason: str
    hint: str = ""

    def __str__(self) -> str:
        """One line."""
        return (f"cell {self.cell}: q {self.quality:.3f}, {self.min_angle:.1f}.."
                f"{self.max_angle:.1f} deg, {self.reason}" + (self.hint and f"; try {self.hint}"))


class Freeing(NamedTuple):
    """What frees vertices that stay, and cells whose vertices move.

    Attributes
    ----------
    held : dict     option, as a keyword with its value -> vertices (n,) bool that it frees
    insert : str    option that adds vertices inside, "" for none
    moving : str    option that gives vertices that move more freedom, "" for none
    free : tuple    words that the option `free` has already
    """

    held: Mapping[str, NDArray[np.bool_]]
    insert: str = ""
    moving: str = ""
    free: tuple[str, ...] = ()

    def of(self, cell: NDArray[np.int32], movable: NDArray[np.bool_], corner: bool) -> str:
        """Options that free a cell; of a corner of two facets only those that free vertices."""
        stay = cell[~movable[cell]]
        held = [option for option, mask in self.held.items() if mask[stay].any()]
        found = [option for option in held if not option.startswith("free=")]
        if len(found) < len(held):
            words = [option.split('"')[1] for option in held if option not in found]
            found.append(free_option((*self.free, *words)))
        if not corner:
            found += [self.insert, *([] if len(stay) else [self.moving])]
        return " and ".join(option for option in found if option)


NOTHING = Freeing({})


def free_option(words: Sequence[str]) -> str:
    """The option `free` of some words, as a keyword."""
    quoted = ", ".join(f'"{word}"' for word in words)
    return f"free={quoted}" if len(words) == 1 else f"free=({quoted})"


def joined_lines(cells: Sequence[BindingCell], most: int) -> list[str]:
    """Lines of cells, one for all with the same reason and hint, and at most so many."""
    alike: dict[tuple[str, str], list[BindingCell]] = {}
    for cell in cells:
        alike.setdefault((cell.reason, cell.hint), []).append(cell)
    return [str(same[0]) + (f" (and {len(same) - 1} more)" if same[1:] else "")
            for same in list(alike.values())[:most]]


def binding_cells(
    points: NDArray[np.float64],
    cells: NDArray[np.int32],
    regions: NDArray[np.int32],
    movable: NDArray[np.bool_],
    figures: CellFigures,
    freeing: Freeing = NOTHING,
) -> tuple[BindingCell, ...]:
    """Name the cells that bind the worst figures of a mesh and say why.

    Parameters
    ----------
    points, cells, regions : (n, d), (m, d + 1), (m,)
    movable : (n,) bool        vertices that may move
    figures : CellFigures      of this mesh
    freeing : Freeing          the options that free cells

    Returns
    -------
    tuple of BindingCell       worst radius ratio first; ties by index
    """
    rank = {"quality": figures.quality, "min_angle": figures.min_angle,
            "max_angle": -figures.max_angle}
    binds: dict[int, list[str]] = {}
    for name, value in rank.items():
        for c in _smallest(value, N_WORST):
            binds.setdefault(int(c), []).append(name)
    chosen = np.array(sorted(binds, key=lambda c: (figures.quality[c], c)))
    locked = locked_facets(cells, regions, len(points))
    of_cell: dict[int, list[NDArray[Any]]] = {int(c): [] for c in chosen}
    for i in np.flatnonzero(np.isin(locked.cells, chosen)):
        of_cell[int(locked.cells[i])].append(locked.facets[i])
    return tuple(
        BindingCell(
            cell=c,
            vertices=tuple(cells[c].tolist()),
            binds=tuple(binds[c]),
            quality=float(figures.quality[c]),
            min_angle=float(figures.min_angle[c]),
            max_angle=float(figures.max_angle[c]),
            n_movable=int(movable[cells[c]].sum()),
            reason=_reason(points, cells[c], of_cell[c], movable, figures, c),
            hint=freeing.of(cells[c], movable,
                            _sharp_corner(points, cells[c], of_cell[c]) is not None),
        )
        for c in chosen.tolist()
    )


def best_quality_on(triangle: NDArray[np.float64], enough: float = 1.0) -> float:
    """Give the largest radius ratio that a tetrahedron on a given triangle can have.

    Parameters
    ----------
    triangle : (3, 3) float64    three corners in space
    enough : float               a larger one than this is not looked for beyond the first found

    Returns
    -------
    float                        in (0, 1]; 1 for an equilateral triangle

    Notes
    -----
    The apex is searched on a grid around the best place so far, ever finer; the radius ratio
    has one maximum on each side of the triangle.
    """
    x = triangle - triangle.mean(axis=0)
    size = float(np.abs(x).max()) or 1.0
    normal = np.cross(x[1] - x[0], x[2] - x[0])
    length = math.hypot(*normal)
    if length <= 1e-14 * size**2:
        return 0.0
    u = (x[1] - x[0]) / math.dist(x[0], x[1])
    frame = np.stack([u, np.cross(normal / length, u), normal / length])
    steps = np.stack(np.meshgrid(*[np.linspace(-1, 1, 9)] * 3), axis=-1).reshape(-1, 3)
    best, apex, reach = 0.0, frame[2] * size, 2.0 * size
    corners = np.arange(3)
    tets = np.column_stack([np.tile(corners, (len(steps), 1)), np.arange(3, 3 + len(steps))])
    for _ in range(14):
        trial = apex + reach * (steps[:, :, None] * frame).sum(axis=1)
        q = np.abs(radius_ratio(np.concatenate([x, trial]), tets))
        if q.max() > best:
            best, apex = float(q.max()), trial[int(q.argmax())]
        if best > enough:
            break
        reach *= 0.5
    return best


def _smallest(value: NDArray[np.float64], count: int) -> NDArray[np.intp]:
    """Indices of the smallest values, ties by index."""
    count = min(count, len(value))
    limit = np.partition(value, count - 1)[count - 1]
    near = np.flatnonzero(value <= limit)
    return near[np.argsort(value[near], kind="stable")][:count]


def _reason(
    points: NDArray[np.float64],
    cell: NDArray[np.int32],
    facets: list[NDArray[Any]],
    movable: NDArray[np.bool_],
    figures: CellFigures,
    index: int,
) -> str:
    """Give the strongest reason why a cell stays, as the end of a sentence."""
    k = len(cell)
    free = int(movable[cell].sum())
    corner = _sharp_corner(points, cell, facets)
    if corner is not None:
        return corner
    on_surface = points.shape[1] == k
    if free == 0:
        return f"all its {k} vertices are {'held' if on_surface else 'fixed'}"
    if k == 4 and free == 1:
        facet = cell[~movable[cell]]
        limit = best_quality_on(points[facet], figures.quality[index] / NEAR)
        if figures.quality[index] >= NEAR * limit:
            own = float(radius_ratio(points[facet], [[0, 1, 2]])[0])
            on_surface = any(set(f.tolist()) == set(facet.tolist()) for f in facets)
            what = "boundary triangle" if on_surface else "triangle of fixed vertices"
            return (f"its {what} {_names(facet)} has q {own:.3f} and allows no more than "
                    f"{limit:.3f}")
    return f"{free} of its {k} vertices may move{' within the envelope' if on_surface else ''}"


def _sharp_corner(
    points: NDArray[np.float64], cell: NDArray[np.int32], facets: list[NDArray[Any]]
) -> str | None:
    """Name the angle between two fixed facets of a cell when it is its extreme angle."""
    if len(facets) < 2:
        return None
    angle = angles(points, cell[None])[0]
    held = set()
    for i, f in enumerate(facets):
        for g in facets[i + 1:]:
            held.add(frozenset(f.tolist()) & frozenset(g.tolist()))
    at = [frozenset([int(v)]) for v in cell] if len(cell) == 3 else \
        [frozenset([int(cell[i]), int(cell[j])]) for i, j in EDGES[4]]
    for worst in (int(angle.argmin()), int(angle.argmax())):
        if at[worst] in held:
            what, where = (("edges", "at its vertex") if len(cell) == 3 else
                           ("triangles", "along its edge"))
            return (f"two {what} of it that stay fixed meet {where} {_names(sorted(at[worst]))} "
                    f"at {angle[worst]:.1f} deg, so that angle stays")
    return None


def _names(vertices: Any) -> str:
    return "(" + ", ".join(str(int(v)) for v in vertices) + ")"
