"""Shares of a run that its stages have, and runs that follow each other."""

from __future__ import annotations

from dataclasses import replace

from odt_plugins.options import Options
from odt_plugins.progress import part

FIRST = 0.8
"""Part of the progress that is left over which a run has when others may follow."""

BEFORE_INSERTION = 0.3
"""Part of a run with insertion that is over when insertion begins."""

BEFORE_TAIL = 0.8
"""The same where vertices come to a poor tail alone, or finishing alone follows, which few meshes
have."""

BEFORE_WORST = 0.5
"""Part of what comes before that which is over when the mean is settled and the worst cells are
next."""


def until_insertion(options: Options, share: float = BEFORE_INSERTION) -> Options:
    """The same options, with a progress that ends where insertion begins."""
    report = options.progress
    return options if report is None else replace(
        options, progress=part(report, 0.0, share))


def in_turn(options: Options, turn: int) -> Options:
    """The same options, with a progress that grows from run to run: each has most of the rest."""
    report = options.progress
    if report is None:
        return options
    rest = (1.0 - FIRST) ** turn
    return replace(options, progress=part(report, 1.0 - rest, 1.0 - rest + FIRST * rest))


def in_attempts(options: Options, first: str) -> Options:
    """The same options, with a progress that grows over attempts: each has most of the rest.

    Parameters
    ----------
    options : Options
    first : str          stage with which an attempt begins: it does where that is further back
    """
    report = options.progress
    if report is None:
        return options
    low, last = 0.0, 0.0

    def tell(stage: str, share: float) -> None:
        nonlocal low, last
        if stage == first and share < last:
            low += FIRST * (1.0 - low) * last
            last = 0.0
        last = max(last, share)
        report(stage, low + FIRST * (1.0 - low) * share)

    return replace(options, progress=tell)
