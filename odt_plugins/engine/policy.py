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
    settled_rounds: int = _chosen(8, "Stage 1 ends when so many rounds", STAGES)
    settled_energy: float = _chosen(
        1.6e-3, "have lowered the least energy by less than this part of it,", STAGES)
    stirred_settled: float = _chosen(
        8e-3, "or this part times the share of vertices that may move, where sweeps go beyond "
        "the centres of the stars.", STAGES)
    exchange_cells: int = _chosen(
        20_000, "Most cells for which connectivity 'auto' asks scipy in the first round; beyond, "
        "local flips are cheaper.", STAGES)
    flips_quality: float = _chosen(
        0.6, "Mean quality of tetrahedra from which on local flips do as well as scipy, in three "
        "quarters of the time.", STANDARD)
    exchange_move: float = _chosen(
        0.1, "Longest move, in edge lengths, above which scipy is asked (Section 3.2).",
        STANDARD)
    stirred: float = _chosen(
        2.1, "First alpha of ODT sweeps in space when finishing follows: the energy leaves "
        "shallow minima;", STANDARD)
    stirred_rounds: int = _chosen(8, "for so many rounds.", STANDARD)
    overrelaxed: float = _chosen(2.0, "The same in later rounds.", STANDARD)
    damped: float = _chosen(
        0.8, "First alpha of Jacobi sweeps, whose limit of stability is 1.", STANDARD)
    energy_ring: int = _chosen(
        5, "Longest ring of an edge that is removed for the sake of the energy.", STAGES)
    energy_passes: int = _chosen(
        1, "Passes of energy flips in a round; what is left pending waits for the next round.",
        STAGES)
    scattered: float = _chosen(
        0.2, "Cells are sorted again after more flips than this part of their number.", STAGES)

    # stage 2
    volume_gain: float = _chosen(
        3e-3, "A vertex of tetrahedra whose star gained less than this part of F_p wakes no "
        "neighbour.", STAGES)
    plane_gain: float = _chosen(1e-3, "The same in the plane.", STANDARD)
    surface_gain: float = _chosen(3e-3, "The same on a curved surface.", SURFACE)
    quality_ring: int = _chosen(
        10, "Longest ring of an edge that is removed for the sake of the quality.", STANDARD)
    quality_passes: int = _chosen(4, "Passes of quality flips in a round.", STAGES)
    reconnected: float = _chosen(
        0.01, "Largest share of the cells around which a phase fills polyhedra anew.", STANDARD)
    compound_rare: float = _chosen(
        5e-3, "Compound moves end where they pay at less than this part of the cells.", STANDARD)
    many_small_angles: float = _chosen(
        0.08, "Share of cells with a small angle up to which phases look after them: where there "
        "are more they do not decide.", HARD)
    polished: float = _chosen(
        0.02, "Largest share of the cells from which a phase for small angles alone starts.",
        STANDARD)
    polished_rings: int = _chosen(
        4, "Rings of cells around small angles that are changed for their sake.", STANDARD)

    # insertion
    insertion_rounds: int = _chosen(
        10, "Most rounds of insertion, each followed by finishing.", STANDARD)
    insertion_worth: float = _chosen(
        1e-3, "Gain of the score for which a round is followed by another.", STANDARD)
    insertion_effort: float = _chosen(
        0.5, "Insertion ends when it has tried so many operations for every cell of the input,",
        STANDARD)
    insertion_angles_effort: float = _chosen(
        1.0, "(so many for the objective min_dihedral)", ANGLES)
    insertion_least_effort: int = _chosen(2000, "and so many besides.", STANDARD)
    insertion_enough: float = _chosen(
        0.03, "A pass over the cells, worst first, ends where less than this part of them gained.",
        STANDARD)
    insertion_p1: tuple[float, float] = _chosen(
        (0.01, 0.04), "Shares of the cells between which a cell counts for the 1 % quantile, less "
        "and less.", STANDARD)
    insertion_tail: float = _chosen(
        3.0, "Most that one of those costs, in units of a regular cell.", STANDARD)
    insertion_flat: float = _chosen(
        2.0, "What a flat cell costs besides.", STANDARD)
    insertion_worst: float = _chosen(
        20.0, "A fifteenth of what a cell costs besides that has half of the radius ratio, or of "
        "the sine of an angle, at which the very worst begin:", STANDARD)
    insertion_few: float = _chosen(
        1.5, "so many times the least that there is.", STANDARD)
    insertion_angles: float = _chosen(
        100.0, "The same in passes for angles alone, where it outweighs all else.", ANGLES)

    # figures of a state
    small_angle: float = _chosen(
        20.0, "Dihedral angle in degrees below which a cell is looked after on its own.", STANDARD)
    counted_small_angles: float = _chosen(
        0.1, "Share of small angles beyond which the score counts no more of them.", STANDARD)
    small_angle_price: float = _chosen(
        3.0, "Of a tetrahedron with a small angle in the score: what three regular ones add to it.",
        STANDARD)
    score_p1: float = _chosen(
        0.5, "Weight of the 1 % quantile of the radius ratio in the score; that of the mean is 1.",
        STANDARD)
    score_least: float = _chosen(0.25, "Weight of the least radius ratio.", STANDARD)
    score_altitude: float = _chosen(
        4.0, "Weight of the logarithm of the least altitude for the objective time_step.",
        "python examples/figures.py MESH... -- --objective time_step --boundary slide")

    # cycles and runs
    cycle_worth: float = _chosen(
        5e-4, "Gain of the mean quality for which a cycle is worth its time.", STANDARD)
    locked_quality: float = _chosen(
        0.3, "Radius ratio that a cell without a movable vertex must reach when there was no "
        "worse one before,", STANDARD)
    locked_angles: tuple[float, float] = _chosen(
        (14.0, 157.0), "and its smallest and largest angle, in degrees.", STANDARD)
    poor_quality: float = _chosen(
        0.15, "1 % quantile of the radius ratio below which finishing alone, or a fixed boundary, "
        "is tried besides.", HARD)
    few_cells: int = _chosen(
        3000, "Number of cells below which a fixed boundary is tried beside one that slid.", HARD)
    few_movable: float = _chosen(
        0.02, "Share of the vertices that may move below which finishing alone is tried besides.",
        HARD)
    beyond: int = _chosen(
        100, "Most cells beyond the extremes of the input that are brought back on their own", HARD)
    beyond_turns: int = _chosen(20, "in so many turns at most,", HARD)
    beyond_rings: int = _chosen(3, "so many rings of cells around them smoothed in between.", HARD)
    notable_price: float = _chosen(
        5e-3, "Mean quality that was given up to keep the figures and is worth a word.", HARD)
    slide_retreats: int = _chosen(
        4, "How often a boundary slides again, with those vertices left alone at which it was "
        "spoiled.", HARD)

    # the boundary of tetrahedra that slides
    slide_guard: float = _chosen(
        0.97, "Part of the envelope that the guards allow; the rest is for the rounding of the way "
        "back.", HARD)
    slide_volume: float = _chosen(
        2.9e-3, "Largest change of the volume, as a part of it.", STANDARD)
    slide_reserve: float = _chosen(
        0.4, "Part of that change which is kept for the worst cells.", STANDARD)
    slide_cancel: float = _chosen(
        4.0, "Most that |change of volume|, summed over all vertices, may be, as a multiple of "
        "that change: gains and losses cancel.",
        STANDARD)
    slide_unused: float = _chosen(
        1.2, "A further factor, since not every vertex uses up what it has.", STANDARD)
    slide_turn: float = _chosen(
        30.0, "Degrees by which a boundary triangle may be turned against the input surface.",
        STANDARD)

    # curved surfaces
    surface_guard: float = _chosen(
        0.975, "Part of the envelope that the guards use; the rest is for the bounds of the judge.",
        HARD)
    surface_lines: float = _chosen(
        0.5, "Part of the envelope by which feature lines may change when the boundary slides.",
        STANDARD)
    surface_turn: float = _chosen(
        60.0, "Degrees by which the normal of a new triangle may differ from that of the ground "
        "under it.", STANDARD)
    surface_thin: float = _chosen(
        0.02, "Radius ratio below which stage 1 makes no triangle worse.", STANDARD)
    surface_settled: float = _chosen(
        2e-3, "Stage 1 ends with a round that lowers the energy by less than this part of it.",
        SURFACE)
    surface_halvings: int = _chosen(
        3, "Halvings of the envelope, each with runs of its own, until the input is returned.",
        HARD)
    surface_attempts: int = _chosen(
        4, "Runs within one envelope; each leaves alone what broke the promise in those "
        "before, with one more ring of triangles around it every time.", HARD)
    surface_mendings: int = _chosen(
        8, "How often a surface goes back to the input around its bad places; every second time "
        "with one more ring of triangles.", HARD)
    surface_loss: float = _chosen(
        0.02, "Mean quality that the promise may cost a surface before it is tried within half of "
        "the envelope.", HARD)
    surface_equal: float = _chosen(
        0.005, "Mean quality by which surfaces may differ that are chosen by their score.", HARD)
    surface_spoiled: float = _chosen(
        0.3, "Part of the vertices that may be left alone because of triangles beyond the input's "
        "extremes.", HARD)


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
