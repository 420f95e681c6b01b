"""What a run remembers: its best states that keep the promised figures, and what it gave up."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import (
    COS_SMALL,
    EXTREMES,
    ROUNDING,
    Figures,
    cell_shapes,
    figures,
)
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.chunks import Pool
from odt_plugins.mesh.quantiles import quantile
from odt_plugins.objectives import Objective


@dataclass(frozen=True)
class State:
    """A mesh worth returning, with its figures."""

    points: FloatArray
    cells: IntArray
    regions: IntArray
    figures: Figures
    name: str


def named(found: Figures) -> dict[str, float]:
    """Figures by the names of what may be kept; angles in degrees."""
    low, high = (math.degrees(math.acos(min(1.0, max(-1.0, cosine))))
                 for cosine in (found.cos_min_angle, found.cos_max_angle))
    return {"min_quality": found.min_quality, "p1_quality": found.p1_quality,
            "mean_quality": found.mean_quality, "min_angle": low, "max_angle": high,
            "share_below_20": found.small_angles, "min_altitude": found.min_altitude}


def having(found: Figures) -> str:
    """End of a sentence on a refused state: its mean and least quality."""
    return f" at mean q {found.mean_quality:.3f} and least q {found.min_quality:.3f}"


class Beside(NamedTuple):
    """Cells of the input that stay, and the others, by their ``figures.cell_shapes``."""

    held: FloatArray
    others: FloatArray

    def added_to(self, found: Figures, shapes: FloatArray) -> Figures:
        """Figures with quantile, mean and share of the cells that stay and some others."""
        both = np.concatenate([shapes, self.held])
        return replace(found, p1_quality=quantile(both[:, 0], 0.01),
                       mean_quality=float(both[:, 0].mean()),
                       small_angles=float((both[:, 1] > COS_SMALL).mean()))


class Changing(Protocol):
    """A mesh while it is being changed."""

    @property
    def points(self) -> FloatArray:
        """Coordinates (n, d), as they are now."""
        ...

    def mesh_arrays(self) -> tuple[IntArray, IntArray]:
        """Cells and their labels, as they are now; copies."""
        ...


class Memory:
    """Remembers the best state that keeps every named figure, and the last that did not.

    Keeps as well the refused state of highest score whose only fault is an extreme.

    Cells at the vertices ``aside`` may pass the extremes: another run will look after them.

    Quantile, mean and share are kept with the cells ``beside``, too, that stay and are no part of
    the states: where many of these are poor, all are a poorer mesh with fewer good ones.

    After finishing the best is the one of highest score; without it, the latest, since then a
    certain number of rounds of a certain method was asked for.
    """

    def __init__(
        self, before: Figures, keep: tuple[str, ...], objective: Objective, *, by_score: bool,
        aside: BoolArray | None = None, pool: Pool | None = None,
        beside: Beside | None = None,
    ) -> None:
        self.before = before
        self.keep = keep
        self.objective = objective
        self.by_score = by_score
        self.aside = aside
        self.pool = pool
        self.beside = beside
        self.whole = before if beside is None else beside.added_to(before, beside.others)
        self.states: list[State] = []
        self.worse: list[str] = []
        self.refused: State | None = None
        self.nearest: State | None = None
        self.missed = before.mean_quality
        self.vetoed: tuple[Figures, list[str]] | None = None

    def offer(self, mesh: Changing, name: str) -> bool:
        """Take the state if it keeps the figures; only the two best are held."""
        cells, regions = mesh.mesh_arrays()
        now = figures(mesh.points, cells, self.objective, self.pool)
        worse = self._but_aside(now, mesh.points, cells).worse_than(self.before, self.keep)
        if not worse and self.beside is not None:
            all_cells = self.beside.added_to(
                self.before, cell_shapes(mesh.points, cells, self.pool))
            worse = all_cells.worse_than(self.whole, self.keep)
        if worse:
            self.worse = worse
            self.refused = State(mesh.points.copy(), cells, regions, now, name)
            self.missed = max(self.missed, now.mean_quality)
            if self.vetoed is None or now.mean_quality > self.vetoed[0].mean_quality:
                self.vetoed = now, worse
            nearest = self.nearest.figures.score if self.nearest else -math.inf
            if now.score > nearest and set(worse) <= EXTREMES:
                self.nearest = self.refused
            return False
        if self.by_score and not now.score > self.before.score + ROUNDING:
            return False
        self.states.insert(0, State(mesh.points.copy(), cells, regions, now, name))
        if self.by_score:
            self.states.sort(key=lambda state: -state.figures.score)
        del self.states[2:]
        return True

    def _but_aside(self, now: Figures, points: FloatArray, cells: IntArray) -> Figures:
        """The figures of a mesh with the extremes of the cells that count."""
        if self.aside is None:
            return now
        aside = np.zeros(len(points), dtype=np.bool_)
        aside[: len(self.aside)] = self.aside
        inner = cells[~aside[cells].any(axis=1)]
        if not len(inner):
            return now
        return now.with_extremes(cell_shapes(points, inner))

    def price(self) -> str:
        """End of a sentence: the mean quality that was given up to keep the figures, if any."""
        best = self.states[0].figures if self.states else self.before
        if not self.worse or self.missed < best.mean_quality + POLICY.notable_price:
            return ""
        return f" at a mean quality of {self.missed:.3f}"

    def veto(self) -> dict[str, Any] | None:
        """What the refused state of the best mean had, and what refused it.

        None where its mean is hardly above that of the best state.
        """
        best = self.states[0].figures if self.states else self.before
        if self.vetoed is None:
            return None
        now, worse = self.vetoed
        if now.mean_quality < best.mean_quality + POLICY.notable_price:
            return None
        before, there = named(self.before), named(now)
        return {"worse": {name: (before[name], there[name]) for name in worse},
                "mean_quality": there["mean_quality"], "min_quality": there["min_quality"]}

    def spoiled(self) -> IntArray:
        """Vertices of the cells that pass an extreme of the input in the last refused state.

        None where the mean or the 1 % quantile is worse too.
        """
        nowhere = np.zeros(0, dtype=np.int32)
        if self.refused is None or {"p1_quality", "mean_quality"} & set(self.worse):
            return nowhere
        shapes = cell_shapes(self.refused.points, self.refused.cells)
        return np.unique(self.refused.cells[self.before.passed_by(shapes, self.keep)])
