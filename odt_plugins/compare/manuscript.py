"""What goes into a README or a paper: Markdown, LaTeX tables (booktabs), BibTeX of the tools.

jinja2 fills the templates; what is made here is the text of each field.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from odt_plugins.compare.cells import best_figures, cells_of, marked
from odt_plugins.compare.contestants import KINDS, OURS, OWN
from odt_plugins.compare.rows import RIVALRY, Measured, MeshResult, Row
from odt_plugins.compare.score import score_table
from odt_plugins.compare.table import Table, Value
from odt_plugins.report.template import fill_template, tex

TEMPLATES = Path(__file__).parent / "templates"

HEADS = ("mesh", "vertices", "cells", "regions", "origin", "sha256")

INPUTS = ("sha256 of the file; of a mesh made on the fly, of its points (float64) and cells "
          "(int32)",)

MARKS = (f"▲ better than {OURS} by default. △ better as well, but no plain win: the tool moved the "
         "surface further, or ignored the regions.")

CITED = {OURS: f"{OURS},ChenHolst2011"}
"""Keys of BibTeX of a family where they are not its name."""

COLUMNS = {"min_quality": r"$q_{\min}$", "p1_quality": r"$q_{1\%}$", "mean_quality": r"$\bar q$",
           "min_angle": r"$\theta_{\min}$", "max_angle": r"$\theta_{\max}$",
           "below_20": r"$<20^\circ$"}
"""Figures in the tables of LaTeX."""


def to_markdown(results: Sequence[MeshResult], facts: Mapping[str, Any], command: str) -> str:
    """Give one table for every kind of mesh: a line for every contestant, a column for every mesh.

    Parameters
    ----------
    results : sequence of MeshResult
    facts : mapping                     of the machine
    command : str                       that made them, written above

    Returns
    -------
    str    a cell holds least / 1 % / mean radius ratio, cells below 20 degrees, seconds, what
           else there is to know; then the counts, the inputs, the tools and their settings

    Raises
    ------
    MissingDependencyError    jinja2 is not installed
    """
    tables = [_by_kind(title[0].upper() + title[1:], chosen) for kind, title in KINDS.items()
              if (chosen := [r for r in results if r.start.kind == kind])]
    score = score_table(results)
    tables += [*([score] if score else []), inputs_table(results), settings_table(results)]
    return fill_template(TEMPLATES / "comparison.md", tables=tables, command=command,
                         facts=facts, marks=MARKS)


def to_latex(results: Sequence[MeshResult], facts: Mapping[str, Any], command: str) -> str:
    """Give one table of booktabs for every mesh, one of the counts, one of the settings.

    Raises
    ------
    MissingDependencyError    jinja2 is not installed
    """
    meshes = [{"start": r.start, "kind": KINDS[r.start.kind],
               "rows": [["start", "", *_tex_figures(r.measured), ""],
                        *(_tex_row(row, r.rows) for row in r.rows)]} for r in results]
    return fill_template(TEMPLATES / "comparison.tex", meshes=meshes,
                         columns=list(COLUMNS.values()), score=score_table(results),
                         settings=settings_table(results), facts=facts, command=command,
                         marks=MARKS)


def to_bibtex(results: Sequence[MeshResult]) -> str:
    """Give the entries of the tools that have a row.

    Raises
    ------
    MissingDependencyError    jinja2 is not installed
    """
    versions = {row.family: row.version or "" for r in results for row in r.rows}
    return fill_template(TEMPLATES / "comparison.bib", versions=versions)


def inputs_table(results: Sequence[MeshResult]) -> Table:
    """Give what every contestant started from."""
    return Table("inputs", "Inputs", HEADS, [
        (r.start.name, len(r.start.points), len(r.start.cells), r.start.n_regions, r.start.origin,
         r.start.sha256) for r in results], INPUTS)


def settings_table(results: Sequence[MeshResult]) -> Table:
    """Give version and settings of every contestant that was run."""
    rows = [(row.contestant, row.version or "", json.dumps(row.settings, ensure_ascii=False))
            for r in results for row in r.rows if row.settings]
    return Table(
        "settings", "Tools and their settings", ("contestant", "version", "settings"),
        list(dict.fromkeys(rows)),
        ("Settings as this package hands them to the tool, by the tool's own names; what is not "
         "named is the tool's default.",))


def _by_kind(title: str, results: Sequence[MeshResult]) -> Table:
    names = dict.fromkeys(row.contestant for r in results for row in r.rows)
    heads = [f"{r.start.name} ({r.measured.summary.n_cells} cells)" for r in results]
    rows: list[tuple[Value, ...]] = [("start", *(_figures(r.measured) for r in results))]
    for name in names:
        found = [next((row for row in r.rows if row.contestant == name), None) for r in results]
        rows.append((f"**{name}**" if name == OURS else name,
                     *(_cell(row, r) for row, r in zip(found, results, strict=True))))
    return Table(title, title, ("", *heads), rows)


def _cell(row: Row | None, result: MeshResult) -> str:
    if row is None:
        return ""
    if row.measured is None:
        return row.status
    time = []
    if row.timing is not None:
        seconds = row.timing.median
        time = [f"{seconds:.1f} s" if seconds >= 0.1 else f"{seconds:.1g} s"]
    return ", ".join([_figures(row.measured, row), *time, *_notes(row, result)])


def _figures(measured: Measured, row: Row | None = None) -> str:
    summary = measured.summary
    shown = {name: f"{getattr(summary, name):.3f}" for name in RIVALRY[:3]}
    shown["below_20"] = str(summary.below_20)
    if row is not None:
        shown = {name: marked(row, name, text) for name, text in shown.items()}
    *q, below = shown.values()
    return f"{' / '.join(q)}; {below}"


def _notes(row: Row, result: MeshResult) -> list[str]:
    """What must be known: inverted cells, other vertices, a boundary that moved, lost regions."""
    if row.measured is None:
        return []
    summary, boundary = row.measured.summary, row.measured.boundary
    notes = []
    if summary.inverted:
        notes.append(f"{summary.inverted} inverted")
    more = summary.n_points - result.measured.summary.n_points
    if more:
        notes.append(f"{more:+d} {'vertex' if abs(more) == 1 else 'vertices'}")
    if boundary.verdict == "moved" and boundary.outward is not None:
        place = "surface" if row.kind != "planar" else "boundary"
        notes.append(f"{place} moved {boundary.reach:.0e}")
    if row.measured.regions_ignored:
        notes.append("regions ignored")
    return notes


def _tex_row(row: Row, rows: Sequence[Row]) -> list[str]:
    name = tex(row.contestant)
    keys = CITED.get(row.family, row.family)
    cited = "" if row.family == OWN else rf"~\cite{{{keys}}}"
    name = (rf"\textbf{{{name}}}" if row.contestant == OURS else name) + cited
    if row.measured is None:
        return [name, tex(f"{row.status}: {row.message}")]
    figures = _tex_figures(row.measured, row, best_figures(row, rows))
    inverted = row.measured.summary.inverted
    notes = cells_of(row.measured)["farthest"] + (f", {inverted} inverted" if inverted else "")
    return [name, f"{row.timing.median:.3g}" if row.timing else "", *figures, tex(notes)]


def _tex_figures(measured: Measured, row: Row | None = None, best: set[str] | None = None
                 ) -> list[str]:
    cells = cells_of(measured)
    out = []
    for name in COLUMNS:
        text = rf"\textbf{{{cells[name]}}}" if name in (best or ()) else cells[name]
        mark = tex(marked(row, name, "")) if row else ""
        out.append(text + mark)
    return out
