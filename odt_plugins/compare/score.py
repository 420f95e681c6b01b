"""How often ours is ahead or level: figures counted per opponent, and in all."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from odt_plugins.compare.contestants import OURS
from odt_plugins.compare.rows import RIVALRY, MeshResult, Row
from odt_plugins.compare.table import Table

SHORT = {"min_quality": "least q", "p1_quality": "1 % q", "mean_quality": "mean q",
         "min_angle": "least angle", "max_angle": "largest angle", "below_20": "below 20°",
         "seconds": "time"}
"""Names of figures in sentences."""


class Score(NamedTuple):
    """Figures of RIVALRY in which ours by default is held against one opponent.

    Attributes
    ----------
    opponent : str
    meshes : int     on which the opponent has a result
    figures : int    level + behind + freer
    level : int      in which ours is ahead or level
    behind : int     in which the opponent is better, under the same conditions
    freer : int      in which the opponent is better, but was freer (see `Row.freer`)
    faster : int     meshes on which ours takes less time
    """

    opponent: str
    meshes: int
    figures: int
    level: int
    behind: int
    freer: int
    faster: int


def rivals(result: MeshResult) -> list[Row]:
    """Rows of other tools that have a result."""
    return [row for row in result.rows if row.family != OURS and row.measured is not None]


def verdict(result: MeshResult) -> str:
    """Say what ours loses and to whom; nothing is said where nobody else has a result."""
    ours = next((r for r in result.rows if r.contestant == OURS), None)
    if ours is None:
        return ""
    if ours.measured is None:
        return f"{OURS} has no result here: {ours.status}, {ours.message}"
    others = rivals(result)
    if not others:
        return "No other tool has a result here to compare with."
    parts = []
    for freer in dict.fromkeys(["", *(row.freer for row in others)]):
        lost: dict[str, list[str]] = {}
        for row in others:
            for figure in row.better_than_ours if row.freer == freer else ():
                if figure != "seconds":
                    lost.setdefault(figure, []).append(row.contestant)
        who = "; ".join(f"{SHORT[figure]}: {', '.join(names)}" for figure, names in lost.items())
        if who:
            parts.append(f"Better than {OURS} in {who}." if not freer
                         else f"Better, but no plain win ({freer}), in {who}.")
        elif not freer:
            parts.append(f"No other tool is plainly better than {OURS} in any figure of quality.")
    return " ".join(parts)


def scores(results: Sequence[MeshResult]) -> list[Score]:
    """Count for every opponent, and for "all" last; nothing without an opponent or without ours."""
    pairs = [(row, ours) for r in results for ours in r.rows if ours.contestant == OURS
             for row in rivals(r)]
    names = dict.fromkeys(row.contestant for row, _ in pairs)
    found = [_score(name, [p for p in pairs if p[0].contestant == name]) for name in names]
    return [*found, _score("all", pairs)] if pairs else []


def score_table(results: Sequence[MeshResult]) -> Table | None:
    """Give the counts as a table, None where there is nothing to count."""
    found = scores(results)
    if not found:
        return None
    whole = found[-1]
    return Table(
        "score", f"{OURS} is ahead or level in {whole.level} of {whole.figures} figures",
        ("opponent", "meshes", "figures", "ahead or level", "behind", "behind a freer one",
         "less time"), [tuple(score) for score in found],
        (f"Figures: {len(RIVALRY)} of quality for every mesh and opponent with a result. A result "
         f"with inverted cells beats nobody. A freer one moved the surface further than {OURS}, or "
         f"ignored the regions. Less time: meshes on which {OURS} is the faster.",),
    )


def _score(name: str, pairs: Sequence[tuple[Row, Row]]) -> Score:
    freer = behind = faster = 0
    for row, ours in pairs:
        lost = sum(figure in RIVALRY for figure in row.better_than_ours)
        freer += lost if row.freer else 0
        behind += 0 if row.freer else lost
        faster += bool(row.timing and ours.timing and ours.timing.median <= row.timing.median)
    figures = len(RIVALRY) * len(pairs)
    return Score(name, len(pairs), figures, figures - freer - behind, behind, freer, faster)
