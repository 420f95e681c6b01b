"""The numbers that decide when a stage begins, how long it goes on and what it is worth.

They were chosen by measurement, and every one of them names the command that measures it: run the
command before and after a change. Exponents, shares and rounds of the phases of stage 2 stand in
:mod:`odt_plugins.engine.finish.phases`, one phase a line. Tolerances of a formula stand beside the
formula.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

STANDARD = "odt-plugins compare --suite standard"
HARD = "python tests/measure hard"
ANGLES = "python examples/figures.py MESH... -- --objective min_dihedral --insert"
STAGES = "python tests/measure stages"
SURFACE = "python tests/measure surface"


def _chosen(value: Any, meaning: str, command: str) -> Any:
    """A number, what it means and the command that measures it."""
    return field(default=value, metadata={"meaning": meaning, "command": command})


@dataclass(frozen=True)
class Policy:
    """Numbers of the stages."""

    # stage 1
    settled_rounds: int = _chosen(
        8, "Rounds over which the fall of the least energy decides whether stage 1 "
        "ends.", STAGES)
    settled_energy: float = _chosen(
        1.6e-3, "Largest fall of the least energy over settled_rounds, as a part of it, at "
        "which stage 1 ends.", STAGES)
    stirred_settled: float = _chosen(
        8e-3, "Factor on the share of movable vertices, in the place of settled_energy, "
        "for sweeps with overrelaxation.", STAGES)
    exchange_cells: int = _chosen(
        20_000, "Largest number of cells for which connectivity 'auto' asks Qhull in the "
        "first round.", STAGES)
    flips_quality: float = _chosen(
        0.6, "Least mean quality of tetrahedra for which connectivity 'auto' takes flips "
        "from the first round on.", STANDARD)
    exchange_move: float = _chosen(
        0.1, "Largest move, in edge lengths, after which a round needs no Qhull (Section "
        "3.2).", STANDARD)
    stirred: float = _chosen(
        2.1, "First alpha of ODT sweeps in space in the first stirred_rounds, where "
        "finishing follows.", STANDARD)
    stirred_rounds: int = _chosen(8, "Rounds with the alpha stirred.", STANDARD)
    overrelaxed: float = _chosen(
        2.0, "First alpha of ODT sweeps in space after stirred_rounds, where finishing "
        "follows.", STANDARD)
    damped: float = _chosen(
        0.8, "First alpha of Jacobi sweeps; 1 is the limit of stability.", STANDARD)
    energy_ring: int = _chosen(
        5, "Largest number of cells around an edge that is removed to lower the "
        "energy.", STAGES)
    energy_passes: int = _chosen(
        1, "Passes of energy flips in a round; flips still pending wait for the next "
        "round.", STAGES)
    scattered: float = _chosen(
        0.2, "Share of the cells: after more flips than that the cells are sorted again.", STAGES)

    # stage 2
    volume_gain: float = _chosen(
        3e-3, "Least gain of a star of tetrahedra, as a part of F_p, for which its vertex "
        "wakes the neighbours.", STAGES)
    plane_gain: float = _chosen(
        1e-3, "Least gain of a star of triangles in the plane, as a part of F_p, for "
        "which its vertex wakes the neighbours.", STANDARD)
    surface_gain: float = _chosen(
        3e-3, "Least gain of a star on a curved surface, as a part of F_p, for which its "
        "vertex wakes the neighbours.", SURFACE)
    quality_ring: int = _chosen(
        10, "Largest number of cells around an edge that is removed to raise the "
        "quality.", STANDARD)
    quality_passes: int = _chosen(4, "Passes of quality flips in a round.", STAGES)
    reconnected: float = _chosen(
        0.01, "Largest share of the cells around which a phase fills polyhedra anew.", STANDARD)
    compound_rare: float = _chosen(
        5e-3, "Least share of the tried cells at which compound moves must pay to go on.", STANDARD)
    many_small_angles: float = _chosen(
        0.08, "Largest share of cells with a small angle for which phases for small "
        "angles run.", HARD)
    polished: float = _chosen(
        0.02, "Largest share of the cells from which a phase for small angles alone "
        "starts.", STANDARD)
    polished_rings: int = _chosen(
        4, "Rings of cells around small angles that such a phase changes.", STANDARD)

    # insertion
    insertion_rounds: int = _chosen(
        10, "Largest number of rounds of insertion, each followed by finishing.", STANDARD)
    insertion_worth: float = _chosen(
        1e-3, "Least gain of the score for which another round of insertion follows.", STANDARD)
    insertion_effort: float = _chosen(
        0.5, "Operations for each cell of the input after which insertion ends.", STANDARD)
    insertion_angles_effort: float = _chosen(
        1.0, "Operations for each cell of the input after which insertion ends, for "
        "min_dihedral.", ANGLES)
    insertion_least_effort: int = _chosen(
        2000, "Operations added to insertion_effort x cells.", STANDARD)
    insertion_enough: float = _chosen(
        0.03, "Least share of the seen cells that must gain for a pass to go on.", STANDARD)
    insertion_p1: tuple[float, float] = _chosen(
        (0.01, 0.04), "Shares of the cells, sorted by radius ratio, between which the price for "
        "the 1 % quantile falls to 0.", STANDARD)
    insertion_tail: float = _chosen(
        3.0, "Largest price for the 1 % quantile, in units of a regular cell.", STANDARD)
    insertion_flat: float = _chosen(
        2.0, "Price of a flat cell beside insertion_tail, in units of a regular cell.", STANDARD)
    insertion_worst: float = _chosen(
        20.0, "Weight a of the price a ((x0 / x)^4 - 1) of a cell with x < x0 = "
        "insertion_few x the least x; x is its radius ratio or sine.", STANDARD)
    insertion_few: float = _chosen(
        1.5, "Factor on the least radius ratio, sine or altitude: a cell below the "
        "product counts as one of the worst.", STANDARD)
    insertion_angles: float = _chosen(
        100.0, "Weight as insertion_worst, in passes for angles alone.", ANGLES)

    # figures of a state
    small_angle: float = _chosen(
        20.0, "Degrees below which a dihedral angle counts as small.", STANDARD)
    counted_small_angles: float = _chosen(
        0.1, "Largest share of small angles that lowers the score.", STANDARD)
    small_angle_price: float = _chosen(
        3.0, "Weight of the share of small angles in the score, which it lowers.", STANDARD)
    score_p1: float = _chosen(
        0.5, "Weight of the 1 % quantile of the radius ratio in the score; the mean has "
        "weight 1.", STANDARD)
    score_least: float = _chosen(0.25, "Weight of the least radius ratio in the score.", STANDARD)
    score_altitude: float = _chosen(
        4.0, "Weight of log(least altitude) in the score, for time_step.",
        "python examples/figures.py MESH... -- --objective time_step --boundary slide")

    # cycles and runs
    cycle_worth: float = _chosen(
        5e-4, "Least gain of the mean quality for which another cycle follows.", STANDARD)
    locked_quality: float = _chosen(
        0.3, "Least radius ratio of a new cell without a movable vertex, unless a worse "
        "one was there before.", STANDARD)
    locked_angles: tuple[float, float] = _chosen(
        (14.0, 157.0), "Degrees: least and largest angle of a new cell without a movable vertex, "
        "unless a worse one was there before.", STANDARD)
    poor_quality: float = _chosen(
        0.15, "Largest 1 % quantile of the radius ratio for which finishing alone, or a "
        "fixed boundary, is tried besides.", HARD)
    few_cells: int = _chosen(
        3000, "Largest number of cells for which a fixed boundary is tried beside one "
        "that slid.", HARD)
    few_movable: float = _chosen(
        0.02, "Largest share of movable vertices for which finishing alone is tried "
        "besides.", HARD)
    beyond: int = _chosen(
        100, "Largest number of cells beyond the extremes of the input for which a "
        "repair is tried.", HARD)
    beyond_turns: int = _chosen(20, "Largest number of turns of such a repair.", HARD)
    beyond_rings: int = _chosen(3, "Rings of cells around them that such a repair smooths.", HARD)
    notable_price: float = _chosen(
        5e-3, "Least mean quality given up to keep the figures that the report names.", HARD)
    slide_retreats: int = _chosen(
        4, "Largest number of runs in which a boundary slides again without the "
        "vertices that spoiled it.", HARD)

    # the boundary of tetrahedra that slides
    slide_guard: float = _chosen(
        0.97, "Factor on the envelope inside the guards; the rest is for rounding on the "
        "way back.", HARD)
    slide_volume: float = _chosen(
        2.9e-3, "Largest change of the volume, as a part of the volume.", STANDARD)
    slide_reserve: float = _chosen(0.4, "Part of slide_volume kept for the worst cells.", STANDARD)
    slide_cancel: float = _chosen(
        4.0, "Largest sum of abs(volume change) over all vertices, as a multiple of "
        "slide_volume; gains and losses cancel.", STANDARD)
    slide_unused: float = _chosen(
        1.2, "Factor on the budget of each vertex; some vertices leave theirs unused.", STANDARD)
    slide_turn: float = _chosen(
        30.0, "Degrees: largest angle between a boundary triangle and the input surface.", STANDARD)

    # curved surfaces
    surface_guard: float = _chosen(
        0.975, "Factor on the envelope inside the guards; the rest is for the bounds of "
        "the judge.", HARD)
    surface_lines: float = _chosen(
        0.5, "Part of the envelope within which feature lines may change when the "
        "boundary slides.", STANDARD)
    surface_turn: float = _chosen(
        60.0, "Degrees: largest angle between a new triangle and the ground under it.", STANDARD)
    surface_thin: float = _chosen(
        0.02, "Least radius ratio of a triangle that stage 1 may make worse.", STANDARD)
    surface_settled: float = _chosen(
        2e-3, "Largest fall of the energy in a round, as a part of it, at which stage 1 "
        "ends.", SURFACE)
    surface_halvings: int = _chosen(
        3, "Largest number of halvings of the envelope, each with runs of its own, "
        "before the input is returned.", HARD)
    surface_attempts: int = _chosen(
        4, "Largest number of runs within one envelope; each spares what broke the "
        "promise before, with one more ring.", HARD)
    surface_mendings: int = _chosen(
        8, "Largest number of times that bad places go back to the input; every second "
        "time with one more ring.", HARD)
    surface_loss: float = _chosen(
        0.02, "Largest mean quality given up for the promise before half of the envelope "
        "is tried.", HARD)
    surface_equal: float = _chosen(
        0.005, "Largest difference in mean quality for which the score chooses between "
        "surfaces.", HARD)
    surface_spoiled: float = _chosen(
        0.3, "Largest share of the vertices spared for triangles beyond the extremes of "
        "the input.", HARD)


def _documentation() -> str:
    """Docstring of :class:`Policy`: value, meaning and command of every number."""
    lines = [str(Policy.__doc__), "", "    Attributes", "    ----------"]
    for about in fields(Policy):
        lines += [f"    {about.name} : {about.type}, {about.default!r}",
                  f"        {about.metadata['meaning']}",
                  f"        ``{about.metadata['command']}``"]
    return "\n".join([*lines, "    "])


Policy.__doc__ = _documentation()

POLICY = Policy()
"""The numbers of this version."""
