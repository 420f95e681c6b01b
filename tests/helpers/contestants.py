"""Contestants of the comparison without processes of their own."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from odt_plugins.compare import charts, runner
from odt_plugins.compare.worker import run_job


def _run_here(folder: Path, limits: runner.Limits, place: str) -> tuple[int, str]:
    with contextlib.chdir(folder):
        run_job(folder)
    return 0, ""


@contextlib.contextmanager
def in_this_process() -> Iterator[None]:
    """Contestants run in the process of the tests, which has imported most of their tools."""
    with pytest.MonkeyPatch.context() as within:
        within.setattr(runner, "_process", _run_here)
        yield


@contextlib.contextmanager
def charts_unwritten() -> Iterator[None]:
    """Charts are made, but not drawn, which takes longer than small meshes take to be improved."""
    with pytest.MonkeyPatch.context() as within:
        within.setattr(charts, "as_svg", lambda figure, style, label: "<svg></svg>")
        yield
