"""Progress as a caller sees it: one share from 0 to 1 in every public function, or a bar."""

from __future__ import annotations

import re
import sys
from collections import Counter
from functools import partial

import IPython.display
import numpy as np
import planar_meshes
import pytest
import rich.console
import surface_meshes
import tet_meshes
from pieces import write_pieces

import odt_plugins
from odt_plugins import generate, tetwild
from odt_plugins.carrying import roundtrip
from odt_plugins.compare.start import ball
from odt_plugins.distributed import optimize as blockwise
from odt_plugins.engine.record.progress import BEFORE_TAIL, BEFORE_WORST, FIRST
from odt_plugins.engine.run import plan, retreat
from odt_plugins.options import COMPILING
from odt_plugins.progress import (
    BEFORE_FIELDS,
    STEP,
    compiling_told,
    kernels_shown,
    part,
    shown,
    telling,
)


def tets(seed=2):
    return tet_meshes.grid(3, seed)[:2]


def plane():
    return planar_meshes.jittered_grid(8, 8, np.random.default_rng(3))[:2]


def pieces(place, **given):
    start = ball(300)
    write_pieces(place / "in", start.points, start.cells, np.arange(len(start.cells)) % 2)
    odt_plugins.optimize(
        place / "in.pvtu", target=place / "out.pvtu", block_rounds=2, **given)


RUNS = {
    "tetrahedra": lambda place, **given: odt_plugins.optimize(tets(), **given),
    "plane": lambda place, **given: odt_plugins.optimize(plane(), smoothing={"cycles": 2}, **given),
    "surface": lambda place, **given: odt_plugins.optimize(
        surface_meshes.sphere(2, 0.2), boundary="slide", **given),
    "other sizes in the plane": lambda place, **given: odt_plugins.remesh(
        plane(), scale=1.5, **given),
    "other sizes of a surface": lambda place, **given: odt_plugins.remesh(
        surface_meshes.sphere(2, 0.2), cells=200, envelope=0.02, **given),
    "insert": lambda place, **given: odt_plugins.optimize(
        tets(), insert=True, boundary="slide", **given),
    "nothing to do": lambda place, **given: odt_plugins.optimize(
        tets(), selection=np.zeros(0, dtype=int), **given),
    "blocks": lambda place, **given: odt_plugins.optimize(
        (ball(500).points, ball(500).cells), blocks=2, block_rounds=2, **given),
    "pieces": pieces,
    "levels": lambda place, **given: odt_plugins.refine_with_report(
        surface_meshes.sphere(1), 1, edge_length=0.2, envelope=0.1, **given),
    "TetWild": lambda place, **given: odt_plugins.tetrahedralize(
        *surface_meshes.sphere(1), edge_length_fac=0.1, **given),
    "generated": lambda place, **given: generate.odtmesh2d(
        lambda p: generate.dcircle(p, 0, 0, 1), generate.huniform, 0.2, [[-1, -1], [1, 1]],
        **given),
}


STAGES = {
    "insert": {"smoothing", "inserting"},
    "blocks": {"round 1", "round 2"},
    "pieces": {"reading", "round 1", "round 2", "writing"},
    "TetWild": {"TetWild", "smoothing"},
}


@pytest.mark.parametrize("name", RUNS)
def test_one_share_grows_from_0_to_1_over_all_stages(name, tmp_path, monkeypatch):
    monkeypatch.setattr(blockwise, "LEAST_CELLS", 50)
    seen = []
    RUNS[name](tmp_path, progress=lambda stage, share: seen.append((stage, share)))
    shares = [share for _, share in seen]
    assert shares[0] == 0.0
    assert shares[-1] == 1.0
    assert shares == sorted(shares)
    stages = {stage for stage, _ in seen}
    assert STAGES.get(name, set()) <= stages
    assert name == "nothing to do" or any(0.0 < share < 1.0 for share in shares)
    if name in ("TetWild", "levels"):
        assert len({share for stage, share in seen if stage == "TetWild"}) > 3


@pytest.mark.parametrize("start", [tets(), surface_meshes.sphere(2, 0.2)])
def test_attempts_at_a_number_of_cells_share_the_bar(start):
    seen = []
    odt_plugins.remesh(start, cells=len(start[1]) // 3, envelope=1e-3,
                       progress=lambda stage, share: seen.append((stage, share)))
    shares = [share for stage, share in seen[:-1] if stage == "resizing"]
    assert len(shares) > 6
    assert max(Counter(shares).values()) <= 2
    assert max(shares) < 1.0


def test_a_run_is_not_over_before_its_fields_have_their_integrals(monkeypatch):
    seen = []
    follow = roundtrip.follow

    def watched(*given):
        assert seen[-1] == ("fields", BEFORE_FIELDS)
        return follow(*given)

    monkeypatch.setattr(roundtrip, "follow", watched)
    odt_plugins.optimize(tets(), fields="conserve",
                         progress=lambda stage, share: seen.append((stage, share)))
    assert seen[-1] == ("fields", 1.0)


def test_a_run_is_not_over_before_its_worst_cells_are_done_and_it_finished_alone(monkeypatch):
    seen, begun = [], {}

    def watched(name, run, *given, **more):
        begun.setdefault(name, seen[-1])
        return run(*given, **more)

    for name in ("worst_cells", "finish_alone"):
        monkeypatch.setattr(plan, name, partial(watched, name, getattr(plan, name)))
    monkeypatch.setattr(plan, "_may_finish_alone", lambda work: True)
    odt_plugins.optimize(tets(), progress=lambda stage, share: seen.append((stage, share)))
    assert begun == {"worst_cells": ("finishing", BEFORE_WORST * BEFORE_TAIL),
                     "finish_alone": ("finishing", BEFORE_TAIL)}
    assert seen[-1] == ("finishing", 1.0)


