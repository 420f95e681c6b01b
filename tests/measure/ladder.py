"""The ladder of sizes: time, memory and figures against other tools, a power of ten a rung."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import log10

from measure.meshes import ball_of
from measure.part import Part, power_laws
from odt_plugins.compare.contestants import choose
from odt_plugins.compare.rows import Row, compare_on
from odt_plugins.compare.runner import Limits
from odt_plugins.compare.table import Say, Table, Value

AGAINST = ("Netgen stm", "Gmsh Netgen")
"""The strongest that optimise meshes of every size here."""

LIMIT = 7200.0
"""Seconds for one run."""

HEADS = ("tets", "", "processor time [s]", "memory [MB]", "least q", "1 % q", "mean q", "< 20°",
         "vertices")


def ladder_part(sizes: Sequence[int], threads: int, say: Say) -> Part:
    """Compare with other tools on random balls of the powers of ten among the sizes.

    Parameters
    ----------
    sizes : ints      about so many tetrahedra; those that are no power of ten are left out, where
                      there is one
    threads : int     for tools that can use several
    say : callable    is told what is measured
    """
    rungs = [n for n in sizes if log10(n).is_integer()] or list(sizes)
    found: list[tuple[int, Row]] = []
    for n in rungs:
        start = ball_of(n)
        say(f"{len(start.cells)} tets")
        result = compare_on(start, choose(AGAINST), Limits(LIMIT, 1, LIMIT, threads), poisson=False,
                            begin=lambda contestant: say(contestant.name))
        found += [(len(start.cells), row) for row in result.rows]
    table = Table("ladder", "The ladder of sizes", HEADS, [_cells(m, row) for m, row in found])
    charts = [power_laws(f"The ladder: {what}", [_line(name, found, get) for name in
                         dict.fromkeys(row.contestant for _, row in found)], "tets", what)
              for what, get in (("seconds", _seconds), ("MB", _megabytes))]
    return Part([table], charts)


def _line(
    name: str, found: Sequence[tuple[int, Row]], figure: Callable[[Row], float]
) -> tuple[str, list[int], list[float]]:
    """One tool in a chart: its sizes and its figure, where it has a result."""
    done = [(m, figure(row)) for m, row in found if row.contestant == name and row.timing]
    return name, [m for m, _ in done], [value for _, value in done]


def _seconds(row: Row) -> float:
    return row.timing.cpu if row.timing else 0.0


def _megabytes(row: Row) -> float:
    return row.timing.peak / 1e6 if row.timing else 0.0


def _cells(m: int, row: Row) -> tuple[Value, ...]:
    if row.measured is None:
        return m, row.contestant, row.status, *[""] * (len(HEADS) - 3)
    s = row.measured.summary
    return (m, row.contestant, _seconds(row), _megabytes(row), f"{s.min_quality:.3f}",
            f"{s.p1_quality:.3f}", f"{s.mean_quality:.3f}", s.below_20, s.n_points)
