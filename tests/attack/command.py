"""Attack the package with random cases: ``python tests/attack --minutes 60``.

One seed is one case. A case that fails is told with its seed and replayed by
``python tests/attack --kind KIND --seed SEED``.
"""

from __future__ import annotations

import importlib
import secrets
import signal
import sys
import time

import click

from attack.table import record, table
from attack.worker import FAILED, OK, REFUSED, Worker
from odt_plugins.cli.terminal import progress_bar
from odt_plugins.processes import handling

SHARES = {"meshes": 0.25, "metrics": 0.1, "sizes": 0.1, "bent": 0.05, "files": 0.2, "signals": 0.1,
          "disks": 0.1, "cores": 0.1}
"""Modules of this folder with a function ``attack(rng, folder)`` and its time limit ``SECONDS``,
and the part of the time that each gets."""


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--kind", "kinds", type=click.Choice(list(SHARES)), multiple=True,
              help="Only this kind of attack; may be given several times.")
@click.option("--minutes", type=click.FloatRange(min=0.0), default=None,
              help="Go on for so long; 1 unless --seed or --cases is given.")
@click.option("--seed", type=click.IntRange(min=0), default=None,
              help="Seed of the first case, the next ones follow; alone, it replays one case.")
@click.option("--cases", type=click.IntRange(min=1), default=None,
              help="End after so many cases of each kind.")
@click.option("--record", "recorded", is_flag=True,
              help="Write the table into tests/README.md as well.")
def main(
    kinds: tuple[str, ...], minutes: float | None, seed: int | None, cases: int | None,
    recorded: bool,
) -> None:
    """Attack the package with random cases and count what becomes of them.

    Random meshes over all options, in metrics, given other sizes and curved, damaged files, signals
    at random moments, full disks, other kinds of processors. Prints what fails, with its seed, and
    a table at the end, also after Ctrl-C. Exit code 1 when anything failed.
    """
    kinds = kinds or tuple(SHARES)
    replay = seed is not None and minutes is None and cases is None
    if replay:
        cases = 1
    if minutes is None and cases is None:
        minutes = 1.0
    first = secrets.randbelow(1 << 40) if seed is None else seed
    workers = {kind: Worker(f"attack.{kind}", importlib.import_module(f"attack.{kind}").SECONDS)
               for kind in kinds}
    counts = {kind: dict.fromkeys((OK, REFUSED, FAILED), 0) for kind in kinds}
    used = dict.fromkeys(kinds, 0.0)
    start = time.monotonic()
    kind, number = kinds[0], first
    command = f"python tests/attack {' '.join(sys.argv[1:])}".strip()
    with handling(signal.SIGTERM, signal.default_int_handler), progress_bar(False) as progress:
        try:
            while True:
                open_kinds = [k for k in kinds if cases is None or sum(counts[k].values()) < cases]
                elapsed = time.monotonic() - start
                if not open_kinds or (minutes is not None and elapsed > 60 * minutes):
                    break
                kind = min(open_kinds, key=lambda k: used[k] / SHARES[k])
                number = first + sum(counts[kind].values())
                if progress:
                    progress(f"{kind} --seed {number}", elapsed / (60 * (minutes or 1e9)))
                clock = time.monotonic()
                verdict = workers[kind].run(number)
                used[kind] += time.monotonic() - clock
                counts[kind][verdict.outcome] += 1
                if verdict.outcome == FAILED or replay:
                    click.echo(f"--kind {kind} --seed {number}: {verdict.outcome} "
                               f"{verdict.sentence}".rstrip())
                if replay and verdict.details:
                    click.echo(verdict.details)
        except KeyboardInterrupt:
            command += f" (stopped in --kind {kind} --seed {number})"
        finally:
            for worker in workers.values():
                worker.stop()
    lines = table(counts, used, first, command)
    click.echo("\n".join(lines))
    if recorded:
        record(lines)
    sys.exit(any(count[FAILED] for count in counts.values()))
