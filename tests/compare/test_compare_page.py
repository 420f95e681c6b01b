"""The pages of the comparison in a real browser: headless Chromium opens what the command wrote."""

from __future__ import annotations

import html
import json
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from browser import WIDTH, browse
from contestants import charts_unwritten, in_this_process
from measure import bandwidth, blocks, cold, generation, ladder, local_global, small, threads
from measure.scaling import FILES as SCALING_FILES
from measure.scaling import PARTS, run_scaling
from PIL import Image

from odt_plugins.compare.charts import ACROSS, histograms
from odt_plugins.compare.contestants import OURS, choose
from odt_plugins.compare.output import FILES, write_all
from odt_plugins.compare.rows import compare_on, mark
from odt_plugins.compare.runner import Limits
from odt_plugins.compare.start import ball, plate, stored
from odt_plugins.distributed.summary import to_page
from odt_plugins.figures import summarize
from odt_plugins.report.machine import describe
from odt_plugins.report.plotting import GREY

PROBE = """<script>
addEventListener("load", () => {
  const box = e => e.getBoundingClientRect();
  const visible = e => box(e).width > 50 && box(e).height > 50;
  document.body.dataset.probe = JSON.stringify({
    wide: document.documentElement.scrollWidth, window: innerWidth,
    svgs: [...document.querySelectorAll("svg")].map(visible),
    images: [...document.images].map(i => i.naturalWidth > 100 && visible(i)),
    cells: [...document.querySelectorAll("td")].length,
    cut: [...document.querySelectorAll(".scroll")].filter(e => e.scrollWidth > e.clientWidth + 1)
      .length,
    outside: [...document.querySelectorAll("svg text")].filter(t => {
      const a = box(t), b = box(t.ownerSVGElement);
      return a.left < b.left - 2 || a.right > b.right + 2 || a.bottom > b.bottom + 2;
    }).map(t => t.textContent),
  });
});
</script>"""


def probe(page, tmp_path):
    """What the browser made of the page once it was laid out."""
    copy = tmp_path / "probed.html"
    copy.write_text(page.read_text(encoding="utf-8") + PROBE, encoding="utf-8")
    dom, console = browse(copy.as_uri(), tmp_path, "--dump-dom")
    assert console == []
    found = re.search(r'data-probe="([^"]*)"', dom)
    return json.loads(html.unescape(found.group(1)))


@pytest.fixture(scope="module")
def results():
    limits = Limits(repeats=1)
    with in_this_process():
        solid, flat, curved = (compare_on(start, choose(names), limits) for start, names in (
            (ball(60), ["Netgen sm", "Laplacian"]), (plate(60), ["Laplacian"]),
            (stored("bone-surface"), ["MeshLab flips"])))
    row = replace(solid.rows[-1], contestant="<script>alert(1)</script>", status="crashed",
                  message="ended by <b>SIGSEGV</b>", measured=None, timing=None)
    return [replace(solid, rows=mark([*solid.rows, row])), flat, curved]


@pytest.fixture(scope="module")
def page(results, tmp_path_factory):
    out = tmp_path_factory.mktemp("page")
    write_all(out, results, describe(1, 0), "odt-plugins compare <test>")
    return out / FILES[2]


def test_page_needs_nothing_but_itself(page):
    text = page.read_text(encoding="utf-8")
    links = re.findall(r'(?:src|href)="([^"]*)"', text)
    assert all(link.startswith(("#", "data:")) for link in links)
    assert not re.search(r"url\((?!#)", text)
    assert "@import" not in text


def test_every_histogram_has_its_axes(results):
    for result in results:
        panels = histograms(result).split('<g id="axes_')[1:]
        shown = [panel for panel in panels if "matplotlib.axis" in panel]
        assert len(shown) == len([row for row in result.rows if row.measured])
        for panel in shown:
            x, y = re.findall(r'<g id="matplotlib\.axis_.*?(?=<g id="matplotlib|<g id="patch|$)',
                              panel, re.DOTALL)
            assert x.count("<text") > 3
            assert y.count("<text") > 2
            assert f"stroke: {GREY}" in panel.partition('id="matplotlib.axis')[2]
        assert panels[0].count("% of the cells") == 1
        assert panels[0].count("radius ratio") == (len(shown) <= ACROSS)


def test_page_tells_paths_as_they_are_and_what_every_tool_was_told(results, tmp_path):
    named = replace(results[0], start=replace(results[0].start, origin="data/small.vtu"))
    with charts_unwritten():
        write_all(tmp_path, [named], describe(1, 0), "odt-plugins compare data/small.vtu")
    text = html.unescape((tmp_path / FILES[2]).read_text(encoding="utf-8"))
    assert f"data/small.vtu, {len(named.start.points)} vertices" in text
    assert "Data/small" not in text
    assert named.start.sha256 in text
    for row in results[0].rows:
        assert json.dumps(row.settings) in text
    assert "is ahead or level in" in text


def test_page_escapes_what_tools_say(page):
    text = page.read_text(encoding="utf-8")
    assert "<script>alert" not in text
    assert "&lt;script&gt;alert" in text
    assert "<b>SIGSEGV" not in text


def test_page_is_laid_out_by_a_browser_without_complaint(page, tmp_path, results):
    found = probe(page, tmp_path)
    assert found["wide"] <= found["window"] == WIDTH
    assert len(found["svgs"]) == 2 * len(results)
    assert all(found["svgs"])
    assert found["images"] == [True] * len(results)
    assert found["outside"] == []
    assert found["cut"] == 0
    assert found["cells"] > 15 * sum(len(r.rows) for r in results)


