"""The attack: a few cases of every kind, and its judge and its workers see what is wrong."""

from __future__ import annotations

import itertools
import math

import contract
import numpy as np
import pytest
import reference
import surface_meshes
from attack import command, table
from attack.command import SHARES, main
from attack.cores import compare, settings
from attack.judge import Mesh, broken
from attack.options import all_known
from attack.worker import FAILED, OK, REFUSED, Verdict, Worker, judge
from click.testing import CliRunner

from odt_plugins import figures
from odt_plugins.options import FIGURES, Options

CASES = [("meshes", seed) for seed in range(60, 80)] + [("files", seed) for seed in range(14)]
CASES += [("metrics", seed) for seed in (2, 3, 11, 14, 24, 25, 29, 36, 40, 49)]
CASES += [("sizes", seed) for seed in (*range(100, 112), 1163, 157026605105)]
CASES += [("bent", seed) for seed in (*range(2228, 2238), 121130189, 1035930067560)]
CASES += [("signals", 1), ("disks", 1), ("disks", 4)]


@pytest.mark.parametrize(("kind", "seed"), CASES)
def test_a_case_does_not_fail(kind, seed):
    verdict = judge(f"attack.{kind}", seed)
    assert verdict.outcome in (OK, REFUSED), verdict.details


@pytest.mark.parametrize(
    ("kind", "seed"), [("meshes", 61), ("metrics", 2), ("sizes", 100), ("bent", 2228)])
def test_results_are_judged(kind, seed):
    verdict = judge(f"attack.{kind}", seed)
    assert verdict.outcome == OK, verdict.details


def test_every_option_is_drawn():
    assert all_known() == []


def test_two_kinds_of_processors_come_close():
    points, cells, labels = contract.grid(3, 3)
    compare(points, cells, {"regions": labels}, settings()[:2])
    bowl, triangles = surface_meshes.bowl(8, 0.3)
    compare(bowl, triangles, {}, settings()[:2])


def box(**changes):
    """A grid of tetrahedra of two labels, with an unused vertex, and what differs."""
    points, cells, labels = contract.grid(3, 4)
    mesh = Mesh(np.vstack([points, [[9.0, 9, 9]]]), cells, labels)
    return mesh._replace(**changes)


def bent(**changes):
    points, cells = surface_meshes.torus(12, 8)
    return Mesh(points, cells, (points[cells][:, :, 0].mean(axis=1) > 0).astype(int))._replace(
        **changes)


def moved(mesh, vertex, step):
    points = mesh.points.copy()
    points[vertex] += step
    return points


def free(mesh):
    """A vertex inside."""
    stay = {v for f in contract.facets(mesh.cells, mesh.labels) for v in f}
    return next(v for v in range(len(mesh.points) - 1) if v not in stay)


def inside(mesh):
    """A vertex inside that is as far from its place as goes well."""
    return moved(mesh, free(mesh), 0.02)


def pressed(mesh):
    """A vertex inside that all but touches the opposite face of a cell."""
    v = free(mesh)
    row = mesh.cells[(mesh.cells == v).any(axis=1)][0]
    goal = mesh.points[row[row != v]].mean(axis=0)
    return moved(mesh, v, 0.98 * (goal - mesh.points[v]))


def turned(mesh, row=0):
    cells = mesh.cells.copy()
    cells[row, :2] = cells[row, 1::-1]
    return cells


def other_label(mesh):
    labels = mesh.labels.copy()
    labels[0] = labels.max() + labels.min() - labels[0]
    return labels


def flipped(cells, labels):
    """A flip of two triangles of one label."""
    cells = cells.copy()
    for i, j in itertools.combinations(range(len(cells)), 2):
        shared = set(cells[i]) & set(cells[j])
        if len(shared) == 2 and labels[i] == labels[j]:
            a, b = sorted(shared)
            (c,), (d,) = set(cells[i]) - shared, set(cells[j]) - shared
            ways = [tuple(cells[i][k] for k in (s, (s + 1) % 3)) for s in range(3)]
            a, b = (a, b) if (a, b) in ways else (b, a)
            cells[i], cells[j] = (a, d, c), (d, b, c)
            return cells
    raise ValueError


