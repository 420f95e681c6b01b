"""Tables of remeshing: how it grows, beside others, and what each part of its rounds gains."""

from __future__ import annotations

import numpy as np
import pytest
from measure.resizing import LIMIT, resizing_table
from measure.rounds import LEFT_OUT, TURNS, rounds_table
from tet_meshes import ball

from odt_plugins.compare.baselines.task import mean_edge
from odt_plugins.compare.contestants import OURS
from odt_plugins.compare.runner import Run
from odt_plugins.compare.start import StartMesh
from odt_plugins.engine.remesh import volume


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


def test_every_part_is_left_out_in_turn_and_gains_what_is_lost_without_it():
    points, cells = ball(60, 0)
    start = StartMesh("ball", "tets", points, cells)
    before = {name: getattr(volume, name) for parts in LEFT_OUT.values() for name in parts}
    asked = []

    def remesh(mesh, size, envelope):
        changed = {name for name, value in before.items() if getattr(volume, name) is not value}
        asked.append((changed, size / mean_edge(start), envelope))
        flat = np.array([1.0, 1.0, 0.5 if "_relax" in changed else 1.0])
        return mesh[0] * flat, mesh[1]

    table = rounds_table([start], lambda line: None, factors=(1.0, 2.0), remesh=remesh)
    assert [row[0] for row in table.rows] == list(LEFT_OUT)[1:]
    assert {row[1] for row in table.rows} == {2}
    assert len(asked) == 2 * TURNS * len(LEFT_OUT)
    assert [changed for changed, factor, _ in asked if factor == 1.0][::TURNS] == [
        set(parts) for parts in LEFT_OUT.values()]
    assert {factor for _, factor, _ in asked} == {1.0, 2.0}
    gains = {row[0]: row[2:] for row in table.rows}
    assert float(gains["moves of the surface"][0]) > 0.1
    assert [float(x) for x in gains["slivers"][:-1]] == [0.0] * 7
    assert all(getattr(volume, name) is value for name, value in before.items())
