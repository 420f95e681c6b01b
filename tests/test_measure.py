"""What the scaling report measures: meshes, bytes, exponents, local against global."""

from __future__ import annotations

import os
from math import comb

import numpy as np
import pytest
import tet_meshes as tm
from measure import against, blocks, cold, generation, ladder, small, threads
from measure.bandwidth import sweep_bytes, triad_bandwidth
from measure.generation import generation_part
from measure.local_global import forty_sweeps_part, moved_rhombohedron, moved_triangle
from measure.meshes import ball_of, kuhn_lattice
from measure.multigrid import multigrid_part
from measure.stages import fit, surface_part
from measure.stretched import stretched

from odt_plugins.compare.start import pebble
from odt_plugins.compare.table import Table, as_text, shown
from odt_plugins.engine.odt.gradient import gradient
from odt_plugins.engine.topology.stencil import make_topology
from odt_plugins.figures import radius_ratio


def silent(_):
    """Tell nobody."""


def test_fitted_exponent_is_that_of_a_power_law():
    stage = fit("x", [(m, 3e-7 * m**1.25) for m in (100, 1000, 20000)])
    assert stage.exponent == pytest.approx(1.25, abs=1e-12)
    assert fit("x", [(10, 1.0)]).exponent is None


def test_one_piece_and_blocks_are_measured(monkeypatch, tmp_path):
    """Processes that measure make blocks of a smaller mesh than is worth it."""
    (tmp_path / "sitecustomize.py").write_text(
        "from odt_plugins.distributed import optimize\noptimize.LEAST_CELLS = 4000\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setattr(blocks, "WAYS", (blocks.WAYS[0], blocks.WAYS[2]))
    table, traffic = blocks.blocks_part([8_400], 1, silent).tables
    assert [row[1] for row in table.rows] == ["one piece", "up to 4 blocks, 1 worker"]
    assert [row[-1] for row in table.rows] == ["", "the same"]
    assert all(row[3] > 0 for row in table.rows)
    assert table.rows[1][6] == ""
    assert traffic.rows[0][2:4] == (2, table.rows[0][0])
    assert min(min(row[4:]) for row in traffic.rows) > 0


def test_the_ladder_has_a_rung_for_every_power_of_ten(monkeypatch):
    monkeypatch.setattr(ladder, "AGAINST", ("Gmsh Netgen",))
    part = ladder.ladder_part([1000, 3162], 1, silent)
    table = part.tables[0]
    assert table.heads == ladder.HEADS
    assert [row[1] for row in table.rows] == ["odt-plugins", "Gmsh Netgen"]
    assert {row[0] for row in table.rows} == {1073}
    assert all(row[2] > 0 and row[3] > 10 for row in table.rows)
    assert float(table.rows[0][6]) > float(table.rows[1][6])
    assert len(part.charts) == 2


def test_small_meshes_and_the_command_are_measured(monkeypatch):
    monkeypatch.setattr(small, "SMALL", (300, 600))
    monkeypatch.setattr(small, "MANY", (300, 500, 3))
    monkeypatch.setattr(small, "REPEATS", 1)
    meshes, command = small.small_part([1500], 1, silent).tables
    assert [row[0] for row in meshes.rows] == [1, 1, 3, 1]
    assert all(0.8 * size < row[1] < 1.25 * size
               for row, size in zip(meshes.rows, (300, 600, 1200, 1500), strict=True))
    assert meshes.rows[-1][-1] == "1.00"
    assert min(row[3] for row in meshes.rows) > 0
    assert command.rows[0][2] > 0.1


def test_a_source_tree_is_as_quick_as_itself():
    table = against.against_table(against.HERE, silent, 2, ((ball_of, 300),))
    assert [row[2] for row in table.rows] == [1, 2]
    assert {row[-1] for row in table.rows} == {"the same"}
    assert all(0.2 < float(row[5]) < 5.0 for row in table.rows)
    assert 0.0 < table.rows[0][7] < table.rows[0][4]


def test_the_serial_share_is_that_of_amdahls_law():
    one, share = 10.0, 0.25
    for count in (2, 4):
        several = one * (share + (1 - share) / count)
        assert threads.serial_share(one, several, count) == pytest.approx(share)
        assert threads.forecast(one, share, count) == pytest.approx(several)
    assert threads.forecast(one, -0.1, 16) == one / 16


def test_one_thread_and_two_are_compared_by_stage(monkeypatch):
    monkeypatch.setattr(threads, "SWEEPS", 1)
    monkeypatch.setattr(threads, "RUNS", 1)
    monkeypatch.setattr(threads, "RUNNING", 1)
    whole, stages = threads.threads_part([3000], 1, silent).tables
    row = dict(zip(whole.heads, whole.rows[0], strict=True))
    assert row["bits"] == "the same"
    assert 0.0 < row["by processor time"] < 1.5
    assert row["16 threads would take [s]"] <= row["run, 1 [s]"] * max(row["serial share"], 1.0)
    assert {"prepare", "smoothing", "finishing", "check"} <= {row[1] for row in stages.rows}
    assert min(row[2] for row in stages.rows) > 0


def test_the_stages_of_curved_surfaces_are_measured():
    start = pebble(300)
    assert len(start.cells) == 596
    assert start.kind == "surface"
    part = surface_part([500], 1, silent)
    table = part.tables[0]
    assert table.heads == ("stage", "exponent", "500 triangles")
    seconds = {row[0]: row[2] for row in table.rows}
    assert {"whole call [s]", "smoothing [s]", "finishing [s]", "check [s]"} <= set(seconds)
    assert min(seconds.values()) > 0
    assert seconds["memory [MB]"] > 50
    assert len(part.charts) == 2


def test_layers_in_their_own_metric_keep_ratios_and_directions():
    rows = stretched(silent, (2,)).rows
    assert [row[0] for row in rows] == ["plane, fixed", "plane, slide"]
    for row in rows:
        before, after = map(float, str(row[2]).split(" to "))
        assert after > before + 0.02
        assert 0.95 < float(row[5]) < 1.05
        assert float(row[6]) < 2.0


def test_moved_triangle_is_that_of_the_paper():
    points, regular, cells = moved_triangle(3)
    assert len(points) == 561
    assert radius_ratio(regular, cells) == pytest.approx(np.ones(len(cells)))
    moved = (points != regular).any(axis=1)
    assert 0 < moved.sum() < len(points)
    assert 0.8 < radius_ratio(points, cells).min() < 0.97


@pytest.mark.parametrize(("level", "n"), [(0, 64), (1, 343), (2, 2197)])
def test_moved_rhombohedron_is_refined_into_congruent_cells(level, n):
    points, regular, cells = moved_rhombohedron(level)
    assert len(points) == n
    assert len(cells) == 162 * 8**level
    assert tm.quality(regular, cells) == pytest.approx(np.full(len(cells), 0.9 ** 0.5))
    assert (tm.signed_volumes(points, cells) > 0).all()
    inside = np.ones(n, dtype=bool)
    for facet, owners in tm.facets_of(cells).items():
        if len(owners) == 1:
            inside[list(facet)] = False
    assert (points[~inside] == regular[~inside]).all()
    assert gradient(regular, cells)[inside] == pytest.approx(np.zeros((inside.sum(), 3)), abs=1e-15)
    slope = np.abs(gradient(points, cells)[inside]).max(axis=1)
    flat = (slope < 1e-9 * slope.max()).sum()
    # Inside the coarse cells stars are symmetric: the error is invisible to local methods.
    assert flat >= 162 * comb(2**level - 1, 3)


def test_kuhn_lattice_fills_the_cube():
    points, cells = kuhn_lattice(3)
    assert len(points) == 64
    assert tm.signed_volumes(points, cells) == pytest.approx(np.full(162, 1 / 6))
    owners = [len(o) for o in tm.facets_of(cells).values()]
    assert max(owners) == 2
    assert owners.count(1) == 6 * 9 * 2


def test_global_steps_against_forty_sweeps():
    table = forty_sweeps_part([40_000], 1, silent).tables[0]
    triangle = [row for row in table.rows if row[0] == "triangle"][-1]
    mesh, vertices, swept, _, steps, reached, _, _ = triangle
    assert (mesh, vertices) == ("triangle", 8385)
    assert 1 <= steps <= 4
    assert reached < swept < 1.0
    assert {row[0] for row in table.rows} == {"triangle", "rhombohedron"}


def test_multigrid_table_counts_few_iterations():
    rows = multigrid_part([1000, 8000], 1, silent).tables[0].rows
    assert len(rows) == 4
    for _, unknowns, entries, levels, complexity, taken, tight, *seconds in rows:
        assert 0.9 < unknowns / (1000 if unknowns < 3000 else 8000) < 1.1
        assert 6.5 < entries < 15
        assert levels >= 2
        assert complexity < 1.5
        assert taken <= 5 < tight <= 16
        assert min(seconds) > 0


def test_bytes_of_a_sweep_are_counted():
    _, cells = tm.grid(2, 1)
    movable = np.zeros(27, dtype=bool)
    movable[[0, 13]] = True
    topology = make_topology(cells, movable, ~movable)
    visits = sum(int(v in cell) for v in (0, 13) for cell in cells.tolist())
    least, touched = sweep_bytes(topology)
    assert least == 27 * 32 + 48 * 16 + 28 * 8 + 48 * 4 * 4 + 2 * (24 + 4)
    assert touched == visits * (4 + 16 + 3 * 32) + 2 * (32 + 24 + 16 + 4)


def test_triad_is_a_plausible_speed():
    assert 1e8 < triad_bandwidth(1 << 16) < 1e13


def test_first_results_are_measured_with_and_without_kernels(monkeypatch):
    write = """import os, pathlib
kept = pathlib.Path(os.environ["NUMBA_CACHE_DIR"])
named = "NUMBA_OPT" in os.environ
"""
    monkeypatch.delenv("NUMBA_OPT", raising=False)
    monkeypatch.setattr(cold, "JOBS", (
        ("ahead", write + "assert not kept.exists() and not named", cold.INSTALLED),
        ("first", write + "assert named; kept.mkdir(); sum(range(10**7))", cold.NONE),
        ("again", write + "assert named and kept.exists()", cold.KEPT),
        ("another", write + "assert named and not kept.exists()", cold.NONE),
    ))
    rows = cold.cold_part([], 1, silent).tables[0].rows
    assert [row[:2] for row in rows] == [("ahead", cold.INSTALLED), ("first", cold.NONE),
                                         ("again", cold.KEPT), ("another", cold.NONE)]
    assert min(min(row[2:]) for row in rows) > 0
    assert rows[1][3] > rows[2][3]


def test_tables_are_aligned():
    table = Table("t", "Title", ("name", "n", "[s]"), [("a", 5, 0.25), ("longer", 12345, 1234.5)],
                  ["note"])
    assert as_text(table) == ["", "Title", "name        n   [s]", "a           5  0.25",
                              "longer  12345  1234", "note"]
    assert [shown(v) for v in ("x", 7, 0.12345, 99.96, 123.4)] == [
        "x", "7", "0.123", "100", "123"]


def test_generators_are_measured_on_the_circle(monkeypatch):
    monkeypatch.setattr(generation, "TRUSS_STEPS", 10)
    table = generation_part([500, 1000], 1, silent).tables[0]
    assert [row[0] for row in table.rows] == ["odtmesh2d"] * 2 + ["distmesh, 10 steps"] * 2
    assert table.rows[1][1] == pytest.approx(1000, rel=0.1)
    assert min(row[2] for row in table.rows) > 0
    assert table.rows[0][4] > 0.7
    assert len(table.notes) == 2
