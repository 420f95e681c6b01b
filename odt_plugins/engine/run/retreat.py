"""Runs of a boundary that slides: what one spoils stays in the next; at last all of it stays."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace

from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import figures
from odt_plugins.engine.record.progress import in_turn
from odt_plugins.engine.run.best import ALONE, INPUT
from odt_plugins.engine.run.outcome import Outcome
from odt_plugins.mesh.arrays import IntArray
from odt_plugins.mesh.seen import as_seen
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.options import Options

Once = Callable[[SimplexMesh, Options], tuple[Outcome, IntArray]]
"""All stages, once; also the surface vertices at which a surface that slid is spoiled."""


def run_sliding(
    mesh: SimplexMesh, options: Options, once: Once, *, tail: bool = True
) -> Outcome:
    """Runs from the input on until a surface that slid keeps the promise, at last without.

    Where stage 1 failed, where it costs little and, if the ``tail`` of the quality counts, where
    flat cells are left, the boundary is fixed in another run, and the better of the two is handed
    back.
    """
    outcome, spoiled = once(mesh, in_turn(options, 0))
    fixed = mesh.fixed.copy()
    times, turn = Counter(outcome.times), 0
    while turn < POLICY.slide_retreats and outcome.slid is None and not fixed[spoiled].all():
        fixed[spoiled], turn = True, turn + 1
        outcome, spoiled = once(replace(mesh, fixed=fixed), in_turn(options, turn))
        times.update(outcome.times)
    if outcome.slid is not None:
        left_alone = int((fixed & ~mesh.fixed).sum())
        more = {"surface vertices left alone": left_alone} if left_alone else {}
        outcome = replace(outcome, counts=outcome.counts | more, times=dict(times))
        if not _may_be_beaten(outcome, options, tail=tail):
            return outcome
    last = in_turn(options, turn + 1)
    still, _ = once(mesh, replace(last, boundary="fixed"))
    times.update(still.times)
    why = (outcome.fallback or outcome.stop_reason).removeprefix(INPUT)
    if outcome.slid is not None:
        if not _score(still, options) > _score(outcome, options):
            return replace(outcome, times=dict(times))
        why = "a surface that slid gave less"
    reasons = "; ".join(reason for reason in (why, still.fallback) if reason)
    return replace(still, fallback=f"the boundary is left as it is; {reasons}", times=dict(times))


def _may_be_beaten(outcome: Outcome, options: Options, *, tail: bool) -> bool:
    """Whether a fixed boundary is worth a run of its own beside a surface that slid."""
    if not options.finish:
        return False
    few, alone = len(outcome.cells) < POLICY.few_cells, f"runs of {ALONE}" in outcome.counts
    if few or alone or not tail:
        return few or alone
    seen = as_seen(outcome.points, outcome.cells, outcome.metric)
    return figures(*seen).p1_quality < POLICY.poor_quality


def _score(outcome: Outcome, options: Options) -> float:
    seen = as_seen(outcome.points, outcome.cells, outcome.metric)
    return figures(*seen, options.objective).score
