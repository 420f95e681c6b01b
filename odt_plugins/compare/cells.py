"""Figures of the comparison as the words that stand in its tables."""

from __future__ import annotations

from collections.abc import Sequence

from odt_plugins.compare.rows import Measured, Row

BETTER, FREER = "▲", "△"
"""Marks of a figure that is better than ours, and of one that is better by more freedom."""


def cells_of(measured: Measured) -> dict[str, str]:
    """Figures of a mesh as the words that stand in the tables."""
    s, b, p = measured.summary, measured.boundary, measured.poisson
    boundary = farthest = b.verdict
    if b.verdict == "moved" and b.outward is not None and b.inward is not None:
        boundary = f"moved {b.outward:.0e} / {b.inward:.0e}"
        farthest = f"moved {b.reach:.0e}"
    if measured.regions_ignored:
        boundary, farthest = f"{boundary}, regions ignored", f"{farthest}, regions ignored"
    change = measured.volume_change
    return {
        "min_quality": f"{s.min_quality:.4f}", "p1_quality": f"{s.p1_quality:.3f}",
        "mean_quality": f"{s.mean_quality:.4f}", "min_angle": f"{s.min_angle:.1f}",
        "max_angle": f"{s.max_angle:.1f}", "below_5": str(s.below_5),
        "below_10": str(s.below_10), "below_20": str(s.below_20),
        "inverted": str(s.inverted), "uniformity": f"{100 * s.uniformity:.1f}",
        "n_points": str(s.n_points), "n_cells": str(s.n_cells), "boundary": boundary,
        "farthest": farthest,
        "volume": "" if change is None else "0" if abs(change) < 1e-12 else f"{change:+.0e}",
        "condition": f"{p.condition:.3g}" if p else "", "cg": str(p.cg_steps) if p else "",
        "amg": str(p.amg_steps) if p else "", "l2": f"{p.l2_error:.2e}" if p else "",
        "h1": f"{p.h1_error:.4f}" if p else "",
        **{name: f"{value:.3f}" for name, value in measured.further.items()},
    }


def seconds(value: float) -> str:
    """Seconds with two decimals, or with as many as show two digits."""
    return f"{value:.2f}" if value >= 0.1 else f"{value:.2g}"


def marked(row: Row, figure: str, text: str) -> str:
    """Put the mark before a figure in which a row is better than ours."""
    mark = FREER if row.freer else BETTER
    return f"{mark}{text}" if figure in row.better_than_ours else text


def best_figures(row: Row, rows: Sequence[Row]) -> set[str]:
    """Figures in which nobody without inverted cells is better than this row."""
    sound = [r.measured.summary for r in rows if r.measured and not r.measured.summary.inverted]
    if row.measured is None or row.measured.summary.inverted or not sound:
        return set()
    mine = row.measured.summary
    best = {n for n in ("min_quality", "p1_quality", "mean_quality", "min_angle")
            if getattr(mine, n) >= max(getattr(s, n) for s in sound)}
    return best | {n for n in ("max_angle", "below_20")
                   if getattr(mine, n) <= min(getattr(s, n) for s in sound)}
