"""The table of how remeshing grows: who has rows, and the exponents beneath."""

from __future__ import annotations

import pytest
from measure.resizing import LIMIT, resizing_table

from odt_plugins.compare.baselines.task import mean_edge
from odt_plugins.compare.contestants import OURS
from odt_plugins.compare.runner import Run


def test_every_tool_has_a_row_for_every_size_until_it_makes_nothing():
    told = []

    def run(start, contestant, limits):
        told.append((start, contestant, limits))
        if contestant.name == "mmg3d":
            return Run("timeout")
        seconds = 1e-6 * len(start.cells) ** 1.5
        return Run("ok", facts={"seconds": [seconds], "peak": 2e6},
                   meshes=[(start.points, start.cells, None)])

    table = resizing_table([500, 2000], lambda line: None, run)
    first, last = (row[0] for row in (table.rows[0], table.rows[-1]))
    names = [(row[0], row[1]) for row in table.rows]
    assert [name for size, name in names if size == first] == [
        OURS, f"{OURS}, optimize on that", "mmg3d", "CGAL tetrahedral remeshing"]
    assert [name for size, name in names if size == last] == [
        OURS, f"{OURS}, optimize on that", "CGAL tetrahedral remeshing"]
    assert table.rows[2][2] == "timeout"
    assert table.rows[0][2:] == (first, pytest.approx(1e-6 * first**1.5),
                                 f"{first**0.5:.0f}", "2")
    assert table.notes[0] == f"time of {OURS} grows with the tets made to the power 1.50"
    start, ours, limits = told[0]
    assert ours.settings["size"] == mean_edge(start)
    assert ours.settings["envelope"] == 1e-2
    assert limits.seconds == LIMIT
    assert limits.threads == 1
