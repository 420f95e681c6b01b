"""Threads that share work with their caller: order, errors, and the same bits for any number."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
import tet_meshes as tm

import odt_plugins
from odt_plugins.engine.compiled import threads
from odt_plugins.engine.topology import order
from odt_plugins.mesh import chunks
from odt_plugins.mesh.chunks import Pool


def test_results_come_in_order_and_the_caller_works_too():
    both = threading.Barrier(2, timeout=60)

    def work(a, b):
        if a < 2:
            both.wait()
        return a - b, threading.get_ident()

    with Pool(2) as pool:
        found = list(pool.map(work, range(50), range(0, 150, 3)))
    assert [value for value, _ in found] == [-2 * a for a in range(50)]
    assert {where for _, where in found[:2]} > {threading.get_ident()}


@pytest.mark.parametrize("count", [2, 3])
def test_of_several_errors_the_first_is_raised_and_nothing_else_is_begun(count):
    all_there = threading.Barrier(count, timeout=60)
    begun = []

    def work(i):
        begun.append(i)
        if i < count:
            all_there.wait()
            time.sleep(0.05 * (count - i))
            raise ValueError(i)

    with Pool(count) as pool, pytest.raises(ValueError, match="0"):
        pool.map(work, range(100))
    assert sorted(begun) == list(range(count))


@pytest.mark.parametrize("count", [2, 3])
def test_a_call_begins_when_those_before_it_have_ended(count):
    rng = np.random.default_rng(count)
    after = [(int(a), int(b)) for a, b in rng.integers(60, size=(200, 2)) if a < b]
    ended = []

    def work(i):
        assert {a for a, b in after if b == i} <= set(ended)
        time.sleep(0.001 * rng.random())
        ended.append(i)
        return -i

    with Pool(count) as pool:
        assert pool.run(work, [(i,) for i in range(60)], after) == [-i for i in range(60)]


def test_nothing_waits_for_a_call_that_failed():
    def work(i):
        if i == 1:
            raise ValueError(i)

    with Pool(3) as pool, pytest.raises(ValueError, match="1"):
        pool.run(work, [(i,) for i in range(20)], [(i, i + 1) for i in range(19)])


def test_calls_within_calls_end():
    with Pool(3) as pool:
        found = pool.map(lambda i: sum(pool.map(lambda j: i * j, range(5))), range(20))
    assert list(found) == [10 * i for i in range(20)]


def test_short_parts_by_several_threads_change_no_bit(monkeypatch, many_blocks):
    points, cells = tm.ball(700, 4)
    monkeypatch.setattr(threads, "PART", 100)
    monkeypatch.setattr(chunks, "CHUNK", 70)
    monkeypatch.setattr(order, "LAYERS", 3)
    one, *others = (
        [part.tobytes() for part in odt_plugins.optimize((points, cells), threads=count)]
        for count in (1, 2, 3)
    )
    assert one != [points.tobytes(), np.asarray(cells).tobytes()]
    assert others == [one, one]


def test_a_small_mesh_is_left_to_one_thread(monkeypatch):
    mesh = tm.ball(200, 1)
    begun = []
    submit = Pool.submit
    monkeypatch.setattr(Pool, "submit", lambda *args: begun.append(1) or submit(*args))
    for least, used in ((len(mesh[1]), True), (len(mesh[1]) + 1, False)):
        begun.clear()
        monkeypatch.setattr(threads, "THREADED_CELLS", least)
        odt_plugins.optimize(mesh, threads=2)
        assert bool(begun) == used
