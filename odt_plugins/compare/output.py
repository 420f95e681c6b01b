"""What a comparison leaves behind: CSV, JSON, Markdown and one HTML page in a single file."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import Any

from odt_plugins.compare.charts import colour, histograms, quality_against_time
from odt_plugins.compare.contestants import OURS
from odt_plugins.compare.markdown import to_markdown
from odt_plugins.compare.pictures import worst_cells
from odt_plugins.compare.rows import Measured, MeshResult, Row
from odt_plugins.errors import require, writing

FILES = ("comparison.csv", "comparison.json", "comparison.html", "comparison.md")

SHORT = {"min_quality": "least q", "p1_quality": "1 % q", "mean_quality": "mean q",
         "min_angle": "least angle", "max_angle": "largest angle", "below_20": "below 20°",
         "seconds": "time"}
"""Names of figures in sentences and table heads."""

Facts = dict[str, str | int]


def check_page() -> None:
    """See whether the page can be made, before any work is done.

    Raises
    ------
    MissingDependencyError    jinja2 is not installed
    """
    require("the page of the comparison", "compare", "jinja2")


def write_all(out: Path, results: Sequence[MeshResult], facts: Facts, command: str) -> None:
    """Write all of FILES into the directory `out`, which is made.

    Raises
    ------
    MeshFileError             `out` cannot be written to
    MissingDependencyError    jinja2 is not installed
    """
    with writing(f"into {out}", "another --out"):
        out.mkdir(parents=True, exist_ok=True)
        (out / FILES[3]).write_text(to_markdown(results, command), encoding="utf-8")
        (out / FILES[0]).write_text(to_csv(results), encoding="utf-8")
        (out / FILES[1]).write_text(to_json(results, facts, command), encoding="utf-8")
        (out / FILES[2]).write_text(to_page(results, facts, command), encoding="utf-8")


def to_json(results: Sequence[MeshResult], facts: Facts, command: str) -> str:
    """Everything, with numbers that are not finite as null."""
    meshes = [{"name": r.start.name, "kind": r.start.kind, "origin": r.start.origin,
               "start": _measured_dict(r.measured), "rows": [row.to_dict() for row in r.rows]}
              for r in results]
    whole = {"command": command, "machine": facts, "meshes": meshes}
    return json.dumps(_finite(whole), indent=1, allow_nan=False) + "\n"


def to_csv(results: Sequence[MeshResult]) -> str:
    """One line for the start and for every row, the same columns for all."""
    lines = []
    for result in results:
        base = {"mesh": result.start.name, "kind": result.start.kind}
        lines.append(base | {"contestant": "start", "status": "ok"} | _columns(result.measured))
        for row in result.rows:
            lines.append(base | _row_columns(row))
    names = list(dict.fromkeys(name for line in lines for name in line))
    text = StringIO()
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(_finite(lines))
    return text.getvalue()


def to_page(results: Sequence[MeshResult], facts: Facts, command: str) -> str:
    """The page, filled from the template.

    Raises
    ------
    MissingDependencyError    jinja2 is not installed
    """
    sections = [{
        "name": r.start.name, "kind": r.start.kind, "origin": r.start.origin,
        "unit": "angle" if r.measured.summary.dim == 2 else "dihedral",
        "start": cells_of(r.measured), "rows": [_page_row(i, row, r.rows)
                                                for i, row in enumerate(r.rows, 1)],
        "verdict": verdict(r), "time_chart": quality_against_time(r),
        "histograms": histograms(r), "picture": worst_cells(r),
        "families": [(f, colour(f)) for f in dict.fromkeys(row.family for row in r.rows)],
    } for r in results]
    return fill_template("comparison.html", sections=sections, facts=facts, command=command,
                         ours=OURS)


def fill_template(name: str, **values: Any) -> str:
    """Fill one of the package's templates.

    Raises
    ------
    MissingDependencyError    jinja2 is not installed
    """
    check_page()
    from jinja2 import Environment, PackageLoader, StrictUndefined

    loader = PackageLoader("odt_plugins.compare")
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined,
                              trim_blocks=True, lstrip_blocks=True)
    return environment.get_template(name).render(**values)


def verdict(result: MeshResult) -> str:
    """Say in one or two sentences what ours loses and to whom."""
    ours = next((r for r in result.rows if r.contestant == OURS), None)
    if ours is None:
        return ""
    if ours.measured is None:
        return f"{OURS} has no result here: {ours.status}, {ours.message}"
    by_figure: dict[str, list[str]] = {}
    for row in result.rows:
        for name in row.better_than_ours:
            if name != "seconds":
                by_figure.setdefault(name, []).append(row.contestant)
    if not by_figure:
        return f"No other tool is better than {OURS} in any figure of quality."
    lost = "; ".join(f"{SHORT[name]}: {', '.join(who)}" for name, who in by_figure.items())
    return f"Better than {OURS} in {lost}."


def cells_of(measured: Measured) -> dict[str, str]:
    """Figures of a mesh as the words that stand in the tables."""
    s, b, p = measured.summary, measured.boundary, measured.poisson
    boundary = farthest = b.verdict
    if b.verdict == "moved" and b.outward is not None and b.inward is not None:
        boundary = f"moved {b.outward:.0e} / {b.inward:.0e}"
        farthest = f"moved {max(b.outward, b.inward):.0e}"
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
    }


def seconds(value: float) -> str:
    """Seconds with two decimals, or with as many as show two digits."""
    return f"{value:.2f}" if value >= 0.1 else f"{value:.2g}"


def _page_row(number: int, row: Row, rows: Sequence[Row]) -> dict[str, Any]:
    notes = [row.remark, row.message if row.status == "ok" else ""]
    if row.repeats_itself is False:
        notes.append("does not repeat itself" + (f", mean q differs by {row.spread:.1e}"
                                                 if row.spread > 5e-5 else " bit for bit"))
    out: dict[str, Any] = {
        "number": number, "name": row.contestant, "family": row.family,
        "colour": colour(row.family), "status": row.status, "message": row.message,
        "better": set(row.better_than_ours), "best": set(), "version": row.version or "",
        "notes": "; ".join(n for n in notes if n), "cells": None,
        "repeats": row.timing.runs if row.timing else 0,
    }
    if row.timing is not None:
        t = row.timing
        out |= {"median": seconds(t.median), "cpu": seconds(t.cpu),
                "spread": "" if t.runs == 1 else f"{seconds(t.least)}..{seconds(t.most)}",
                "memory": f"{t.peak / 1e6:.0f}", "growth": f"{t.growth / 1e6:.0f}",
                "convert": f"{t.convert:.2f}", "imports": f"{t.imports:.1f}",
                "compile": "" if t.compile is None else f"{t.compile:.1f}"}
    if row.measured is not None:
        out["cells"] = cells_of(row.measured)
        out["best"] = best_figures(row, rows)
    return out


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


def _measured_dict(measured: Measured) -> dict[str, Any]:
    p = measured.poisson
    return {"summary": measured.summary.to_dict(), "histogram": measured.histogram,
            "poisson": vars(p) if p else None}


def _columns(measured: Measured) -> dict[str, Any]:
    p = measured.poisson
    return {**measured.summary.to_dict(), "boundary": measured.boundary.verdict,
            "boundary_outward": measured.boundary.outward,
            "boundary_inward": measured.boundary.inward,
            "volume_change": measured.volume_change,
            **({f"poisson_{k}": v for k, v in vars(p).items()} if p else {})}


def _row_columns(row: Row) -> dict[str, Any]:
    t = row.timing
    out: dict[str, Any] = {
        "contestant": row.contestant, "status": row.status, "message": row.message,
        "version": row.version, "threads": row.threads, "seed": row.seed,
        "better_than_ours": " ".join(row.better_than_ours),
    }
    if row.measured is not None:
        out |= _columns(row.measured)
    if t is not None:
        out |= {"seconds": t.median, "seconds_min": t.least, "seconds_max": t.most,
                "repeats": t.runs, "seconds_cpu": t.cpu,
                "seconds_convert": t.convert, "seconds_import": t.imports,
                "seconds_compile": t.compile, "peak_bytes": t.peak, "growth_bytes": t.growth,
                "repeats_itself": row.repeats_itself, "mean_quality_spread": row.spread}
    return out


def _finite(value: Any) -> Any:
    """Replace numbers that are not finite by None, all the way down."""
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
