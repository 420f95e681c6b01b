"""The comparison as Markdown tables, one for every kind of mesh, for a README or a paper."""

from __future__ import annotations

from collections.abc import Sequence

from odt_plugins.compare.contestants import OURS
from odt_plugins.compare.rows import MeshResult, Row
from odt_plugins.quality import QualitySummary

TITLES = {"tets": "Tetrahedra", "planar": "Triangles in the plane", "surface": "Surfaces"}


def to_markdown(results: Sequence[MeshResult], command: str) -> str:
    """Give one table for every kind of mesh: a line for every contestant, a column for every mesh.

    Parameters
    ----------
    results : sequence of MeshResult
    command : str                       that made them, written above

    Returns
    -------
    str    a cell holds least / 1 % / mean radius ratio, cells below 20 degrees, seconds, what
           else there is to know; ▲ where a figure is better than ours
    """
    parts = ["```sh", command, "```"]
    for kind, title in TITLES.items():
        chosen = [r for r in results if r.start.kind == kind]
        if chosen:
            parts += ["", f"**{title}**", "", *_table(chosen)]
    return "\n".join(parts) + "\n"


def _table(results: Sequence[MeshResult]) -> list[str]:
    names = list(dict.fromkeys(row.contestant for r in results for row in r.rows))
    head = [f"{r.start.name} ({r.measured.summary.n_cells} cells)" for r in results]
    lines = ["| | " + " | ".join(head) + " |", "|---" * (len(results) + 1) + "|"]
    lines.append("| start | " + " | ".join(_figures(r.measured.summary, ()) for r in results)
                 + " |")
    for name in names:
        rows = [next((row for row in r.rows if row.contestant == name), None) for r in results]
        shown = f"**{name}**" if name == OURS else name
        lines.append(f"| {shown} | " + " | ".join(_cell(row, r) for row, r in
                                                  zip(rows, results, strict=True)) + " |")
    return lines


def _cell(row: Row | None, result: MeshResult) -> str:
    if row is None:
        return ""
    if row.measured is None or row.timing is None:
        return row.status
    seconds = row.timing.median
    time = f"{seconds:.1f} s" if seconds >= 0.1 else f"{seconds:.1g} s"
    text = f"{_figures(row.measured.summary, row.better_than_ours)}, {time}"
    return text + "".join(f", {note}" for note in _notes(row, result))


def _figures(summary: QualitySummary, better: Sequence[str]) -> str:
    def marked(name: str, text: str) -> str:
        return f"▲{text}" if name in better else text

    q = " / ".join((marked("min_quality", f"{summary.min_quality:.3f}"),
                    marked("p1_quality", f"{summary.p1_quality:.3f}"),
                    marked("mean_quality", f"{summary.mean_quality:.3f}")))
    return f"{q}; {marked('below_20', str(summary.below_20))}"


def _notes(row: Row, result: MeshResult) -> list[str]:
    """What must be known: inverted cells, another number of vertices, a boundary that moved."""
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
        far = max(boundary.outward, boundary.inward or 0.0)
        notes.append(f"{'surface' if row.kind != 'planar' else 'boundary'} moved {far:.0e}")
    return notes
