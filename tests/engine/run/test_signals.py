"""Ctrl-C: Python handles it between two calls of kernels, so no call does much at a time."""

from __future__ import annotations

import inspect
import signal
import subprocess
import sys
import textwrap
import threading
from pathlib import Path

import meshio
import numpy as np
import planar_meshes as pm
import pytest
import surface_meshes as sm
import tet_meshes as tm
from processes import wait_until

import odt_plugins
from odt_plugins import api
from odt_plugins.engine.compiled import threads
from odt_plugins.engine.compiled.kernel import Kernel
from odt_plugins.engine.moves import flips2d
from odt_plugins.engine.surface import flips as surface_flips
from odt_plugins.engine.topology import coloring
from odt_plugins.engine.topology.coloring import Coloring, run_chunks

PIECE, COSTLY = 40, 7

COMMON = {"topology.order._match_rows": "new"}
FLAT = COMMON | {"record.figures._triangle_shapes": "cells"}
VOLUME = COMMON | {
    "record.figures._tet_shapes": "cells",
    "topology.adjacency._match_facets": ("first", "last"),
    "odt.sweeps._move_vertices": ("start", "stop"), "moves.flips3d.flip_pass": "order",
    "moves.newton3d.smooth_vertices": ("start", "stop"), "moves.compound.compound_pass": "order",
}
SURFACE = FLAT | {
    "surface.odt.move_vertices": ("start", "stop"), "surface.flips._flip_some": "most",
    "ground.newton.smooth_on_ground": "order", "ground.crossings._sweep":
    ("start", "stop"), "ground.envelope._upper": "triangles", "ground.reference._across":
    ("start", "stop"), "surface.compound.compound_pass": "order",
    "moves.compound2d._add_excess": "cells", "cells.measures.cell_measures": "cells",
}
SHORT = ("compound_pass", "compound_pass_2d", "insertion_pass", "_upper", "ground.crossings._sweep")


def planar():
    points, cells = pm.jittered_grid(24, 24, np.random.default_rng(3))[:2]
    return points, pm.oriented(points, cells)


RUNS = {
    "volume": (lambda: tm.ball(150, 3), {}, VOLUME),
    "threads": (lambda: tm.ball(150, 3), {"threads": 2}, VOLUME),
    "slide": (lambda: tm.ball(150, 3), {"boundary": "slide", "envelope": 0.02}, VOLUME | {
        "ground.newton.smooth_on_ground": "order", "sliding.flips.flip_boundary": "order",
        "ground.envelope._upper": "triangles"}),
    "insert": (lambda: tm.ball(150, 3), {"insert": True}, VOLUME | {
        "moves.insertion.insertion_pass": "order"}),
    "plane": (planar, {}, FLAT | {
        "topology.adjacency._match_facets": ("first", "last"),
        "odt.sweeps._move_vertices": ("start", "stop"), "moves.flips2d._flip_edges": "most",
        "moves.newton2d.smooth_vertices_2d": ("start", "stop"),
        "cells.measures.cell_measures": "cells",
        "moves.compound2d.compound_pass_2d": "order", "moves.compound2d._add_excess": "cells"}),
    "surface": (lambda: sm.torus(40, 20, noise=0.7), {}, SURFACE),
}


@pytest.mark.parametrize("run", RUNS)
def test_calls_of_kernels_are_short_and_their_length_changes_no_bit(
        run, monkeypatch, many_threads):
    make, options, kernels = RUNS[run]
    mesh = make()
    whole = odt_plugins.optimize(mesh, **options)
    for module in (threads, coloring, flips2d, surface_flips):
        monkeypatch.setattr(module, "PIECE", PIECE)
    monkeypatch.setattr(threads, "COSTLY", COSTLY)
    longest = dict.fromkeys(kernels, 0)
    original = Kernel.__call__

    def call(kernel, *arguments):
        function = kernel.py_func
        name = f"{function.__module__}.{function.__name__}".partition("engine.")[2]
        if name in kernels:
            given = inspect.signature(function).bind(*arguments).arguments
            which = kernels[name]
            if isinstance(which, tuple):
                length = given[which[1]] - given[which[0]]
            else:
                length = given[which] if which == "most" else len(given[which])
            longest[name] = max(longest[name], length)
        return original(kernel, *arguments)

    monkeypatch.setattr(Kernel, "__call__", call)
    pieces = odt_plugins.optimize(mesh, **options)
    assert [a.tobytes() for a in pieces] == [a.tobytes() for a in whole]
    for name, length in longest.items():
        most = COSTLY if name.endswith(SHORT) else PIECE
        assert 0 < length <= most, name


@pytest.mark.parametrize("workers", [None, 3])
def test_the_vertices_of_every_colour_come_in_short_chunks_and_in_order(workers, monkeypatch):
    for module in (threads, coloring):
        monkeypatch.setattr(module, "PIECE", 1000)
    blocks = np.arange(0, 40_001, 100)
    apart = np.empty((0, 2), dtype=np.int32)
    colors = Coloring(np.arange(40_000, dtype=np.int32), blocks, np.array([0, 3, 100, 400]), apart)
    with threads.thread_pool(workers or 1) as pool:
        chunks = run_chunks(pool, workers or 1, colors, lambda *chunk: chunk)
    starts, stops = np.array([(a, b) for a, b in chunks if a < b]).T
    assert starts[0] == 0
    assert stops[-1] == 40_000
    assert np.array_equal(starts[1:], stops[:-1])
    assert (stops - starts).max() <= 1000
    assert pool is None or {0, 300, 10_000} <= set(starts.tolist())


@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_in_the_middle_of_a_run_ends_it_and_leaves_no_file(tmp_path, workers):
    points, cells = tm.ball(6000, 5)
    meshio.write_points_cells(tmp_path / "in.vtu", points, [("tetra", cells)])
    script = textwrap.dedent(f"""
        import pathlib
        import odt_plugins
        def progress(stage, share):
            if stage == "smoothing":
                pathlib.Path("started").touch()
        odt_plugins.optimize("in.vtu", target="out.vtu", threads={workers}, progress=progress)
        pathlib.Path("ended").touch()
    """)
    with subprocess.Popen([sys.executable, "-c", script], cwd=tmp_path, stderr=subprocess.PIPE,
                          text=True) as job:
        try:
            wait_until(lambda: (tmp_path / "started").exists() or job.poll() is not None, 300.0)
            job.send_signal(signal.SIGINT)
            error = job.communicate(timeout=60)[1]
        finally:
            job.kill()
    assert job.returncode == -signal.SIGINT
    assert error.splitlines()[-1] == "KeyboardInterrupt"
    assert sorted(p.name for p in Path(tmp_path).iterdir()) == ["in.vtu", "started"]


def test_no_thread_imports_beside_the_reading_of_a_file(tmp_path, monkeypatch):
    """An interrupt within an import may leave a lock of Python's held, at which another waits."""
    source = tmp_path / "in.mesh"
    points, cells = tm.grid(2, 3)
    meshio.Mesh(points, [("tetra", cells)]).write(source)
    before, beside, read = threading.active_count(), [], api.read_file

    def counted(path):
        beside.append(threading.active_count() - before)
        return read(path)

    monkeypatch.setattr(api, "read_file", counted)
    api.optimize_file(source, tmp_path / "out.mesh")
    assert beside == [0]
