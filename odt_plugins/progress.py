"""How far a run is, as its caller sees it: one share from 0 to 1 that never falls, or a bar."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from html import escape
from typing import Any

from odt_plugins.options import COMPILING, Progress

STEP = 0.005
"""Part by which a bar in a notebook grows at least; each step is a message to the browser."""


def silent(stage: str, fraction: float) -> None:
    """Tell nobody."""


@contextmanager
def telling(progress: Progress | bool | None, first: str) -> Iterator[Progress]:
    """Make one progress of all that is told while this lasts: from 0 to 1, and never back.

    Parameters
    ----------
    progress : callable, bool or None    the caller's; True shows a bar
    first : str                          stage in which the work begins

    Yields
    ------
    callable progress(stage, fraction)
    """
    if progress is True:
        with shown() as bar, telling(bar, first) as whole:
            yield whole
        return
    report, reached, last = progress or silent, 0.0, first

    def tell(stage: str, fraction: float) -> None:
        nonlocal reached, last
        if stage != COMPILING:
            reached, last = max(reached, min(float(fraction), 1.0)), stage
        report(stage, reached)

    tell(first, 0.0)
    yield tell
    if reached < 1.0:
        tell(last, 1.0)


def part(progress: Progress, low: float, high: float) -> Progress:
    """Give what is told of a part of the work, which lasts from `low` to `high` of the whole."""
    return lambda stage, share: progress(stage, low + (high - low) * share)


@contextmanager
def shown() -> Iterator[Progress]:
    """Show a bar: in a notebook in the output of the cell, otherwise on stderr.

    Yields
    ------
    what is told a stage and its share, or COMPILING, which is said once above the bar
    """
    from numba.core import event
    from rich.console import Console

    console = Console(stderr=True)
    with _in_notebook() if console.is_jupyter else _in_terminal(console) as (move, say):
        said = threading.Event()

        def progress(stage: str, fraction: float) -> None:
            if stage != COMPILING:
                move(stage, fraction)
            elif not said.is_set():
                said.set()
                say(COMPILING)

        class FirstKernel(event.Listener):  # type: ignore[misc]
            """Tells that kernels are compiled, which means that none were found in the cache."""

            def on_start(self, event: Any) -> None:
                if event.data["dispatcher"].py_func.__module__.startswith("odt_plugins"):
                    progress(COMPILING, 0.0)

            def on_end(self, event: Any) -> None:
                """Nothing to tell."""

        with event.install_listener("numba:compile", FirstKernel()):
            yield progress


@contextmanager
def _in_terminal(console: Any) -> Iterator[tuple[Any, Any]]:
    """Show a bar of rich; gives what moves it and what says a line above it."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    bar = Progress(TextColumn("{task.description:<24}"), BarColumn(), TimeElapsedColumn(),
                   console=console, transient=True, redirect_stdout=sys.stdout.isatty())

    def move(stage: str, fraction: float) -> None:
        bar.update(task, description=stage, total=1.0, completed=min(max(fraction, 0.0), 1.0))

    with bar:
        task = bar.add_task("reading", total=None)
        yield move, bar.console.print


@contextmanager
def _in_notebook() -> Iterator[tuple[Any, Any]]:
    """Show a bar of HTML, for which no widgets need be installed."""
    from IPython.display import HTML, display

    def page(stage: str, fraction: float) -> Any:
        return HTML(f'<progress value="{fraction:.3f}" max="1"></progress> '
                    f"{escape(stage)} {100.0 * fraction:.0f} %")

    handle = display(page("", 0.0), display_id=True)
    seen = "", 0.0

    def move(stage: str, fraction: float) -> None:
        nonlocal seen
        if stage != seen[0] or fraction >= seen[1] + STEP or fraction == 1.0:
            seen = stage, fraction
            handle.update(page(stage, fraction))

    yield move, lambda line: display(HTML(escape(line)))
