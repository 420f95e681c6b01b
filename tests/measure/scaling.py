"""The scaling report: how time, memory, iterations and bytes grow with the number of cells."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from measure.bandwidth import bandwidth_part
from measure.blocks import blocks_part
from measure.cold import cold_part
from measure.generation import generation_part
from measure.ladder import ladder_part
from measure.local_global import forty_sweeps_part, races_part
from measure.multigrid import multigrid_part
from measure.part import Part
from measure.small import small_part
from measure.stages import stages_part, surface_part
from measure.threads import threads_part
from odt_plugins.compare.table import Say, as_text, shown
from odt_plugins.errors import writing
from odt_plugins.generate.clouds import SEED
from odt_plugins.report.machine import describe
from odt_plugins.report.template import fill_template

FILES = ("scaling.json", "scaling.html")

PARTS: dict[str, Callable[[Sequence[int], int, Say], Part]] = {
    "stages": stages_part,
    "surface": surface_part,
    "races": races_part,
    "forty-sweeps": forty_sweeps_part,
    "multigrid": multigrid_part,
    "bandwidth": bandwidth_part,
    "threads": threads_part,
    "blocks": blocks_part,
    "generation": generation_part,
    "ladder": ladder_part,
    "small": small_part,
    "cold": cold_part,
}
"""Every part of the report: takes the sizes, the number of threads, and whom to tell."""


def sizes_between(smallest: int, largest: int) -> list[int]:
    """The powers of sqrt(10) from the smallest on, and the largest."""
    return [*(round(10 ** (p / 2)) for p in range(6, 19)
              if smallest <= round(10 ** (p / 2)) < 0.9 * largest), largest]


def run_scaling(
    out: Path,
    largest: int,
    threads: int,
    say: Say,
    *,
    smallest: int = 10_000,
    parts: Sequence[str] = tuple(PARTS),
) -> str:
    """Measure, write FILES into `out`, and give the tables as text.

    Parameters
    ----------
    out : Path           is made
    largest : int        cells, or unknowns, of the largest mesh
    threads : int
    say : callable       is told, line by line, what is measured
    smallest : int       the sizes are the powers of sqrt(10) from here, and the largest
    parts : names        of PARTS

    Raises
    ------
    MeshFileError        `out` cannot be written to
    """
    sizes = sizes_between(smallest, largest)
    done = {name: PARTS[name](sizes, threads, say) for name in parts}
    tables = [table for part in done.values() for table in part.tables]
    facts = describe(threads, SEED)
    values = {"machine": facts, "tables": [asdict(table) for table in tables]}
    for part in done.values():
        values |= part.values
    page = fill_template(Path(__file__).with_suffix(".html"), facts=facts, tables=tables,
                         shown=shown,
                         charts=[chart for part in done.values() for chart in part.charts])
    with writing(f"into {out}", "another --out"):
        out.mkdir(parents=True, exist_ok=True)
        (out / FILES[0]).write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
        (out / FILES[1]).write_text(page, encoding="utf-8")
    return "\n".join(line for table in tables for line in as_text(table))
