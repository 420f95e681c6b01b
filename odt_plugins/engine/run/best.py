"""The best remembered state that keeps the promise as it leaves; without one, the input."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from odt_plugins.engine.odt.rounds import Log
from odt_plugins.engine.record.memory import Memory, State, having
from odt_plugins.engine.run.outcome import Outcome, unchanged
from odt_plugins.mesh.simplex import SimplexMesh

INPUT = "the input is returned, "
ALONE = "finishing alone"
BESIDES = "finishing alone, besides"

Judge = Callable[[State], tuple[Outcome, list[str]]]
"""Lets a state leave; gives it as it leaves, and what of the promise it breaks."""


def best_state(
    memory: Memory, judge: Judge, log: Log, reason: str
) -> tuple[Outcome | None, list[str]]:
    """Judge the remembered states from the best one on, until one keeps the promise.

    Parameters
    ----------
    memory : Memory
    judge : callable
    log : Log
    reason : str            why the run stopped

    Returns
    -------
    outcome : Outcome or None
    broken : list of str    what the last state broke, or the figures that all states lost
    """
    broken = [f"{name} would be worse" for name in memory.worse]
    for rank, state in enumerate(memory.states):
        outcome, found = judge(state)
        if not found:
            if state.name == BESIDES:
                reason += "; finishing without smoothing before it gave more"
            fallback = None
            if rank or state.name == ALONE:
                why = "; ".join(broken) or "no better than the input"
                had = having(memory.states[0].figures) if rank else memory.price()
                fallback = f"a later state was given up ({why}){had}"
            outcome = replace(outcome, stop_reason=reason, fallback=fallback)
            return replace(outcome, vetoed=memory.veto()), []
        log.add("states refused", 1)
        broken = found
    return None, broken


def input_returned(mesh: SimplexMesh, memory: Memory, broken: list[str], reason: str) -> Outcome:
    """The input as the outcome, and why nothing better is handed back."""
    if not broken:
        outcome = unchanged(mesh, f"nothing could be improved ({reason})")
        return replace(outcome, vetoed=memory.veto())
    had = having(memory.states[0].figures) if memory.states else memory.price()
    why = f"{INPUT}nothing better kept the promise ({'; '.join(broken)}){had}"
    return replace(unchanged(mesh, reason), fallback=why, vetoed=memory.veto())
