"""What finishing may improve: the one table of which options, hosts, command line and engine read.

A further objective is a row here and a measure in :mod:`odt_plugins.engine.cells.measures`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Objective = Literal["radius_ratio", "min_dihedral", "amips", "time_step"]

Row = tuple[float, float, int, int, int]
"""Power, share of the cells, rounds, sweeps and compound passes of a phase, see ``Phase``."""


@dataclass(frozen=True)
class Aim:
    """What the engine does for an objective.

    Attributes
    ----------
    text : str               what is improved, in the help of the option
    triangles, cells : tuple of Row
        phases for the worst triangles and tetrahedra, by the measure of the objective
    mean : (float, float) or None
        power of its measure in the phase for the mean of triangles and tetrahedra, which alone is
        what the descents improve; None: radius ratios are improved, too
    by_ratios : bool         whether its measure is the radius ratio
    by_angles : bool         whether the worst angles outweigh radius ratios
    by_altitude : bool       whether the least altitude counts with radius ratios, and is kept
    """

    text: str
    triangles: tuple[Row, ...]
    cells: tuple[Row, ...]
    mean: tuple[float, float] | None = None
    by_ratios: bool = False
    by_angles: bool = False
    by_altitude: bool = False


AIMS: dict[Objective, Aim] = {
    "radius_ratio": Aim(
        "radius ratios",
        ((4.0, 0.1, 4, 2, 3), (8.0, 0.01, 4, 2, 2), (32.0, 0.003, 6, 2, 3)),
        ((2.0, 0.1, 2, 3, 0), (4.0, 0.03, 2, 3, 3), (8.0, 0.002, 2, 3, 0)),
        by_ratios=True),
    "min_dihedral": Aim(
        "the smallest (dihedral) angles",
        ((4.0, 0.1, 4, 2, 3), (8.0, 0.003, 4, 2, 2), (16.0, 0.001, 6, 2, 3)),
        ((1.0, 0.03, 2, 3, 3), (2.0, 0.01, 2, 3, 3), (8.0, 0.002, 2, 3, 3)),
        by_angles=True),
    "amips": Aim(
        "the energy that TetWild minimises (amips)",
        ((2.0, 0.1, 4, 2, 3), (8.0, 0.01, 4, 2, 2), (32.0, 0.003, 6, 2, 3)),
        ((0.5, 0.1, 2, 3, 3), (2.0, 0.01, 2, 3, 3), (8.0, 0.002, 2, 3, 3)),
        mean=(1 / 2, 1 / 3)),
    "time_step": Aim(
        "the least altitude of a cell, which decides the time step of explicit dynamics "
        "(time_step)",
        ((16.0, 0.05, 10, 2, 0), (32.0, 0.01, 10, 2, 0), (64.0, 0.003, 10, 2, 0)),
        ((16.0, 0.03, 2, 3, 3), (32.0, 0.01, 2, 3, 3), (64.0, 0.002, 2, 3, 3)),
        by_altitude=True),
}
"""Every objective; the first is the default, which goes without finishing, too."""
