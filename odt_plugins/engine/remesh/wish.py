"""What sizes are asked for, and what is refused before anything is made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from numbers import Integral

from odt_plugins.errors import InvalidOptionError, expect, is_number

GROWTH = 1.3
"""Largest ratio of the sizes at the ends of an edge as long as the smaller one, by default."""

MOST_CELLS = 20_000_000
"""Most cells that are made unless more are asked for."""


@dataclass(frozen=True)
class Wish:
    """Sizes as they are asked for: one of the first six.

    Attributes
    ----------
    length : float or None      length of edges
    scale : float or None       multiple of the local size that the input has
    cells, vertices : int or None    how many there are to be, about
    given : bool                whether ``options.density`` holds lengths: an array or a callable
    curved : bool               whether sizes follow the curvature
    growth : float              largest ratio of the sizes at the ends of an edge as long as the
                                smaller one
    most_cells : int            a mesh of more is refused
    crowded : callable or None  called with how many times a number of tetrahedra the lengths of a
                                metric make of it, before anything is corrected
    """

    length: float | None = None
    scale: float | None = None
    cells: int | None = None
    vertices: int | None = None
    given: bool = False
    curved: bool = False
    growth: float = GROWTH
    most_cells: int = MOST_CELLS
    crowded: Callable[[float], None] | None = None

    def __post_init__(self) -> None:
        """Refuse values out of range, and anything but one wish."""
        words = ("size", "scale", "cells", "vertices")
        held = (self.length is not None or self.given or self.curved, *(
            getattr(self, name) is not None for name in words[1:]))
        if sum(held) != 1:
            said = [f"{name}=" for name, there in zip(words, held, strict=True) if there]
            msg = (f"got {' and '.join(said) or 'none'}; expected one of size, scale, cells and "
                   "vertices, try scale=1")
            raise InvalidOptionError(msg)
        for name, value in (("size", self.length), ("scale", self.scale)):
            if value is not None:
                good = is_number(value) and 0.0 < value < float("inf")
                expect(good, name, value, "a number above 0")
        for name, least in (("cells", 1), ("vertices", 4), ("most_cells", 1)):
            value = getattr(self, name)
            if value is not None or name == "most_cells":
                good = isinstance(value, Integral) and not isinstance(value, bool)
                expect(good and value >= least, name, value, f"an integer of at least {least}")
        good = is_number(self.growth) and 1.0 < self.growth < float("inf")
        expect(good, "growth", self.growth, "a number above 1, such as 1.3")