VOLUMES = {
    "points have shape": lambda m: (m, {"points": m.points[:, :2]}, {}),
    "there are": lambda m: (m, {"points": m.points[:-1]}, {}),
    "not finite": lambda m: (m, {"points": moved(m, free(m), np.nan)}, {}),
    "name vertices up to": lambda m: (m, {"cells": m.cells + 9}, {}),
    "is flat or inverted": lambda m: (m, {"points": moved(m, free(m), 1.0)}, {}),
    "two cells on one side": lambda m: (m, {"cells": turned(m)}, {}),
    "held vertex 0 moved": lambda m: (m, {"points": moved(m, 0, [1e-16, 0, 0])}, {}),
    "held vertex 125 moved": lambda m: (m, {"points": moved(m, -1, 1e-9)}, {}),
    "min_quality went": lambda m: (m, {"points": pressed(m)}, {"keep": ("min_quality",)}),
    "mean_quality went": lambda m: (m, {"points": pressed(m)}, {"keep": ("mean_quality",)}),
    "max_angle went": lambda m: (m, {"points": pressed(m)}, {"keep": ("max_angle",)}),
    "gone or has other labels": lambda m: (m, {"labels": other_label(m)}, {}),
    "volume of label": lambda m: (m, {"labels": other_label(m)}, {}),
    "is new": lambda m: (m, {"cells": m.cells[1:], "labels": m.labels[1:]}, {}),
    "came into use": lambda m: (m, {"cells": np.where(m.cells == free(m), 125, m.cells)}, {}),
    "outside of the selection": lambda m: (m, {"cells": np.roll(m.cells, 1, axis=0) + 1},
                                           {"selection": [3]}),
    "labels for": lambda m: (m, {"labels": m.labels[1:]}, {}),
    "more than two cells": lambda m: (m, {"cells": np.vstack([m.cells, m.cells[:1]]),
                                          "labels": np.append(m.labels, m.labels[0])}, {}),
    "is not among the vertices": lambda m: (m, {"points": m.points[1:], "cells": np.maximum(
        m.cells - 1, 0)}, {"insert": True}),
    "vertices are in use": lambda m: (m, _refined(m), {"insert": 0.1}),
    "of its diagonal from the input": lambda m: (m, {"points": moved(m, 0, -0.05)},
                                                 {"boundary": "slide"}),
    "the volume of label 0": lambda m: (m, {"points": moved(m, 0, -0.05)},
                                        {"boundary": "slide"}),
}


def _refined(mesh):
    """A new vertex in each of many cells."""
    points, cells = mesh.points, mesh.cells[20:].tolist()
    for row in mesh.cells[:20].tolist():
        cells += [[*row[:i], len(points), *row[i + 1 :]] for i in range(4)]
        points = np.vstack([points, points[row].mean(axis=0)])
    return {"points": points, "cells": np.array(cells), "labels": None}


@pytest.mark.parametrize("words", VOLUMES)
def test_the_judge_names_what_a_mesh_of_tetrahedra_does_not_keep(words):
    before, changes, options = VOLUMES[words](box())
    faults = broken(before, before._replace(**changes), Options(**{"keep": ()} | options))
    assert any(words in fault for fault in faults), faults


def test_the_judge_names_no_fault_of_a_mesh_that_keeps_everything():
    mesh = box()
    assert broken(mesh, mesh, Options()) == []
    order = np.random.default_rng(1).permutation(len(mesh.cells))
    other = Mesh(inside(mesh), mesh.cells[order], mesh.labels[order])
    for insert in (False, True):
        assert broken(mesh, other, Options(keep=(), insert=insert)) == []
    both = (mesh._replace(cells=contract.negative(mesh.cells)),
            other._replace(cells=contract.negative(other.cells)))
    assert broken(*both, Options(keep=())) == []
    sliding = other._replace(points=moved(other, 0, -1e-4))
    assert broken(mesh, sliding, Options(keep=(), boundary="slide")) == []
    unlabelled = other._replace(labels=None)
    assert broken(mesh, unlabelled, Options(keep=())) == []


