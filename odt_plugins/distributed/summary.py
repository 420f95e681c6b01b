"""The summary of a batch: one row for every input as CSV, Parquet and one HTML page."""

from __future__ import annotations

import csv
import os
import tempfile
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import Any

from odt_plugins.distributed.job import WRITTEN
from odt_plugins.errors import require, writing
from odt_plugins.figures import QualitySummary
from odt_plugins.report.machine import describe
from odt_plugins.report.template import fill_template

FILES = ("summary.csv", "summary.parquet", "summary.html")

TEMPLATE = Path(__file__).parent / "templates" / "batch.html"

FIRST = ("source", "result", "status", "message", "seconds", "tetwild_seconds",
         "optimize_seconds", "compile_seconds", "resumed", "fallback", "regions_from",
         "interpolated", "key")

FIGURES = (*(name for name in QualitySummary.__dataclass_fields__ if name != "cells"), "area")
"""What ``QualitySummary.to_dict`` gives of tetrahedra, and of triangles."""

COLUMNS = (*FIRST, *(f"{when}_{name}" for when in ("before", "after") for name in FIGURES))

SHOWN = (("n_cells", "cells", "d"), ("min_quality", "min q", ".3f"), ("p1_quality", "1 % q", ".3f"),
         ("mean_quality", "mean q", ".3f"), ("min_angle", "from", ".1f"),
         ("max_angle", "to", ".1f"), ("below_10", "< 10°", "d"))
"""Figures of the page: name, heading, format."""


def check_summary() -> None:
    """See whether the summary can be made, before any work is done.

    Raises
    ------
    MissingDependencyError    pyarrow or jinja2 is not installed
    """
    require("the summary of a batch", "dask", "pyarrow", "jinja2")


def write_summary(
    out: Path, rows: Sequence[dict[str, Any]], command: str, threads: int, seconds: float
) -> None:
    """Write FILES beside their places in `out` and rename them.

    Parameters
    ----------
    out : path
    rows : list of dict       of :func:`odt_plugins.distributed.batch.run_batch`
    command : str             for the page
    threads : int             of every input, for the page
    seconds : float           that all of it took

    Raises
    ------
    MeshFileError             they cannot be written
    MissingDependencyError    pyarrow or jinja2 is not installed
    """
    check_summary()
    place = Path(os.path.realpath(out))
    rows = [{name: _sayable(value) for name, value in row.items()} for row in rows]
    command = _sayable(command)
    with (
        writing(f"the summary into {out}", "another folder"),
        tempfile.TemporaryDirectory(prefix=".summary-", dir=place) as name,
    ):
        folder = Path(name)
        (folder / FILES[0]).write_text(to_csv(rows), encoding="utf-8")
        _write_parquet(folder / FILES[1], rows)
        page = to_page(rows, command, threads, seconds)
        (folder / FILES[2]).write_text(page, encoding="utf-8")
        for file in FILES:
            os.replace(folder / file, place / file)


def to_csv(rows: Sequence[dict[str, Any]]) -> str:
    """One line for every input, the same columns for all."""
    text = StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n", extrasaction="ignore")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _write_parquet(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    kinds = {"resumed": pa.bool_(), **dict.fromkeys(
        ("source", "result", "status", "message", "fallback", "regions_from", "interpolated",
         "key"), pa.string())}
    whole = {"dim", "n_points", "n_cells", "below_5", "below_10", "below_20", "inverted",
             "turned"}
    for when in ("before", "after"):
        kinds |= {f"{when}_{name}": pa.int64() for name in whole}
    schema = pa.schema([(name, kinds.get(name, pa.float64())) for name in COLUMNS])
    plain = [{name: row.get(name) for name in COLUMNS} for row in rows]
    pq.write_table(pa.Table.from_pylist(plain, schema=schema), path)


def to_page(rows: Sequence[dict[str, Any]], command: str, threads: int, seconds: float) -> str:
    """The page, what failed first.

    Raises
    ------
    MissingDependencyError    jinja2 is not installed
    """
    facts = describe(threads, 0)
    del facts["seed"]
    lines = [{"source": Path(row["source"]).name, "path": row["source"], "status": row["status"],
              "message": row["message"],
              "times": [_shown(row.get(name), ".2f") for name in
                        ("seconds", "tetwild_seconds", "optimize_seconds")],
              "cells": [(_shown(row.get(f"before_{name}"), form),
                         _shown(row.get(f"after_{name}"), form)) for name, _, form in SHOWN]}
             for row in sorted(rows, key=lambda row: row["status"] == "ok")]
    return fill_template(TEMPLATE, facts=facts, rows=lines, command=command,
                         heads=[head for _, head, _ in SHOWN], counts=counts(rows),
                         totals=totals(rows, seconds))


def counts(rows: Sequence[dict[str, Any]]) -> str:
    """Say how many inputs ended how: "38 ok (12 of them before), 1 crashed, 1 failed"."""
    found: dict[str, list[bool]] = {}
    for row in rows:
        found.setdefault(row["status"], []).append(bool(row.get("resumed")))
    return ", ".join(
        f"{len(found[name])} {name}" + (f" ({sum(found[name])} of them before)"
                                        if any(found[name]) else "")
        for name in sorted(found, key=lambda name: (name != "ok", name)))


def totals(rows: Sequence[dict[str, Any]], seconds: float) -> list[tuple[str, str]]:
    """Name and value of the figures of a batch as a whole.

    Parameters
    ----------
    rows : list of dict
    seconds : float      that it took; what was done before does not count in it
    """
    fresh = [row for row in rows if not row.get("resumed") and row["status"] != "stopped"]
    found = []
    if fresh:
        rate = 60.0 * len(fresh) / seconds
        found = [("inputs a minute", f"{rate:.1f} ({len(fresh)} in {seconds:.0f} s)")]
        for name, words in (("seconds", "seconds of all together"),
                            ("tetwild_seconds", "of these in TetWild"),
                            ("optimize_seconds", "of these optimising"),
                            ("compile_seconds", "of these compiling")):
            value = sum(row.get(name) or 0.0 for row in fresh)
            found += [(words, f"{value:.1f}")] if value else []
    good = [row for row in rows if row["status"] in WRITTEN]
    for name, head, form in SHOWN[1:6] if good else ():
        before, after = (sum(row[f"{when}_{name}"] for row in good) / len(good)
                         for when in ("before", "after"))
        words = {"from": "smallest angle", "to": "largest angle"}.get(head, head)
        found.append((f"mean of {words}", f"{before:{form}} to {after:{form}}"))
    return found


def _shown(value: Any, form: str) -> str:
    return "" if value is None else format(value, form)


def _sayable(value: Any) -> Any:
    """Write bytes of the name of a file that are no text as numbers."""
    if not isinstance(value, str):
        return value
    return value.encode("utf-8", "backslashreplace").decode()
