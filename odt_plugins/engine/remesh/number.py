"""A number of cells or vertices: a factor on all sizes, corrected until it is met."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.elementary import log
from odt_plugins.engine.remesh.wish import Wish
from odt_plugins.engine.run.outcome import Outcome
from odt_plugins.mesh.simplex import SimplexMesh, vertices_of
from odt_plugins.options import Options

NEAR, CORRECTIONS, FURTHEST = 0.03, 4, 3.0
"""Sizes are corrected while the number of cells or vertices is off by more than this part, at most
so often, and to so many times the cells that are expected at first; the nearest result is taken."""

ROUGHLY = 0.1
"""Part by which that number may be off where the first result did not keep the promise: a result
that is nearer to it often leaves more as it is."""

MUCH, LITTLE = 1.1, 0.2
"""The last correction is one that multiplies or divides sizes by more than MUCH and leaves more
than 1 - LITTLE of what the number was off: the envelope or a feature allows no more."""

AS_MADE = 1.4
"""Multiple of the sizes that an envelope allowed with which cells are about the fewest."""

LEAST_POWER = 0.4
"""Least power of the sizes by which a number of cells changes, as a part of the dimension."""


def factor_for(counts: dict[float, int], goal: int, dim: int) -> float:
    """Factor on the sizes for a number of cells, which falls by their power, from those known.

    Between the nearest ones above and below by interpolation of 1 / number^(1 / dim), beyond both
    of the nearest ones by the power between these.
    """
    length = {(goal / count) ** (1.0 / dim): factor for factor, count in counts.items()}
    below, above = [x for x in length if x <= 1.0], [x for x in length if x > 1.0]
    if below and above:
        low, high = max(below), min(above)
        return length[low] + (length[high] - length[low]) * (1.0 - low) / (high - low)
    nearest, *others = sorted(length, key=lambda x: max(x, 1.0 / x))
    part = 1.0
    if others:
        fewer, longer = log(np.array(
            [nearest / others[0], length[nearest] / length[others[0]]]))
        part = min(max(float(fewer / longer), LEAST_POWER), 1.0)
    return length[nearest] * float(nearest ** (-1.0 / part))


class Goal(NamedTuple):
    """How many cells, or vertices of theirs, there are to be.

    Attributes
    ----------
    number : int
    what : str      "cells" or "vertices"
    dim : int       of the cells
    crowded : callable or None    see :class:`~.wish.Wish`
    """

    number: int
    what: str
    dim: int
    crowded: Callable[[float], None] | None = None

    def count(self, outcome: Outcome) -> int:
        """How many an outcome has."""
        return len(outcome.cells if self.what == "cells" else vertices_of(outcome.cells))

    def off(self, outcome: Outcome) -> float:
        """Part by which that is another number."""
        return abs(self.count(outcome) / self.number - 1.0)

    def nearest(self, counts: dict[float, int]) -> float:
        """The factor on sizes with which the number is nearest, of those known."""
        return min(counts, key=lambda factor: abs(counts[factor] - self.number))


def goal_of(wish: Wish, dim: int) -> Goal | None:
    """What number is asked for, None for none."""
    number = wish.cells if wish.vertices is None else wish.vertices
    what = "cells" if wish.vertices is None else "vertices"
    return None if number is None else Goal(number, what, dim, wish.crowded)


def out_of_reach_told(goal: Goal, count: int, mesh: SimplexMesh, options: Options) -> str:
    """Say that a number is not met, and of a larger one what allows fewer."""
    told = f"{count} {goal.what} are the nearest to {goal.number} that kept the promise"
    slides = options.boundary == "slide"
    ways = {
        "a larger envelope=": slides or mesh.is_surface,
        "boundary='slide'": not slides,
        "a larger selection": options.selection is not None,
        "fewer vertices in fixed": options.fixed is not None,
    }
    return told + (count > goal.number) * (
        ", try " + " or ".join(way for way, there in ways.items() if there))


def factor_towards(
    goal: Goal, count: Callable[[float], int | None], near: Callable[[], float], factor: float,
    alike: Callable[[], Mapping[float, int]] = dict,
) -> float:
    """The factor on sizes, of those that are tried, whose number is nearest; 1 if all fail.

    Parameters
    ----------
    goal : Goal
    count : callable    the number with a factor, None where there is no result
    near : callable     part of the goal by which the number may be off
    factor : float      to be tried first, then 1 where it fails
    alike : callable    numbers with factors, to which those of the same factors are in proportion
    """
    counts: dict[float, int] = {}
    nearest, last, off = factor, factor, math.inf
    for _ in range(CORRECTIONS + 1):
        found, held = count(factor), False
        if found is not None:
            counts[factor], before, off = found, off, float(found - goal.number)
            held = (off * before > 0.0 and abs(off) > (1.0 - LITTLE) * abs(before)
                    and max(factor / last, last / factor) > MUCH)
            last = factor
        if not counts:
            if factor == 1.0:
                break
            nearest = factor = 1.0
            continue
        nearest = goal.nearest(counts)
        if abs(counts[nearest] / goal.number - 1.0) <= near():
            break
        if held:
            return nearest if off < 0.0 else _fewest(goal, count, counts)
        first, known = next(iter(counts)), alike()
        likely = {other: max(round(number * counts[first] / known[first]), 1)
                  for other, number in known.items() if first in known}
        factor = (factor_for(likely | counts, goal.number, goal.dim) if factor in counts
                  else math.sqrt(factor * nearest))
        factor = max(factor, FURTHEST ** (-1.0 / goal.dim))
        if factor in counts:
            break
    return nearest


def _fewest(
    goal: Goal, count: Callable[[float], int | None], counts: dict[float, int]
) -> float:
    """The factor whose number is nearest where no sizes make as few as are asked for.

    Sizes much longer than an envelope allows make more than those that are about as long.
    """
    longest = goal.nearest(counts)
    factor = AS_MADE * longest * (goal.number / counts[longest]) ** (1.0 / goal.dim)
    for tried in (factor, math.sqrt(factor * longest)):
        found = count(tried) if factor < longest == goal.nearest(counts) else None
        if found is not None:
            counts[tried] = found
    return goal.nearest(counts)