def test_a_volume_whose_sign_rounding_hides_is_seen():
    """The determinant of numpy has the wrong sign or none, the rational one is a millionth."""
    tiny = 2.0**-60
    points = np.array([[0.1, 0.1], [0.2, 0.2], [0.3, 0.3 - tiny], [0.7, 0.7]])
    exact = [[1, 2, 3], [0, 1, 3]]
    assert reference.exact_signs(points, np.array(exact)).tolist() == [
        np.sign(_fraction(points, row)) for row in exact]


def _fraction(points, row):
    from fractions import Fraction

    (a, b), (c, d), (e, f) = [[Fraction(float(x)) for x in points[v]] for v in row]
    return float((c - a) * (f - b) - (d - b) * (e - a))


SURFACES = {
    "triangles, there were": lambda m: ({"cells": m.cells[1:], "labels": m.labels[1:]}, {}),
    "topology": lambda m: ({"cells": np.where(m.cells == 3, 50, m.cells)}, {}),
    "disagree about the outside": lambda m: ({"cells": turned(m)}, {}),
    "lie between labels": lambda m: ({"labels": np.roll(m.labels, 5)}, {}),
    "other numbers of triangles": lambda m: ({"labels": other_label(m)}, {}),
    "of its diagonal from the input": lambda m: ({"points": moved(m, 0, 0.05)}, {}),
    "have no area": lambda m: ({"points": moved(m, 0, m.points[1] - m.points[0])}, {}),
    "held vertex 4 moved": lambda m: ({"points": moved(m, 4, 1e-9)}, {"fixed": [4]}),
    "outside of the selection": lambda m: ({"cells": flipped(m.cells, m.labels)},
                                           {"selection": [90]}),
    "min_angle went": lambda m: ({"points": moved(m, 0, 0.05)}, {"keep": ("min_angle",)}),
}


@pytest.mark.parametrize("words", SURFACES)
def test_the_judge_names_what_a_surface_does_not_keep(words):
    mesh = bent()
    changes, options = SURFACES[words](mesh)
    faults = broken(mesh, mesh._replace(**changes), Options(**{"keep": ()} | options), curved=True)
    assert any(words in fault for fault in faults), faults


def test_the_judge_names_no_fault_of_a_surface_that_keeps_everything():
    mesh = bent()
    assert broken(mesh, mesh, Options(), curved=True) == []
    other = mesh._replace(cells=flipped(mesh.cells, mesh.labels))
    assert broken(mesh, other, Options(keep=(), envelope=0.2), curved=True) == []


def test_rims_in_the_plane_are_measured_from_those_of_a_reference_however_tangled_it_is():
    points, cells, _ = contract.grid(2, 4)
    inner = np.argmin(np.abs(points - points.mean(axis=0)).sum(axis=1))
    tangled = moved(Mesh(points, cells), inner, np.array([2.0, 0.3]) * np.ptp(points))
    corner = np.lexsort(points.T)[0]
    after = Mesh(moved(Mesh(points, cells), corner, np.array([-0.004, 0.0])), cells)
    for envelope, faults in ((0.01, 0), (0.001, 1)):
        options = Options(boundary="slide", envelope=envelope, reference=(tangled, cells), keep=())
        found = broken(Mesh(points, cells), after, options, curved=False)
        assert sum("of its diagonal from the input" in fault for fault in found) == faults, found


@pytest.mark.parametrize("mesh", [contract.grid(2, 4)[:2], contract.grid(3, 3)[:2],
                                  surface_meshes.torus(12, 8, 0.5)])