def test_page_is_not_blank_on_the_screen(page, tmp_path):
    shot = tmp_path / "shot.png"
    browse(page.as_uri(), tmp_path, f"--screenshot={shot}")
    picture = np.asarray(Image.open(shot).convert("RGB")).reshape(-1, 3).astype(int)
    assert len(np.unique(picture @ [1 << 16, 1 << 8, 1])) > 500
    ours = np.array([0x1F, 0x5F, 0xA8])
    assert (np.abs(picture - ours).max(axis=1) < 25).sum() > 100
    white = (picture > 240).all(axis=1).mean()
    assert 0.5 < white < 0.97


def test_page_without_a_result_of_ours_says_so(results, tmp_path):
    solid = results[0]
    failed = [replace(r, status="failed", message="out of luck", measured=None, timing=None)
              if r.contestant == OURS else r for r in solid.rows]
    with charts_unwritten():
        write_all(tmp_path, [replace(solid, rows=mark(failed))], describe(1, 0), "again")
    text = (tmp_path / FILES[2]).read_text(encoding="utf-8")
    assert "odt-plugins has no result here: failed, out of luck" in text


def test_scaling_report_opens_and_holds_every_part(tmp_path, monkeypatch):
    monkeypatch.setattr(cold, "JOBS", (("nothing", "", cold.NONE), ("nothing", "", cold.KEPT)))
    monkeypatch.setattr(small, "SMALL", (300,))
    monkeypatch.setattr(small, "MANY", (300, 500, 3))
    for module in (small, local_global, bandwidth):
        monkeypatch.setattr(module, "REPEATS", 1)
    monkeypatch.setattr(bandwidth, "triad_bandwidth", partial(bandwidth.triad_bandwidth, 1 << 16))
    for name in ("SWEEPS", "RUNS", "RUNNING"):
        monkeypatch.setattr(threads, name, 1)
    monkeypatch.setattr(blocks, "WAYS", blocks.WAYS[:2])
    monkeypatch.setattr(generation, "TRUSS_STEPS", 5)
    monkeypatch.setattr(ladder, "AGAINST", ladder.AGAINST[:1])
    said = []
    with in_this_process():
        summary = run_scaling(tmp_path, 1000, 1, said.append)
    values = json.loads((tmp_path / SCALING_FILES[0]).read_text())
    assert {"whole call", "smoothing", "finishing"} <= {s["name"] for s in values["stages"]}
    tables = {t["name"]: t for t in values["tables"]}
    assert set(PARTS) <= set(tables)
    assert all(len(row) == len(t["heads"]) for t in tables.values() for row in t["rows"])
    races = {(r["method"], r["points"]): r for r in values["races"]}
    local, whole = races["Jacobi", 561], races["global, direct", 561]
    assert len(whole["gaps"]) < 8
    assert len(local["gaps"]) > 5 * len(whole["gaps"])
    amg = races["global, AMG", 561]
    assert amg["gaps"][-1] == pytest.approx(whole["gaps"][-1], rel=1e-3)
    assert all(t["title"] in summary for t in tables.values())
    rows = tables["threads"]["rows"]
    assert [row[-1] for row in rows] == ["the same"]
    assert all(row[3] == row[1] / row[2] > 0 and row[6] == row[4] / row[5] > 0 for row in rows)
    assert said
    found = probe(tmp_path / SCALING_FILES[1], tmp_path)
    assert all(found["svgs"])
    assert found["outside"] == []


def test_scaling_measures_only_the_parts_that_were_asked_for(tmp_path):
    run_scaling(tmp_path, 1000, 1, lambda _: None, parts=["multigrid"])
    values = json.loads((tmp_path / SCALING_FILES[0]).read_text())
    assert [t["name"] for t in values["tables"]] == ["multigrid"]


def test_the_page_of_a_batch_shows_every_input_what_failed_first(tmp_path):
    start = ball(100)
    figures = summarize(start.points, start.cells).to_dict() | {"n_cells": 1234567}
    good = {"status": "ok", "message": "", "seconds": 1234.5, "tetwild_seconds": 1000.25,
            "optimize_seconds": 100.25, "compile_seconds": 0.0, "resumed": False}
    good |= {f"{when}_{name}": value for when in ("before", "after")
             for name, value in figures.items()}
    rows = [{"source": f"/models/model-number-{k}.stl", **good} for k in range(40)]
    rows[3] = rows[3] | {"message": "a warning"}
    rows.insert(7, {"source": "/models/<b>bad</b>.stl", "status": "timeout", "resumed": False,
                    "message": "no <i>result</i> within 60 s " * 5, "seconds": 60.0})
    page = tmp_path / "page.html"
    page.write_text(to_page(rows, "odt-plugins batch '<x>'", 1, 2460.0), encoding="utf-8")
    text = page.read_text(encoding="utf-8")
    assert "<b>bad" not in text
    assert "<i>result" not in text
    assert text.index("&lt;b&gt;bad") < text.index("model-number-0")
    assert "<dd>1.0 (41 in 2460 s)</dd>" in text
    assert "<dd>40010.0</dd>" in text
    assert "compiling" not in text
    found = probe(page, tmp_path)
    assert found["wide"] <= found["window"] == WIDTH
    assert found["cut"] == 0
    assert found["cells"] == 40 * (5 + 2 * 7) + 2 + 6
