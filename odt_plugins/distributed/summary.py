"""The summary of a batch: one row for every input as CSV, Parquet and one HTML page."""

from __future__ import annotations

import csv
import os
import shlex
import tempfile
from collections.abc import Sequence
from importlib.util import find_spec
from io import StringIO
from pathlib import Path
from typing import Any

from odt_plugins.compare.machine import describe
from odt_plugins.compare.output import fill_template
from odt_plugins.errors import MeshFileError, MissingDependencyError
from odt_plugins.quality import QualitySummary

FILES = ("summary.csv", "summary.parquet", "summary.html")

FIRST = ("source", "result", "status", "message", "seconds", "resumed", "fallback", "key")

FIGURES = tuple(QualitySummary.__dataclass_fields__)

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
    missing = [name for name in ("pyarrow", "jinja2") if find_spec(name) is None]
    if missing:
        msg = (f"the summary of a batch needs {missing[0]}, not installed here; try "
               'pip install "odt-plugins[dask]"')
        raise MissingDependencyError(msg)


def write_summary(out: Path, rows: Sequence[dict[str, Any]], command: str, threads: int) -> None:
    """Write FILES beside their places in `out` and rename them.

    Raises
    ------
    MeshFileError             they cannot be written
    MissingDependencyError    pyarrow or jinja2 is not installed
    """
    check_summary()
    try:
        with tempfile.TemporaryDirectory(prefix=".summary-", dir=out) as name:
            folder = Path(name)
            (folder / FILES[0]).write_text(to_csv(rows), encoding="utf-8")
            _write_parquet(folder / FILES[1], rows)
            (folder / FILES[2]).write_text(to_page(rows, command, threads), encoding="utf-8")
            for file in FILES:
                os.replace(folder / file, out / file)
    except OSError as exc:
        msg = f"cannot write the summary into {out}: {exc.strerror or exc}; try another folder"
        raise MeshFileError(msg) from exc


def command_line(context: Any) -> str:
    """Give the command of a click context again, with the flags that were given."""
    words = context.command_path.split()
    for parameter in context.command.params:
        value = context.params[parameter.name]
        if parameter.param_type_name == "argument":
            words += value
        elif context.get_parameter_source(parameter.name).name == "COMMANDLINE":
            on, off = parameter.opts, parameter.secondary_opts
            words.append((off or on)[0] if value is False else on[0])
            text = ",".join(value) if isinstance(value, tuple) else str(value)
            words += [] if isinstance(value, bool) else [text]
    return shlex.join(words)


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
        ("source", "result", "status", "message", "fallback", "key"), pa.string())}
    whole = {"dim", "n_points", "n_cells", "below_5", "below_10", "below_20", "inverted"}
    for when in ("before", "after"):
        kinds |= {f"{when}_{name}": pa.int64() for name in whole}
    schema = pa.schema([(name, kinds.get(name, pa.float64())) for name in COLUMNS])
    plain = [{name: row.get(name) for name in COLUMNS} for row in rows]
    pq.write_table(pa.Table.from_pylist(plain, schema=schema), path)


def to_page(rows: Sequence[dict[str, Any]], command: str, threads: int) -> str:
    """The page, what failed first.

    Raises
    ------
    MissingDependencyError    jinja2 is not installed
    """
    facts = describe(threads, 0)
    del facts["seed"]
    lines = [{"source": Path(row["source"]).name, "path": row["source"], "status": row["status"],
              "message": row["message"], "seconds": _shown(row["seconds"], ".2f"),
              "cells": [(_shown(row.get(f"before_{name}"), form),
                         _shown(row.get(f"after_{name}"), form)) for name, _, form in SHOWN]}
             for row in sorted(rows, key=lambda row: row["status"] == "ok")]
    return fill_template("batch.html", facts=facts, rows=lines, command=command,
                         heads=[head for _, head, _ in SHOWN], counts=counts(rows))


def counts(rows: Sequence[dict[str, Any]]) -> str:
    """Say how many inputs ended how: "38 ok (12 of them before), 1 crashed, 1 failed"."""
    by_status: dict[str, int] = {}
    for row in rows:
        by_status[row["status"]] = by_status.get(row["status"], 0) + 1
    resumed = sum(bool(row.get("resumed")) for row in rows)
    names = sorted(by_status, key=lambda name: (name != "ok", name))
    words = [f"{by_status[name]} {name}" for name in names]
    if resumed:
        words[0] += f" ({resumed} of them before)"
    return ", ".join(words)


def _shown(value: Any, form: str) -> str:
    return "" if value is None else format(value, form)
