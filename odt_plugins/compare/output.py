"""What a comparison leaves behind: CSV, JSON, Markdown, LaTeX, BibTeX and one HTML page."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import Any

from odt_plugins.compare.cells import best_figures, cells_of, seconds
from odt_plugins.compare.charts import colour, histograms, quality_against_time
from odt_plugins.compare.contestants import OURS
from odt_plugins.compare.manuscript import (
    TEMPLATES,
    inputs_table,
    settings_table,
    to_bibtex,
    to_latex,
    to_markdown,
)
from odt_plugins.compare.measures import FURTHER
from odt_plugins.compare.pictures import worst_cells
from odt_plugins.compare.rows import Measured, MeshResult, Row
from odt_plugins.compare.runner import Limits
from odt_plugins.compare.score import score_table, scores, verdict
from odt_plugins.errors import writing
from odt_plugins.generate.clouds import SEED
from odt_plugins.report.machine import describe
from odt_plugins.report.template import fill_template

FILES = ("comparison.csv", "comparison.json", "comparison.html", "comparison.md",
         "comparison.tex", "comparison.bib")
"""What is written; LaTeX finds in the last what the tables cite."""

Facts = dict[str, str | int]


def write_rows_of(out: Path, name: str, rows: Sequence[Any], limits: Limits) -> None:
    """Write what one suite measured into a file of the directory `out`, which is made.

    Raises
    ------
    MeshFileError             `out` cannot be written to
    """
    values = {"machine": describe(limits.threads, SEED), "rows": rows}
    with writing(f"into {out}", "another --out"):
        out.mkdir(parents=True, exist_ok=True)
        (out / name).write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")


def write_all(out: Path, results: Sequence[MeshResult], facts: Facts, command: str) -> None:
    """Write all of FILES into the directory `out`, which is made.

    Raises
    ------
    MeshFileError             `out` cannot be written to
    MissingDependencyError    jinja2 is not installed
    """
    given = results, facts, command
    texts = (to_csv(results), to_json(*given), to_page(*given), to_markdown(*given),
             to_latex(*given), to_bibtex(results))
    with writing(f"into {out}", "another --out"):
        out.mkdir(parents=True, exist_ok=True)
        for name, text in zip(FILES, texts, strict=True):
            (out / name).write_text(text, encoding="utf-8")


def to_json(results: Sequence[MeshResult], facts: Facts, command: str) -> str:
    """Everything, with numbers that are not finite as null."""
    meshes = [{"name": r.start.name, "kind": r.start.kind, "origin": r.start.origin,
               "sha256": r.start.sha256,
               "start": _measured_dict(r.measured), "rows": [row.to_dict() for row in r.rows]}
              for r in results]
    whole = {"command": command, "machine": facts, "meshes": meshes,
             "score": [score._asdict() for score in scores(results)]}
    return json.dumps(_finite(whole), indent=1, allow_nan=False) + "\n"


def to_csv(results: Sequence[MeshResult]) -> str:
    """One line for the start and for every row, the same columns for all."""
    lines = []
    for result in results:
        base = {"mesh": result.start.name, "kind": result.start.kind, "sha256": result.start.sha256}
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
        "name": r.start.name, "kind": r.start.kind, "about": r.start.about,
        "sha256": r.start.sha256,
        "unit": "angle" if r.measured.summary.dim == 2 else "dihedral",
        "start": cells_of(r.measured), "rows": [_page_row(i, row, r.rows)
                                                for i, row in enumerate(r.rows, 1)],
        "verdict": verdict(r), "time_chart": quality_against_time(r),
        "histograms": histograms(r), "picture": worst_cells(r),
        "families": [(f, colour(f)) for f in dict.fromkeys(row.family for row in r.rows)],
    } for r in results]
    return fill_template(TEMPLATES / "comparison.html", sections=sections, facts=facts,
                         command=command,
                         ours=OURS, further=FURTHER, score=score_table(results),
                         tables=[inputs_table(results), settings_table(results)])


def _page_row(number: int, row: Row, rows: Sequence[Row]) -> dict[str, Any]:
    notes = [row.remark, row.message if row.status == "ok" else ""]
    if row.repeats_itself is False:
        notes.append("does not repeat itself" + (f", mean q differs by {row.spread:.1e}"
                                                 if row.spread > 5e-5 else " bit for bit"))
    out: dict[str, Any] = {
        "number": number, "name": row.contestant, "family": row.family,
        "colour": colour(row.family), "status": row.status, "message": row.message,
        "better": set(row.better_than_ours), "best": set(), "version": row.version or "",
        "lost": "freer" if row.freer else "lost",
        "notes": "; ".join(n for n in notes if n), "cells": None,
        "repeats": row.timing.runs if row.timing else 0,
    } | dict.fromkeys(("median", "cpu", "spread", "memory", "growth", "convert", "imports",
                       "compile"), "")
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


def _measured_dict(measured: Measured) -> dict[str, Any]:
    p = measured.poisson
    return {"summary": measured.summary.to_dict(), "histogram": measured.histogram,
            "further": measured.further,
            "poisson": vars(p) if p else None}


def _columns(measured: Measured) -> dict[str, Any]:
    p = measured.poisson
    return {**measured.summary.to_dict(), "boundary": measured.boundary.verdict,
            "regions_ignored": measured.regions_ignored,
            "boundary_outward": measured.boundary.outward,
            "boundary_inward": measured.boundary.inward,
            "volume_change": measured.volume_change,
            **measured.further,
            **({f"poisson_{k}": v for k, v in vars(p).items()} if p else {})}


def _row_columns(row: Row) -> dict[str, Any]:
    t = row.timing
    out: dict[str, Any] = {
        "contestant": row.contestant, "status": row.status, "message": row.message,
        "version": row.version, "threads": row.threads, "seed": row.seed,
        "better_than_ours": " ".join(row.better_than_ours), "freer": row.freer,
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