def test_figures_of_the_judge_are_those_of_the_page(mesh):
    """Two independent programs of the same definitions."""
    found, known = reference.figures(*mesh), figures.summarize(*mesh)
    for name in FIGURES:
        assert float(found[name]) == pytest.approx(getattr(known, name), rel=1e-13)
    q, least, largest = reference.cell_figures(np.vstack([np.zeros(3), np.eye(3), np.ones(3)]),
                                               np.array([[1, 2, 3, 4], [0, 1, 2, 3]]))
    assert float(q[0]) == pytest.approx(1, rel=1e-15)
    assert float(least[0]) == pytest.approx(math.degrees(math.acos(1 / 3)))
    assert float(largest[1]) == pytest.approx(90)


NAUGHTY = """
import os
import numpy as np
def attack(rng, folder):
    {}
"""


@pytest.mark.parametrize(("body", "words"), [
    ("raise KeyError(7)", "KeyError: 7"), ("1 / np.zeros(1)", "RuntimeWarning: divide"),
    ("print(3)", "it printed '3'"), ("open(folder / 'a', 'w')", "left behind: ResourceWarning"),
    ("while True: pass", "hang: no end after 0.25 s"), ("os.abort()", "crash: SIGABRT"),
    ("os._exit(0)", "crash: exit code 0"),
])
def test_what_may_befall_a_case_is_a_verdict(body, words, tmp_path, monkeypatch):
    name = f"naughty_{abs(hash(body))}"
    (tmp_path / f"{name}.py").write_text(NAUGHTY.format(body))
    monkeypatch.syspath_prepend(tmp_path)
    if words.startswith(("hang", "crash")):
        worker = Worker(name, 0.25)
        try:
            verdicts = [worker.run(0), worker.run(1)]
        finally:
            worker.stop()
    else:
        verdicts = [judge(name, 0)]
    for verdict in verdicts:
        assert verdict.outcome == FAILED
        assert words in verdict.sentence


class Played:
    """A worker whose verdicts are known."""

    def __init__(self, module, _seconds):
        self.module, self.ended = module, False

    def run(self, seed):
        if seed == 9:
            raise KeyboardInterrupt
        return Verdict(*[(OK,), (REFUSED, "no"), (FAILED, "it fell", "a stack")][seed % 3])

    def stop(self):
        self.ended = True


@pytest.mark.parametrize(("words", "rows", "code"), [
    (["--seed", "0", "--cases", "3"], [f"| {kind} | 3 | 1 | 1 | 1 |" for kind in SHARES], 1),
    (["--seed", "0", "--cases", "2"], [f"| {kind} | 2 | 1 | 1 | 0 |" for kind in SHARES], 0),
    (["--kind", "disks", "--seed", "5", "--cases", "9"], ["| disks | 4 | 1 | 1 | 2 |"], 1),
    (["--kind", "meshes", "--seed", "2"], ["--kind meshes --seed 2: FAILED it fell", "a stack",
                                           "| meshes | 1 | 0 | 0 | 1 |"], 1),
    (["--kind", "meshes", "--minutes", "0"], ["| meshes | 0 | 0 | 0 | 0 |"], 0),
])
def test_the_command_counts_tells_and_ends(words, rows, code, monkeypatch):
    monkeypatch.setattr(command, "Worker", Played)
    done = CliRunner().invoke(main, words)
    assert done.exit_code == code
    for row in rows:
        assert row in done.output
    assert done.output.count("FAILED it fell") == sum(
        int(line.split("|")[5]) for line in done.output.splitlines() if line.startswith("| ")
        and line.split("|")[1].strip() in SHARES)


def test_the_table_goes_into_the_page(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"above\n{table.MARKS[0]}\nold\n{table.MARKS[1]}\nbelow\n")
    table.record(["| new |"], page)
    assert page.read_text() == f"above\n{table.MARKS[0]}\n\n| new |\n\n{table.MARKS[1]}\nbelow\n"
