"""What was done at every level of refinement, and how far the result is from its surface."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

from odt_plugins.figures import QualitySummary
from odt_plugins.generate.covered import Covered
from odt_plugins.table import text_html


@dataclass(frozen=True)
class Level:
    """What was done at one level.

    Attributes
    ----------
    level : int                       0 is the coarse mesh
    quality : QualitySummary          at the end of the level
    asked, short : int                boundary vertices that were to move to the surface, and those
                                      that had to stop before it
    refining, projecting, optimising : float    wall seconds
    fallback : str or None            why optimisation gave an earlier state back
    """

    level: int
    quality: QualitySummary
    asked: int
    short: int
    refining: float
    projecting: float
    optimising: float
    fallback: str | None


@dataclass(frozen=True)
class LevelsReport:
    """What :func:`refine` did.

    Attributes
    ----------
    levels : tuple of Level
    envelope : float                  length that was asked for
    forward, backward : float         upper bounds of the distances from the boundary of the mesh to
                                      the surface, and from the surface to it
    volume, surface_volume : float    of the mesh, and inside the surface
    meshing, checking : float         wall seconds of TetWild, and of measuring the distances
    before : QualitySummary           of the coarse mesh
    filled : Covered or None          how the surface that was filled and the boundary lie to each
                                      other, see :func:`odt_plugins.tetrahedralize`
    """

    levels: tuple[Level, ...]
    envelope: float
    forward: float
    backward: float
    volume: float
    surface_volume: float
    meshing: float
    checking: float
    before: QualitySummary
    filled: Covered | None = None

    @property
    def after(self) -> QualitySummary:
        """Figures of the result."""
        return self.levels[-1].quality

    @property
    def fallback(self) -> str | None:
        """Why the last level gave an earlier state back."""
        return self.levels[-1].fallback

    @property
    def within(self) -> bool:
        """Whether both distances are certainly within the envelope."""
        return max(self.forward, self.backward) <= self.envelope

    @property
    def seconds(self) -> float:
        """Wall time of everything."""
        return self.meshing + self.checking + sum(
            level.refining + level.projecting + level.optimising for level in self.levels)

    def __str__(self) -> str:
        """Text of a few lines: a table of levels, then surface, volume and time."""
        lines = [f"{'level':>5}{'cells':>10}{'mean q':>9}{'1 %':>8}{'min q':>8}{'dihedral':>16}"
                 f"{'seconds':>9}"]
        for at in self.levels:
            q = at.quality
            seconds = at.refining + at.projecting + at.optimising
            angles = f"{q.min_angle:.1f}..{q.max_angle:.1f}"
            lines.append(f"{at.level:>5}{q.n_cells:>10}{q.mean_quality:>9.4f}"
                         f"{q.p1_quality:>8.3f}{q.min_quality:>8.3f}{angles:>16}{seconds:>9.1f}")
            if at.fallback:
                lines.append(f"      {at.fallback}")
        last = self.levels[-1]
        lines += [
            f"surface  {self.forward:.3g} to it, {self.backward:.3g} from it, "
            f"{'within' if self.within else 'not within'} the envelope of {self.envelope:.3g}; "
            f"{last.short} of {last.asked} vertices stopped before it",
            f"volume   {self.volume:.6g}, inside the surface {self.surface_volume:.6g}",
            f"time     {self.seconds:.1f} s, of them TetWild {self.meshing:.1f} s; "
            f"{1e6 * self.seconds / last.quality.n_cells:.0f} us a cell",
        ]
        if self.filled:
            lines.append(f"filled   {self.filled}")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """The same for a notebook."""
        return text_html(str(self))

    def to_dict(self) -> dict[str, Any]:
        """Give everything as plain values that JSON knows."""
        data = asdict(self)
        for level, at in zip(data["levels"], self.levels, strict=True):
            level["quality"] = at.quality.to_dict()
        data["before"] = self.before.to_dict()
        data["filled"] = self.filled and self.filled.to_dict()
        return data | {"within": self.within, "seconds": self.seconds}

    def to_json(self) -> str:
        """Give :meth:`to_dict` as JSON text."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False)
