"""How far a run is, as its caller sees it: one share from 0 to 1 that never falls, or a bar."""

from __future__ import annotations

import itertools
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import wraps
from html import escape
from typing import Any, TypeVar, cast

from odt_plugins.options import COMPILING, Progress

HEARING: list[Callable[[bool], object]] = []
"""Those who are told when a kernel begins and ends to be compiled, in whatever thread."""

DONE = ""
"""Stage under whose name the end of the last one is told, as before an object is changed itself."""

STEP = 0.005
"""Part by which a bar in a notebook grows at least; each step is a message to the browser."""

BEFORE_FIELDS = 0.5
"""Part of a run that is over when values are given the integrals that they had."""

RunT = TypeVar("RunT", bound=Callable[..., Any])


def silent(stage: str, fraction: float) -> None:
    """Tell nobody."""


@contextmanager
def telling(progress: Progress | bool | None, first: str) -> Iterator[Progress]:
    """Make one progress of all that is told while this lasts: from 0 to 1, and never back.

    Parameters
    ----------
    progress : callable, bool or None    the caller's; True shows a bar
    first : str                          stage in which the work begins
    """
    if progress is True:
        with shown() as bar, telling(bar, first) as whole:
            yield whole
        return
    report, reached, last = progress or silent, 0.0, first

    def tell(stage: str, fraction: float) -> None:
        nonlocal reached, last
        if stage != COMPILING:
            reached, last = max(reached, min(float(fraction), 1.0)), stage or last
        report(stage or last, reached)

    tell(first, 0.0)
    yield tell
    if reached < 1.0:
        tell(last, 1.0)


def told_whole(run: RunT) -> RunT:
    """Let a function of a mesh and options tell one progress from its beginning to its end."""
    @wraps(run)
    def whole(mesh: Any, options: Any, *given: Any) -> Any:
        if not options.progress:
            return run(mesh, options, *given)
        with telling(options.progress, "preparing") as progress:
            return run(mesh, replace(options, progress=progress), *given)

    return cast("RunT", whole)


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
    with _bar() as (move, say):
        said = threading.Event()

        def progress(stage: str, fraction: float) -> None:
            if stage != COMPILING:
                move(stage, fraction)
            elif not said.is_set():
                said.set()
                say(COMPILING)

        def count(number: int) -> None:
            progress(COMPILING, 0.0)
            move(f"compiling kernel {number}", None)

        with _counting(count):
            yield progress


@contextmanager
def kernels_shown(progress: Progress | bool | None) -> Iterator[None]:
    """Count the kernels that are compiled, in a bar that comes with the first of them.

    Only on a terminal or in a notebook, and where nobody is told how far the work is.
    """
    if progress is not None or not _interactive():
        yield
        return
    with ExitStack() as stack:
        moves: list[Any] = []

        def count(number: int) -> None:
            if not moves:
                move, say = stack.enter_context(_bar())
                moves.append(move)
                say(COMPILING)
            moves[0](f"compiling kernel {number}", None)

        stack.enter_context(_counting(count))
        yield


def _interactive() -> bool:
    """Whether somebody sees a bar; rich, which knows, is only asked where IPython runs."""
    if sys.stderr is not None and sys.stderr.isatty():
        return True
    if "IPython" not in sys.modules:
        return False
    from rich.console import Console

    return Console(stderr=True).is_jupyter


@contextmanager
def compiling_heard(hear: Callable[[bool], object]) -> Iterator[None]:
    """Call ``hear(True)`` where a kernel of any thread begins to be compiled, then hear(False).

    It is called under a lock that other kernels wait for, and never for two kernels at a time.
    """
    HEARING.append(hear)
    try:
        yield
    finally:
        HEARING.remove(hear)


@contextmanager
def compiling_told() -> Iterator[None]:
    """Tell who listens that a kernel is compiled while this lasts."""
    with ExitStack() as stack:
        for hear in tuple(HEARING):
            stack.callback(hear, False)
            hear(True)
        yield


@contextmanager
def _counting(count: Callable[[int], None]) -> Iterator[None]:
    """Tell the number of every kernel that is compiled, as none was found on disk."""
    numbers = itertools.count(1)

    def hear(begins: bool) -> None:
        if begins:
            count(next(numbers))

    with compiling_heard(hear):
        yield


@contextmanager
def _bar() -> Iterator[tuple[Any, Any]]:
    """Show a bar, on stderr or in a notebook; gives what moves it and what says a line above it.

    It moves to a stage and a share, or to None where nobody knows the share.
    """
    from rich.console import Console

    console = Console(stderr=True)
    with _in_notebook() if console.is_jupyter else _in_terminal(console) as bar:
        yield bar


@contextmanager
def _in_terminal(console: Any) -> Iterator[tuple[Any, Any]]:
    """As :func:`_bar`, by rich."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    bar = Progress(TextColumn("{task.description:<24}"), BarColumn(), TimeElapsedColumn(),
                   console=console, transient=True, redirect_stdout=sys.stdout.isatty())

    def move(stage: str, fraction: float | None) -> None:
        if fraction is None:
            bar.update(task, description=stage)
        else:
            bar.update(task, description=stage, total=1.0, completed=min(max(fraction, 0.0), 1.0))

    with bar:
        task = bar.add_task("reading", total=None)
        yield move, bar.console.print


@contextmanager
def _in_notebook() -> Iterator[tuple[Any, Any]]:
    """As :func:`_bar`, of HTML, for which no widgets need be installed."""
    from IPython.display import HTML, display

    def page(stage: str, fraction: float | None) -> Any:
        if fraction is None:
            return HTML(f"<progress></progress> {escape(stage)}")
        return HTML(f'<progress value="{fraction:.3f}" max="1"></progress> '
                    f"{escape(stage)} {100.0 * fraction:.0f} %")

    handle = display(page("", 0.0), display_id=True)
    seen = "", 0.0

    def move(stage: str, fraction: float | None) -> None:
        nonlocal seen
        if fraction is None:
            handle.update(page(stage, None))
        elif stage != seen[0] or fraction >= seen[1] + STEP or fraction == 1.0:
            seen = stage, fraction
            handle.update(page(stage, fraction))

    yield move, lambda line: display(HTML(escape(line)))
