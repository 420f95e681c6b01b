"""How far a run is, told to the caller: shares of stages, and of runs that follow each other."""

from __future__ import annotations

from dataclasses import replace

from odt_plugins.options import Options, Progress

FIRST = 0.8
"""Part of the progress that is left over which a run has when others may follow."""

BEFORE_INSERTION = 0.3
"""Part of a run with insertion that is over when insertion begins."""


def silent(stage: str, share: float) -> None:
    """Report progress to nobody."""


def report_share(report: Progress, base: float, width: float, share: float) -> None:
    """Report a share of stage 1 as a share of the run."""
    report("smoothing", base + width * share)


def until_insertion(options: Options) -> Options:
    """The same options, with a progress that ends where insertion begins."""
    report = options.progress or silent
    return replace(options, progress=lambda stage, share: report(stage, BEFORE_INSERTION * share))


def report_insertion(report: Progress, share: float) -> None:
    """Report a share of insertion as a share of the run."""
    report("inserting", BEFORE_INSERTION + (1.0 - BEFORE_INSERTION) * share)


def in_turn(options: Options, turn: int) -> Options:
    """The same options, with a progress that grows from run to run: each has most of the rest."""
    report = options.progress
    if report is None:
        return options
    rest = (1.0 - FIRST) ** turn
    return replace(options, progress=lambda stage, share: report(
        stage, 1.0 - rest + FIRST * rest * share))
