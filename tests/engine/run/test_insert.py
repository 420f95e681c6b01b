"""`insert=True` from the caller's side: figures, promise, numbers of vertices, data, hosts."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import contract
import meshio
import numpy as np
import pytest
import quadratic_meshes
import tet_meshes as tm
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from measure.hard import hard_meshes
from promises import assert_promise, facet_set, measure, mesh_of
from scipy.spatial import cKDTree

import odt_plugins
from odt_plugins.carrying.sources import surrounding_cells
from odt_plugins.cli.main import cli
from odt_plugins.engine.finish import resampling
from odt_plugins.engine.odt.rounds import Log
from odt_plugins.engine.record.figures import figures
from odt_plugins.engine.run import plan, stages
from odt_plugins.engine.run.outcome import Outcome
from odt_plugins.engine.run.plan import run
from odt_plugins.errors import InvalidOptionError
from odt_plugins.mesh.simplex import simplex_mesh
from odt_plugins.options import Options

DATA = Path(__file__).parents[2] / "data"
CGAL_BUNNY = Path(odt_plugins.__file__).parent / "compare" / "data" / "cgal-bunny.vtu"


def assert_inserted(mesh, outcome, share=0.5):
    """The promise, told by slow code, for vertices that came and went."""
    n = len(mesh.points)
    origin = outcome.origin
    kept = origin[origin >= 0]
    added = int((origin < 0).sum())
    assert np.array_equal(origin[: len(kept)], kept)
    assert (np.diff(kept) > 0).all()
    assert added <= int(share * n) + n - len(kept)
    facets = facet_set(mesh.cells, mesh.regions)
    held = np.zeros(n, dtype=bool)
    held[[v for f, _ in facets for v in f]] = True
    held |= mesh.fixed
    held[mesh.cells[mesh.frozen]] = True
    number = np.full(n, -1)
    number[kept] = np.arange(len(kept))
    assert (number[held] >= 0).all()
    assert (number[np.setdiff1d(np.arange(n), mesh.cells)] >= 0).all()
    assert outcome.points[number[held]].tobytes() == mesh.points[held].tobytes()
    new_facets = facet_set(outcome.cells, outcome.regions)
    assert new_facets == {(tuple(sorted(int(number[v]) for v in f)), r) for f, r in facets}
    assert (tm.signed_volumes(outcome.points, outcome.cells) > 0).all()
    for label in np.unique(mesh.regions):
        whole = tm.signed_volumes(mesh.points, mesh.cells[mesh.regions == label]).sum()
        now = tm.signed_volumes(outcome.points, outcome.cells[outcome.regions == label]).sum()
        assert now == pytest.approx(whole, rel=1e-9)
    cells = {tuple(sorted(c)) for c in outcome.cells.tolist()}
    for cell in mesh.cells[mesh.frozen]:
        assert tuple(sorted(int(number[v]) for v in cell)) in cells
    before, after = measure(mesh.points, mesh.cells), measure(outcome.points, outcome.cells)
    assert (after >= before - 1e-7 * np.abs(before)).all(), (before, after)
    used = np.unique(outcome.cells)
    assert np.isin(np.flatnonzero(origin < 0), used).all()


def tetrahedra(path):
    mesh = meshio.read(path)
    return mesh.points, mesh.cells_dict["tetra"]


def test_cgal_bunny_reaches_the_figures_of_no_other_tool():
    points, cells = tetrahedra(CGAL_BUNNY)
    (p, t), report = odt_plugins.optimize_with_report((points, cells), insert=True)
    q, angle = tm.quality(p, t), tm.dihedral_angles(p, t)
    assert angle.min() >= 17.6
    assert q.min() >= 0.22
    assert (angle.min(axis=1) < 20).sum() <= 15
    assert q.mean() >= 0.823
    assert np.quantile(q, 0.01) >= 0.47
    assert len(p) <= 1.15 * len(points)
    assert report.counts["rounds of insertion"] > 0
    counts = report.counts
    told = {name for name in (*counts, *report.times) if "vert" in name or "sampl" in name}
    assert told - {"vertex moves"} == {"vertices added", "vertices removed"}
    assert len(p) == len(points) + counts["vertices added"] - counts["vertices removed"]
    assert report.after.n_points == len(p)
    assert "vertices added" in str(report)


@pytest.fixture(scope="module")
def bone():
    """A mesh of TetWild, and what becomes of it without and with insertion: mesh, report."""
    points, cells = tetrahedra(DATA / "bone05.vtu")
    return (points, cells), *(odt_plugins.optimize_with_report((points, cells), insert=insert)
                              for insert in (False, True))


def test_a_mesh_of_tetwild_gains_in_every_figure(bone):
    plain, inserted = ((out[0], out[1][:, [1, 0, 2, 3]]) for out, _ in bone[1:])
    gain = measure(*inserted) - measure(*plain)
    assert gain[0] > -1e-12
    assert gain[1] > 0.02
    assert gain[2] > 0.02
    before, after = (tm.dihedral_angles(*out).min(axis=1) for out in (plain, inserted))
    assert (after < 20).sum() <= (before < 20).sum()
    assert (before < 25).sum() > 50
    assert (after < 25).sum() < 0.1 * (before < 25).sum()


def start(seed=5, n=500):
    return tm.ball(n, seed)


def labelled_start():
    """Regions, fixed vertices, frozen cells, an unused vertex."""
    points, cells = start()
    points = np.vstack([points, [[9.0, 9.0, 9.0]]])
    rng = np.random.default_rng(1)
    fixed = np.zeros(len(points), dtype=bool)
    fixed[rng.choice(len(points) - 1, 30, replace=False)] = True
    frozen = np.zeros(len(cells), dtype=bool)
    frozen[rng.choice(len(cells), 40, replace=False)] = True
    regions = (points[cells].mean(axis=1)[:, 0] > 3).astype(np.int32)
    return mesh_of(points, cells, regions, fixed, frozen)


def test_promise_with_regions_fixed_and_frozen_on_any_number_of_threads(many_threads):
    mesh = labelled_start()
    outcome, again = (
        run(mesh, Options(insert=True, threads=k, objective="min_dihedral")) for k in (1, 2)
    )
    assert outcome.origin is not None
    assert_inserted(mesh, outcome)
    assert again.points.tobytes() == outcome.points.tobytes()
    assert again.cells.tobytes() == outcome.cells.tobytes()
    assert again.origin.tobytes() == outcome.origin.tobytes()


def test_unit_and_place_do_not_matter():
    points, cells = start(n=200)
    points = points.astype(np.float32).astype(float)
    options = Options(insert=True, objective="min_dihedral")
    here = run(mesh_of(points, cells), options)
    assert here.origin is not None
    for scale, shift in ((2.0**-30, 0.0), (2.0**30, 0.0), (1.0, 4096.0)):
        there = run(mesh_of(points * scale + shift, cells), options)
        assert np.array_equal(there.origin, here.origin), (scale, shift)
        assert np.array_equal(there.cells, here.cells), (scale, shift)
        assert (there.points - shift) / scale == pytest.approx(here.points, abs=1e-9)


@pytest.mark.parametrize("seed", [2, 4])
@pytest.mark.parametrize("share", [0.02, 0.1])
def test_no_more_vertices_than_the_share(share, seed):
    mesh = mesh_of(*start(seed))
    outcome = run(mesh, Options(insert=share))
    assert outcome.origin is not None
    assert_inserted(mesh, outcome, share)
    assert len(outcome.points) > len(mesh.points) - 50


def test_few_vertices_come_where_few_are_needed():
    growth = []
    for seed in range(5, 9):
        better = run(mesh_of(*start(seed, 250)), Options())
        again = run(mesh_of(better.points, better.cells), Options(insert=True))
        growth.append(len(again.points) / len(better.points))
    assert np.mean(growth) < 1.05


@pytest.mark.parametrize("gain", [1.0, -1.0])
def test_a_phase_stays_only_if_the_score_rises(gain, monkeypatch):
    points, cells = start()
    mesh = resampling.with_spare_vertices(
        points, cells, np.zeros(len(cells), dtype=np.int32), np.ones(len(points), dtype=bool),
        np.zeros(len(points), dtype=bool), np.zeros(len(points), dtype=bool), True)
    before = figures(points, cells)
    scores = itertools.count(0.0, gain)
    monkeypatch.setattr(resampling, "resample", lambda *_: (1, 10**9))
    monkeypatch.setattr(
        resampling, "_figures", lambda *_: replace(before, score=before.score + next(scores)))
    settled, offered = [], []
    resampling.resample_in_rounds(
        mesh, before, "radius_ratio", limits=lambda _: None,
        settle=lambda work, *_: settled.append(work),
        offer=lambda work: offered.append(work) or True, report=lambda _: None, log=Log(),
    )
    assert len(offered) == len(settled) + 1
    assert all(work is not mesh for work in settled)


@pytest.mark.parametrize(("objective", "held"), [("radius_ratio", 0.2), ("min_dihedral", 0.1)])
def test_angles_may_cost_radius_ratios_down_to_those_of_the_input(objective, held):
    before = figures(*start())
    before = replace(before, min_quality=0.1, cos_min_angle=0.9)
    now = replace(before, min_quality=0.2, cos_min_angle=0.8)
    bounds = stages.held_by_insertion(Options(insert=True, objective=objective), before, now)
    assert bounds.cells.quality == held
    assert bounds.cells.large == 0.8


def test_insertion_goes_on_from_the_input_when_nothing_else_helps(monkeypatch):
    monkeypatch.setattr(plan, "in_cycles", lambda mesh, _: (mesh, "left out"))
    monkeypatch.setattr(plan, "worst_cells", lambda *_: None)
    monkeypatch.setattr(plan, "finish_alone", lambda *_, **__: None)
    mesh = mesh_of(*start())
    outcome = run(mesh, Options(insert=True))
    assert outcome.origin is not None
    assert_inserted(mesh, outcome)
    monkeypatch.setattr(resampling, "resample_in_rounds", lambda *_, **__: None)
    assert "nothing could be improved" in run(mesh, Options(insert=True)).stop_reason


# Data and hosts.


def resampled(mesh, options, leaving=None):
    """Stand-in for the engine: removes a vertex, splits three cells, shuffles the cells."""
    del options
    n = len(mesh.points)
    held = mesh.fixed | mesh.anchored
    for facet in contract.facets(mesh.cells, mesh.regions):
        held[list(facet)] = True
    held[mesh.cells[mesh.frozen]] = True
    rows = [(tuple(c), int(r), bool(f)) for c, r, f in
            zip(mesh.cells.tolist(), mesh.regions, mesh.frozen, strict=True)]

    def removed():
        for v in np.flatnonzero(~held):
            star = [row for row in rows if v in row[0]]
            for w in sorted({u for c, _, _ in star for u in c} - {v}):
                new = [(tuple(w if u == v else u for u in c), r, f) for c, r, f in star
                       if w not in c]
                if (contract.volumes(mesh.points, [c for c, _, _ in new]) > 1e-6).all():
                    return int(v), [row for row in rows if v not in row[0]], new
        pytest.fail("no vertex can be removed")

    gone, rest, new = removed()
    added = []
    for _ in range(3):
        at = next(i for i, row in enumerate(rest) if not row[2])
        cell, label, _ = rest.pop(at)
        added.append(np.array([0.1, 0.2, 0.3, 0.4]) @ mesh.points[list(cell)])
        number = n + len(added) - 1
        new += [(tuple(number if u == v else u for u in cell), label, False) for v in cell]
    rows = (rest + new)[::-1]
    kept = np.delete(np.arange(n), gone)
    place = np.append(np.arange(n) - (np.arange(n) > gone), n - 1 + np.arange(3))
    return Outcome(
        np.vstack([mesh.points[kept], added]),
        place[[c for c, _, _ in rows]].astype(np.int32),
        np.array([r for _, r, _ in rows], dtype=np.int32),
        origin=np.append(kept, [-1, -1, -1]),
    )


def in_old_numbers(before, after, origin):
    """Views of input and output with the vertices of both: old ones, then new ones."""
    n = len(before.points)
    new = np.flatnonzero(origin < 0)
    number = np.where(origin < 0, n - len(origin) + len(new) + np.arange(len(origin)), origin)

    def together(old, values):
        both = np.concatenate([old, values[new]])
        both[number] = values
        return both

    def extended(old, values):
        return np.concatenate([old, values[new]])

    data = before.point_data
    a = replace(before, points=extended(before.points, after.points),
                point_data={k: extended(v, after.point_data[k]) for k, v in data.items()})
    b = replace(after, points=together(before.points, after.points),
                cells=number[after.cells.astype(np.int64)].astype(after.cells.dtype),
                point_data={k: together(v, after.point_data[k]) for k, v in data.items()})
    return a, b


LINEAR_HOSTS = [name for name, host in contract.HOSTS.items()
                if host.dim == 3 and "quadratic" not in name]


@pytest.mark.parametrize("name", LINEAR_HOSTS)
def test_contract_of_every_host(name, monkeypatch, tmp_path):
    contract.need(name)
    monkeypatch.chdir(tmp_path)
    host = contract.HOSTS[name]
    outcomes = []
    monkeypatch.setattr(plan, "run", lambda *a: outcomes.append(resampled(*a)) or outcomes[0])
    mesh = host.make()
    before = host.view(mesh)
    out = host.optimize(mesh, insert=True, keep=())
    assert type(out) is type(mesh)
    assert contract.same_bits(host.view(mesh), before)
    after = host.view(out)
    origin = outcomes[0].origin
    assert len(after.points) == len(origin)
    contract.check(host, *in_old_numbers(before, after, origin))
    corners = [around(before, after.points[i]) for i in np.flatnonzero(origin < 0)]
    for key, values in before.point_data.items():
        weights = np.array([0.1, 0.2, 0.3, 0.4])
        for i, cell in zip(np.flatnonzero(origin < 0), corners, strict=True):
            exact = np.tensordot(weights, values[cell].astype(float), 1)
            assert after.point_data[key][i] == pytest.approx(exact, rel=1e-5), key


def around(view, x):
    """Vertices of the cell in which x has the coordinates .1, .2, .3, .4, in that order."""
    for cell in view.cells.astype(np.int64):
        for order in itertools.permutations(cell):
            if np.allclose(np.array([0.1, 0.2, 0.3, 0.4]) @ view.points[list(order)].astype(float),
                           x, atol=1e-6):
                return np.array(order)
    pytest.fail("the new vertex is in no cell")


@given(seed=st.integers(0, 1000), scale=st.sampled_from([1e-9, 1.0, 1e9]))
def test_linear_fields_are_interpolated_exactly(seed, scale):
    points, cells = tm.ball(60, seed)
    points *= scale
    rng = np.random.default_rng(seed)
    inside = rng.dirichlet(np.ones(4), 20)
    x = np.einsum("kc,kcd->kd", inside, points[cells[rng.integers(0, len(cells), 20)]])
    cell, weights = surrounding_cells(simplex_mesh(points, cells)[0], x)
    corners = cells[cell]
    assert (weights >= -1e-12).all()
    assert weights.sum(axis=1) == pytest.approx(1.0)
    assert np.einsum("kc,kcd->kd", weights, points[corners]) == pytest.approx(x, abs=1e-11 * scale)


def test_points_far_from_every_barycentre_are_found():
    """One long cell beside more small ones than are looked at first."""
    points, cells = tm.grid(5, 1)
    low = int(np.flatnonzero((points == [5, 0, 0]).all(axis=1))[0])
    a, b = (int(np.flatnonzero((points == x).all(axis=1))[0]) for x in ([5, 1, 0], [5, 1, 1]))
    tip = len(points)
    points = np.vstack([points, [[4000.0, 0.5, 0.2]]])
    cells = np.vstack([cells, [[low, a, b, tip]]]).astype(np.int32)
    assert tm.signed_volumes(points, cells[-1:])[0] > 0
    x = np.array([[0.333, 0.333, 0.333, 1e-4]]) @ points[cells[-1]] + [[1e-3, 0, 0]]
    cell, weights = surrounding_cells(simplex_mesh(points, cells)[0], x)
    corners = cells[cell]
    assert set(corners[0].tolist()) == {low, a, b, tip}
    assert weights[0] @ points[corners[0]] == pytest.approx(x[0])


def test_labels_of_vertices_are_those_of_the_nearest_corner(monkeypatch):
    monkeypatch.setattr(plan, "run", resampled)
    points, cells, _ = contract.grid(3, 4)
    label = np.arange(len(points)) * 10
    name = np.array([f"v{i}" for i in range(len(points))])
    flag = np.arange(len(points)) % 3 == 0
    mesh = meshio.Mesh(points, [("tetra", cells)],
                       point_data={"label": label, "name": name, "flag": flag})
    out = odt_plugins.optimize(mesh, insert=True, keep=())
    view = contract.meshio_view("tetra")(mesh)
    for i in range(len(out.points) - 3, len(out.points)):
        nearest = around(view, out.points[i])[3]
        assert out.point_data["label"][i] == label[nearest]
        assert out.point_data["name"][i] == name[nearest]
        assert out.point_data["flag"][i] == flag[nearest]
    assert out.point_data["label"].dtype == label.dtype


def test_sets_vertex_cells_and_entities_of_meshio_follow(monkeypatch):
    points, cells, labels = contract.grid(3, 4)
    inner = np.flatnonzero(((points > 0) & (points < 1)).all(axis=1) & (points[:, 0] != 0.5))
    labels = np.where(labels == 7, 1, 2)
    shown = inner[:3]
    monkeypatch.setattr(plan, "run", resampled)
    sides = np.array(sorted(contract.facets(cells, np.zeros(len(cells), int))))[:7]
    blocks = [("vertex", shown[:, None]), ("tetra", cells), ("triangle", sides)]
    tags = [np.zeros(3, int), labels, np.zeros(7, int)]
    entities = np.column_stack([np.full(len(points), 2), np.full(len(points), 9)])
    mesh = meshio.Mesh(points, blocks, point_data={"gmsh:dim_tags": entities},
                       cell_data={"gmsh:geometrical": tags},
                       point_sets={"some": np.array([inner[3], inner[4]])})
    out = odt_plugins.optimize(mesh, insert=True, keep=())
    assert len(out.points) == len(points) + 2
    assert np.array_equal(out.points[out.cells[0].data], points[shown][:, None])
    assert np.array_equal(out.points[out.cells[2].data], points[sides])
    assert np.array_equal(out.points[out.point_sets["some"]], points[[inner[3], inner[4]]])
    assert np.array_equal(out.point_data["gmsh:dim_tags"][:-3], entities[: len(points) - 1])
    for i in range(len(out.points) - 3, len(out.points)):
        dim, tag = out.point_data["gmsh:dim_tags"][i]
        around_it = (out.cells[1].data == i).any(axis=1)
        assert dim == 3
        assert set(out.cell_data["gmsh:geometrical"][1][around_it]) == {tag}


def test_lines_and_vertex_cells_of_pyvista_follow(monkeypatch):
    pyvista = pytest.importorskip("pyvista")
    points, cells, _ = contract.grid(3, 4)
    inner = np.flatnonzero(((points > 0) & (points < 1)).all(axis=1))
    monkeypatch.setattr(plan, "run", resampled)
    side = contract.facets(cells, np.zeros(len(cells), int))
    line = np.array(sorted(side)[0][:2])
    flat = np.concatenate([[2], line, [2], inner[:2],
                           np.column_stack([np.full(len(cells), 4), cells]).ravel()])
    kinds = np.array([3, 2] + [10] * len(cells), dtype=np.uint8)
    grid = pyvista.UnstructuredGrid(flat, kinds, points)
    grid.point_data["t"] = points @ [1.0, 2.0, 3.0]
    grid.cell_data["c"] = np.arange(grid.n_cells)
    out = odt_plugins.optimize(grid, insert=True, keep=())
    assert out.n_points == grid.n_points + 2
    assert np.array_equal(out.get_cell(0).points, points[line])
    assert np.array_equal(out.get_cell(1).points, points[inner[:2]])
    assert np.array_equal(out.cell_data["c"][:2], [0, 1])
    assert out.point_data["t"][-3:] == pytest.approx(out.points[-3:] @ [1.0, 2.0, 3.0])
    assert out.point_data.active_scalars_name == grid.point_data.active_scalars_name


def test_small_index_types_grow(monkeypatch):
    monkeypatch.setattr(plan, "run", resampled)
    points, cells, _ = contract.grid(3, 4)
    points = np.vstack([points, np.ones((254 - len(points), 3))])
    out = odt_plugins.optimize((points, cells.astype(np.uint8)), insert=True, keep=())
    assert out[1].dtype == np.uint8
    assert len(out[0]) == 256
    points = np.vstack([points, np.ones((1, 3))])
    out = odt_plugins.optimize((points, cells.astype(np.uint8)), insert=True, keep=())
    assert out[1].dtype == np.uint16
    assert (contract.volumes(*out) > 0).all()


@pytest.mark.parametrize("name", [
    name for name, host in contract.HOSTS.items() if host.dim == 3 and "quadratic" in name])
def test_curved_cells_stay_as_vertices_come(name, monkeypatch, tmp_path):
    contract.need(name)
    monkeypatch.chdir(tmp_path)
    host = contract.HOSTS[name]
    mesh = host.make()
    (old, rows), (new, cells) = (quadratic_meshes.view(m, 3)[:2] for m in (
        mesh, host.optimize(mesh, insert=0.5, keep=())))
    assert (contract.volumes(new, cells[:, :4]) > 0).all()
    off = [(old[row[k]] - old[[row[i], row[j]]].mean(axis=0)) for row in rows.tolist()
           for k, (i, j) in enumerate(quadratic_meshes.EDGES[3], 4)]
    curved = (np.abs(off) > 1e-2).any(axis=1).reshape(len(rows), -1).any(axis=1)
    assert curved.any()
    was, now = ({frozenset(map(tuple, cell)) for cell in x.tolist()}
                for x in (old[rows[curved]], new[cells]))
    assert was <= now


@pytest.mark.parametrize("name", [name for name, host in contract.HOSTS.items() if host.dim == 2])
def test_other_meshes_are_refused_before_any_work(name, monkeypatch, tmp_path):
    contract.need(name)
    monkeypatch.chdir(tmp_path)
    host = contract.HOSTS[name]
    monkeypatch.setattr(plan, "run", lambda *_: pytest.fail("work was done"))
    with pytest.raises(InvalidOptionError, match=r"insert=True for a mesh of (triangles|faces)"):
        host.optimize(host.make(), insert=True)
    with pytest.raises(InvalidOptionError, match=r"insert=0.2 for a mesh of (triangles|faces)"):
        host.optimize(host.make(), insert=0.2)


def test_progress_goes_on_to_one():
    seen = []
    run(mesh_of(*start()), Options(insert=True, progress=lambda *pair: seen.append(pair)))
    shares = [share for _, share in seen]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    stages = [stage for stage, _ in seen]
    assert stages.index("finishing") < stages.index("inserting")


@pytest.mark.parametrize("objective", ["min_dihedral", "amips"])
def test_every_objective_gains(objective):
    points, cells = tetrahedra(DATA / "bone05.vtu")
    plain, inserted = (odt_plugins.optimize_with_report(
        (points, cells), insert=insert, objective=objective)[1].after for insert in (False, True))
    assert inserted.below_20 <= plain.below_20
    assert inserted.mean_quality > plain.mean_quality + 0.01
    assert inserted.mean_amips < plain.mean_amips - 0.1
    if objective == "min_dihedral":
        assert inserted.min_angle > plain.min_angle + 2.0


SOLID = {mesh.name: mesh for mesh in hard_meshes(100, (3,))}


@pytest.mark.parametrize("name", SOLID)
def test_hard_meshes(name):
    hard = SOLID[name]
    mesh = mesh_of(hard.points, hard.cells, hard.regions)
    outcome = run(mesh, Options(insert=True))
    if outcome.origin is None:
        assert_promise(mesh, outcome)
    else:
        assert_inserted(mesh, outcome)


@pytest.mark.parametrize("name", ["graded", "dense spot", "helix", "shells", "ring", "layers",
                                  "sheared", "regions, slabs"])
def test_hard_meshes_whose_surface_slides(name):
    hard = SOLID[f"{name}, space"]
    mesh = mesh_of(hard.points, hard.cells, hard.regions)
    n = len(mesh.points)
    outcome = run(mesh, Options(insert=True, boundary="slide", envelope=5e-3))
    points, cells = outcome.points, outcome.cells
    assert (tm.signed_volumes(points, cells) > 0).all()
    before, after = measure(mesh.points, mesh.cells), measure(points, cells)
    assert (after >= before - 1e-7 * np.abs(before) - 2e-13).all(), (before, after)
    origin = np.arange(n) if outcome.origin is None else outcome.origin
    old, new = ({f for f, _ in facet_set(c, 0 * c[:, 0])} for c in (mesh.cells, cells))
    surface = [np.unique(np.array(sorted(f))) for f in (old, new)]
    assert np.array_equal(surface[0], origin[surface[1]])
    assert len(old) == len(new)
    volume = tm.signed_volumes(mesh.points, mesh.cells).sum()
    assert tm.signed_volumes(points, cells).sum() == pytest.approx(volume, rel=3e-3)
    length = 5e-3 * np.linalg.norm(np.ptp(mesh.points, axis=0))
    sides = [(mesh.points, np.array(sorted(old))), (points, np.array(sorted(new)))]
    for (x, f), (y, g) in (sides, sides[::-1]):
        assert furthest(x[f].mean(axis=1), y, g) <= length * (1 + 1e-9)


def furthest(x, points, triangles):
    """Largest distance of x (k, 3) from triangles, by brute force over their planes and edges."""
    a, b, c = (points[triangles[:, i]][None] for i in range(3))
    p = x[:, None]
    best = np.full((len(x), len(triangles)), np.inf)
    for u, v in ((a, b), (b, c), (c, a)):
        along = np.clip(((p - u) * (v - u)).sum(-1) / ((v - u) ** 2).sum(-1), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(u + along[..., None] * (v - u) - p, axis=-1))
    normal = np.cross(b - a, c - a)
    area = (normal**2).sum(-1)
    height = ((p - a) * normal).sum(-1) / np.where(area > 0.0, area, 1.0)
    foot = p - height[..., None] * normal
    inside = np.logical_and.reduce(
        [(np.cross(v - u, foot - u) * normal).sum(-1) > 0.0 for u, v in ((a, b), (b, c), (c, a))]
    )
    plane = np.where(inside, np.abs(height) * np.sqrt(area), np.inf)
    return np.minimum(best, plane).min(axis=1).max()


def test_a_surface_that_slides_is_left_where_it_slid():
    points, cells = tetrahedra(DATA / "bone05.vtu")
    (p, _), report = odt_plugins.optimize_with_report(
        (points, cells), insert=True, boundary="slide")
    slid, plain = odt_plugins.optimize_with_report((points, cells), boundary="slide")
    # only how far vertices go out for the volume's sake depends on the cells inside
    assert report.slid == pytest.approx(plain.slid, rel=1e-3)
    assert report.slid["vertices"] > 50
    assert len(p) != len(points)
    assert report.after.mean_quality > plain.after.mean_quality + 0.01
    surface = np.unique([v for f in facet_set(slid[1], np.zeros(len(slid[1]))) for v in f[0]])
    apart = cKDTree(p).query(slid[0][surface])[0]
    assert (apart == 0).mean() > 0.5
    assert apart.max() < 0.11 * report.slid["envelope"]


def test_insertion_needs_finishing():
    with pytest.raises(InvalidOptionError, match="got insert=True; expected insert=False without"):
        Options(insert=True, finish=False)


@pytest.mark.parametrize(("words", "asked"), [
    ("--insert in.vtu out.vtu", True), ("in.vtu out.vtu --insert", True),
    ("in.vtu out.vtu --insert 0.05", 0.05), ("in.vtu --insert 0.05 out.vtu", 0.05)])
def test_the_flag_is_a_switch_wherever_it_stands_or_takes_the_number_after_it(
    words, asked, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    points, cells, _ = contract.grid(3, 3)
    meshio.Mesh(points, [("tetra", cells)]).write("in.vtu")
    given = []
    monkeypatch.setattr(plan, "run", lambda mesh, options, leaving: (
        given.append(options.insert) or resampled(mesh, options)))
    result = CliRunner().invoke(cli, ["optimize", *words.split()])
    assert result.exit_code == 0, result.output
    assert given == [asked]
    assert len(tetrahedra("out.vtu")[0]) == len(points) + 2


def test_command_line(tmp_path):
    target = tmp_path / "out.vtu"
    result = CliRunner().invoke(
        cli, ["optimize", str(DATA / "bone05.vtu"), str(target), "--insert", "0.05"])
    assert result.exit_code == 0, result.output
    assert "vertices added" in result.output
    points, cells = tetrahedra(target)
    old, _ = tetrahedra(DATA / "bone05.vtu")
    assert len(old) < len(points) <= 1.05 * len(old)
    assert (tm.dihedral_angles(points, cells[:, [1, 0, 2, 3]]).min(axis=1) < 20).sum() < 10


def test_report_tells_what_binds_with_new_vertices(bone):
    (points, cells), _, (out, report) = bone
    n = len(out[0])
    before, _ = simplex_mesh(points, cells)
    outside = {v for f in contract.facets(before.cells, before.regions) for v in f}
    for cell in report.binding:
        assert max(cell.vertices) < n
        on_surface = sum(any(np.array_equal(out[0][v], points[u]) for u in outside)
                         for v in cell.vertices)
        assert cell.n_movable == 4 - on_surface
    assert report.to_dict()["options"]["insert"] is True
