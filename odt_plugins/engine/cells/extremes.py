"""Extremes of the shapes of tetrahedra; a change passes them only where it makes nothing worse."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from odt_plugins.engine.compiled.kernel import kernel


class Extremes(NamedTuple):
    """Extremes that some cells have, or that no new cell may pass.

    Attributes
    ----------
    quality : float    least radius ratio
    large : float      largest cosine of an angle, that of the smallest angle
    small : float      smallest cosine of an angle, that of the largest angle
    """

    quality: float
    large: float
    small: float


FREELY = Extremes(0.0, 1.0, -1.0)
"""Extremes that every cell keeps."""

BEST = Extremes(2.0, -1.0, 1.0)
"""Extremes of no cell."""

ROUNDED = 1e-14
"""A cell may come back with its vertices in another order: rounding must not decide whether it is
as it was."""


class Bounds(NamedTuple):
    """What no new cell may pass, unless a cell that it replaces does.

    Attributes
    ----------
    cells : Extremes     of all cells
    locked : Extremes    of cells with locked vertices only, which no smoothing can repair
    """

    cells: Extremes
    locked: Extremes

    def with_quality(self, least: float) -> Bounds:
        """The same with another least radius ratio of all cells."""
        return self._replace(cells=self.cells._replace(quality=float(least)))

    def within(self, found: Extremes) -> Bounds:
        """The same, but no cell may pass an extreme that was found besides."""
        return Bounds(*(
            Extremes(max(own.quality, found.quality), min(own.large, found.large),
                     max(own.small, found.small)) for own in self
        ))

    def with_large(self, cosine: float) -> Bounds:
        """The same, but no cosine of any cell may be larger than this one."""
        return Bounds(*(own._replace(large=min(own.large, float(cosine))) for own in self))


@kernel
def worse(first: Extremes, second: Extremes) -> Extremes:
    """Extremes of two sets of cells together."""
    return Extremes(
        min(first.quality, second.quality),
        max(first.large, second.large),
        min(first.small, second.small),
    )


def together(found: Iterable[Extremes]) -> Extremes:
    """The same of any number of sets of cells, outside of kernels."""
    quality, large, small = zip(*found, strict=True)
    return Extremes(min(quality), max(large), min(small))


def better(first: Extremes, second: Extremes) -> Extremes:
    """The better one of two values of every extreme."""
    return Extremes(
        max(first.quality, second.quality),
        min(first.large, second.large),
        max(first.small, second.small),
    )


def part_of(found: Extremes, part: float) -> Extremes:
    """A part of the radius ratio, the smallest angle, and what the largest lacks of 180 degrees."""
    if part == 1.0:
        return found
    return Extremes(
        part * found.quality,
        math.cos(part * math.acos(max(min(found.large, 1.0), -1.0))),
        -math.cos(part * math.acos(max(min(-found.small, 1.0), -1.0))),
    )


@kernel
def rounded(found: Extremes) -> Extremes:
    """The extremes, a little worse, such that they are kept by cells that differ by rounding."""
    q = found.quality
    return Extremes(q - ROUNDED * abs(q), found.large + ROUNDED, found.small - ROUNDED)


@kernel
def keeps(found: Extremes, limit: Extremes) -> bool:
    """Whether no extreme passes its limit."""
    return (
        found.quality >= limit.quality
        and found.large <= limit.large
        and found.small >= limit.small
    )