def test_the_run_beside_one_that_slid_has_most_of_the_rest(monkeypatch):
    seen, begun = [], []

    def watched(mesh, options, *given, **more):
        begun.append(seen[-1][1])
        return run_once(mesh, options, *given, **more)

    run_once = plan.run_once
    monkeypatch.setattr(plan, "run_once", watched)
    monkeypatch.setattr(retreat, "_may_be_beaten", lambda *_, **__: True)
    odt_plugins.optimize(tets(), boundary="slide",
                         progress=lambda stage, share: seen.append((stage, share)))
    assert begun == [0.0, pytest.approx(FIRST)]
    assert seen[-1] == ("finishing", 1.0)
    rest = (1.0 - FIRST) * FIRST
    assert any(FIRST < share < FIRST + 0.5 * rest for _, share in seen)


def test_tetwild_has_most_of_the_bar_and_odt_the_rest(monkeypatch):
    seen = []

    def made(given, report):
        assert seen == [("TetWild", 0.0)]
        report("TetWild", 0.5)
        return tets()

    monkeypatch.setattr(tetwild, "run_tetwild", made)
    odt_plugins.tetrahedralize(*surface_meshes.sphere(1), disable_filtering=True,
                               progress=lambda stage, share: seen.append((stage, share)))
    assert seen[1] == ("TetWild", 0.5 * tetwild.BY_TETWILD)
    assert seen[2] == ("preparing", tetwild.BY_TETWILD)
    assert seen[-1][1] == 1.0


def test_the_share_of_tetwild_grows_with_its_passes():
    lines = ["Tetrahedralization performed.", "initializing...",
             *(f"//////////////// pass {k} ////////////////" for k in range(80)),
             "//////////////// postprocessing ////////////////"]
    shares = [tetwild.share_done(line) for line in lines]
    assert shares == sorted(shares)
    assert 0.0 < shares[0] < shares[-1] < 1.0
    assert tetwild.share_done("#v = 1488") == 0.0


def test_what_is_told_never_falls_and_an_error_is_no_end():
    seen = []
    with telling(lambda *pair: seen.append(pair), "first") as tell:
        tell("a", 0.5)
        tell("b", 0.25)
        tell(COMPILING, 0.0)
        part(tell, 0.5, 1.0)("c", 0.5)
        tell("d", 7.0)
    assert seen == [("first", 0.0), ("a", 0.5), ("b", 0.5), (COMPILING, 0.5), ("c", 0.75),
                    ("d", 1.0)]
    seen.clear()
    with telling(lambda *pair: seen.append(pair), "first") as tell:
        tell("a", 0.5)
    assert seen[-1] == ("a", 1.0)
    seen.clear()
    with (pytest.raises(KeyError), telling(lambda *pair: seen.append(pair), "first")):
        raise KeyError
    assert seen == [("first", 0.0)]
    for nobody in (None, False):
        with telling(nobody, "first") as tell:
            tell("a", 0.5)


def test_true_shows_a_bar_on_a_terminal(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    odt_plugins.optimize(tets(), progress=True)
    out, err = capsys.readouterr()
    assert "finishing" in err
    assert "━" in err
    assert out == ""
    odt_plugins.optimize(tets(), progress=False)
    assert capsys.readouterr() == ("", "")


def compile_one():
    """Tell of a kernel that is compiled."""
    with compiling_told():
        pass


def test_kernels_are_counted_where_nobody_asked_how_far_it_is(capsys, monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    for interactive, asked, shows in ((True, None, True), (True, False, False),
                                      (False, None, False)):
        monkeypatch.setattr(sys.stderr, "isatty", lambda on=interactive: on, raising=False)
        with kernels_shown(asked):
            pass
        assert capsys.readouterr() == ("", "")
        with kernels_shown(asked):
            compile_one()
            compile_one()
        out, err = capsys.readouterr()
        assert out == ""
        assert ("compiling kernel 2" in err) == shows
        assert bool(err) == shows


def test_true_shows_a_bar_of_html_in_a_notebook(monkeypatch):
    pages = []

    class Handle:
        def update(self, page):
            pages.append(page.data)

    def display(page, display_id=False):
        pages.append(page.data)
        return Handle() if display_id else None

    monkeypatch.setattr(rich.console, "_is_jupyter", lambda: True)
    monkeypatch.setattr(IPython.display, "display", display)
    odt_plugins.optimize(tets(), progress=True)
    found = [re.match(r'<progress value="([\d.]+)" max="1"></progress>(.*)', p) for p in pages]
    values = [float(m[1]) for m in found if m]
    assert values[0] == 0.0
    assert values[-1] == 1.0
    assert values == sorted(values)
    assert any("smoothing" in m[2] for m in found if m)
    pages.clear()
    with shown() as progress:
        for k in range(1000):
            progress("<one>", k / 1e6)
        progress(COMPILING, 0.0)
        progress(COMPILING, 0.0)
    assert len(pages) == 3, f"a page for every {STEP} of a stage, and one for compiling"
    assert "&lt;one&gt;" in pages[1]
