"""Meshes with inverted or flat cells: untangled by every host, or refused with their places."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import contract
import meshio
import numpy as np
import pytest
import reference as ref
from hypothesis import given, settings
from hypothesis import strategies as st
from tangled_meshes import schoenhardt, tangled
from tet_meshes import ball

import odt_plugins
from odt_plugins import InvalidMeshError, InvalidOptionError, TangledMeshError, UnsupportedMeshError
from odt_plugins.compare.start import read_start
from odt_plugins.compare.tangled import tangles
from odt_plugins.engine.run import plan
from odt_plugins.engine.run.outcome import unchanged
from odt_plugins.mesh.simplex import simplex_mesh
from odt_plugins.mesh.tangled import odd_cells, tangled_mesh
from odt_plugins.promise.volume import broken_promises

AIRFOIL = Path(__file__).parents[2] / "examples" / "meshes" / "airfoil.vtu"


def knotted(dim):
    """The labelled grid with one inner vertex elsewhere in its region; the first cell is valid."""
    points, cells, labels = contract.grid(dim, 4)
    vertex = np.flatnonzero(np.abs(points - [0.75, *[0.5] * (dim - 1)]).max(axis=1) < 0.07)[0]
    points[vertex] = [0.6, *[0.97] * (dim - 1)]
    volumes = contract.volumes(points, cells)
    assert volumes[0] > 0
    assert (volumes < 0).any()
    return points, cells, labels


@pytest.mark.parametrize("name", contract.HOSTS)
def test_every_host_gets_a_valid_mesh_with_its_data(name, monkeypatch, tmp_path):
    contract.need(name)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(plan, "run", lambda mesh, *_: unchanged(mesh, "as it is"))
    host = contract.HOSTS[name]
    mesh = host.make(knotted(host.dim))
    before = host.view(mesh)
    out = host.optimize(mesh, keep=())
    assert type(out) is type(mesh)
    assert contract.same_bits(host.view(mesh), before)
    after = host.view(out)
    contract.check(replace(host, fields=False), before, after)
    assert np.array_equal(before.cells, after.cells)
    assert (before.points != after.points).any()


@pytest.mark.parametrize("dim", [2, 3])
def test_optimize_untangles_and_the_report_tells(dim):
    points, cells, labels = knotted(dim)
    out, report = odt_plugins.optimize_with_report((points, cells, labels))
    inverted = int((contract.volumes(points, cells) < 0).sum())
    assert report.before.inverted == inverted
    assert report.untangled["inverted"] == inverted
    assert (report.untangled["flat"], report.untangled["left"]) == (0, 0)
    assert f"untangled {inverted} inverted and 0 flat cells" in str(report)
    assert report.to_dict()["untangled"]["inverted"] == inverted
    assert (contract.volumes(*out[:2]) > 0).all()
    assert report.after == odt_plugins.quality(out)
    assert contract.facets(out[1], out[2]) == contract.facets(cells, labels)
    plain = odt_plugins.optimize_with_report(contract.grid(dim, 4)[:2])[1]
    assert plain.untangled is None
    assert "untangled" not in str(plain)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_report_says_which_figures_are_worse_than_those_of_the_valid_cells(dim):
    points, cells, _ = knotted(dim)
    valid = contract.volumes(points, cells) > 0
    best = odt_plugins.quality((points, cells[valid]))
    _, report = odt_plugins.optimize_with_report((points, cells), smoothing={"rounds": 1},
                                                 finish=False)
    fell = report.after.mean_quality < best.mean_quality
    assert any("mean_quality fell" in text for text in report.untangled["worse"]) == fell
    low = report.after.min_quality < best.min_quality
    assert any("min_quality fell" in text for text in report.untangled["worse"]) == low


@pytest.mark.parametrize("dim", [2, 3])
def test_figures_may_be_as_bad_as_those_of_the_valid_cells(dim):
    """All cells of a lattice are alike when untangled: any change spoils the least quality."""
    points, cells, _ = tangled(dim, 5, "random")
    out, report = odt_plugins.optimize_with_report((points, cells))
    lattice = odt_plugins.quality(odt_plugins.untangle((points, cells)))
    assert report.after.mean_quality > lattice.mean_quality + (0.02 if dim == 3 else -1e-9)
    assert (contract.volumes(*out) > 0).all()
    before, _ = simplex_mesh(*contract.grid(dim, 4)[:2])
    valid = (np.asarray(points), cells[contract.volumes(points, cells) > 0])
    worse = before.points + 0.03 * ((before.points > 0) & (before.points < 1)).all(axis=1)[:, None]
    given = (worse, before.cells, before.regions, ("min_quality",))
    assert broken_promises(before, *given)
    assert not broken_promises(replace(before, valid_before=valid), *given)


def test_untangling_can_be_refused():
    points, cells, _ = knotted(2)
    with pytest.raises(TangledMeshError, match="overlapping a neighbour") as caught:
        odt_plugins.optimize((points, cells), repair="none")
    assert set(np.flatnonzero(contract.volumes(points, cells) < 0)) <= set(caught.value.cells)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_valid_mesh_comes_back_as_it_is(dim):
    mesh = contract.grid(dim, 4)
    out = odt_plugins.untangle(mesh)
    assert all(np.array_equal(a, b) for a, b in zip(out, mesh, strict=True))


def exact(points, cells):
    return (ref.exact_signs(np.asarray(points, dtype=np.float64), cells) > 0).all()


@settings(deadline=None, max_examples=25)
@given(dim=st.sampled_from([2, 3]), seed=st.integers(0, 1000),
       spread=st.sampled_from([0.3, 1.0, 30.0]), scale=st.sampled_from([1e-9, 1.0, 1e9]),
       shift=st.sampled_from([0.0, 1e3]), single=st.booleans())
def test_any_places_of_inner_vertices_are_mended(dim, seed, spread, scale, shift, single):
    """Whatever the places, units, origin and type: exact signs, and the boundary bit for bit."""
    points, cells, movable = tangled(dim, 3, "none")
    rng = np.random.default_rng(seed)
    points[movable] += spread * rng.normal(size=(movable.sum(), dim)) / 3
    points = (scale * (points + shift)).astype(np.float32 if single else np.float64)
    flipped = rng.permutation(len(cells))[: int(rng.integers(0, len(cells)))]
    cells[flipped] = contract.negative(cells[flipped])
    if single and shift:
        return
    out, rows = odt_plugins.untangle((points, cells))
    assert exact(out, rows) or exact(out, contract.negative(rows))
    assert out.dtype == points.dtype
    assert out[~movable].tobytes() == points[~movable].tobytes()
    assert np.array_equal(np.sort(rows, axis=1), np.sort(cells, axis=1))


def test_fixed_vertices_selections_and_regions_stay():
    points, cells, labels = knotted(3)
    inner = ((points > 0) & (points < 1)).all(axis=1)
    bad = np.flatnonzero(contract.volumes(points, cells) < 0)
    moving = np.unique(cells[bad])[inner[np.unique(cells[bad])]]
    fixed = np.setdiff1d(np.flatnonzero(inner), moving)
    out, _ = odt_plugins.untangle((points, cells), fixed=fixed)
    assert np.array_equal(out[fixed], points[fixed])
    near = np.isin(cells, np.unique(cells[bad])).any(axis=1)
    out, rows = odt_plugins.untangle((points, cells), selection=near)
    assert np.array_equal(out[cells[~near]], points[cells[~near]])
    assert (contract.volumes(out, rows) > 0).all()
    out, rows, _ = odt_plugins.untangle((points, cells, labels))
    assert (out[points[:, 0] == 0.5] == points[points[:, 0] == 0.5]).all()
    with pytest.raises(TangledMeshError, match="which must stay as they are") as caught:
        odt_plugins.untangle((points, cells), selection=np.arange(5))
    assert set(caught.value.cells) == set(bad.tolist())


def hopeless():
    """A grid in the plane with two corners of its boundary exchanged, and places to look at."""
    points, cells, _ = contract.grid(2, 4)
    corner = [int(np.flatnonzero((points == x).all(axis=1))[0]) for x in ([0, 0], [1, 1])]
    points[corner] = points[corner[::-1]]
    return points, cells


def test_what_the_boundary_makes_impossible_is_told_with_its_places():
    points, cells = hopeless()
    with pytest.raises(TangledMeshError, match="expected a boundary") as caught:
        odt_plugins.optimize((points, cells))
    said = str(caught.value)
    first = caught.value.cells[0]
    assert f"first: cell {first} with vertices {cells[first].tolist()}" in said
    assert "partial=True" in said
    contract.need("open3d")
    mesh = contract.HOSTS["open3d-triangle"].make((points, cells, np.zeros(len(cells), int)))
    with pytest.raises(TangledMeshError, match="first: triangle") as again:
        odt_plugins.optimize(mesh)
    assert again.value.cells == caught.value.cells


@pytest.mark.parametrize(("dim", "to", "crossed"), [
    (2, [0.5, -0.3], [[0.5, 0.0]]), (3, [0.5, 0.53, -0.3], [[0.5, 0.5, 0.0]]),
    (2, [0.9, 1.0], [[0.75, 1.0]]), (3, [0.9, 0.53, 1.0], [[0.75, 0.5, 1.0], [0.75, 0.75, 1.0]]),
])
def test_facets_of_the_boundary_that_cross_or_overlap_are_named(dim, to, crossed):
    """A vertex of the boundary pushed through the other side, or over its neighbours."""
    points, cells, _ = contract.grid(dim, 4)
    top = [*[0.5] * (dim - 1), 1.0]
    moved = int(np.flatnonzero((points == top).all(axis=1))[0])
    near = {int(np.flatnonzero((points == x).all(axis=1))[0]) for x in crossed}
    points[moved] = to
    with pytest.raises(TangledMeshError, match="cross or overlap others") as caught:
        odt_plugins.untangle((points, cells))
    pairs = caught.value.facets
    named = {facet for pair in pairs for facet in pair}
    assert named <= contract.facets(cells, np.zeros(len(cells), int))
    assert all(any(moved in facet for facet in pair) for pair in pairs)
    assert near <= {vertex for facet in named for vertex in facet}
    said = str(caught.value)
    one, other = pairs[0]
    assert f"{len(pairs)} facets" in said
    assert f"first: that of vertices {list(one)}, with that of {list(other)}, at (" in said


def test_nothing_is_said_of_facets_where_none_overlap():
    points, cells, _ = contract.grid(3, 2)
    inner = np.flatnonzero(((points > 0) & (points < 1)).all(axis=1))
    points[inner] = 1.5
    with pytest.raises(TangledMeshError, match="nor flips were found; expected") as caught:
        odt_plugins.untangle((points, cells), fixed=inner)
    assert caught.value.facets == ()


def test_regions_are_advised_where_an_interface_makes_it_impossible():
    points, cells, _ = tangled(3, 5, "bent")
    some = np.arange(len(cells)) < 5
    with pytest.raises(TangledMeshError, match=r"try insert=True, regions=None, moving what"):
        odt_plugins.untangle((points, cells), regions=some.astype(int))
    odt_plugins.untangle((points, cells), regions=None)


def test_sets_that_hold_what_stays_tangled_are_named_and_no_regions_where_there_are_none():
    points, cells, labels = contract.grid(3, 4)
    walls = np.array(sorted(contract.facets(cells, labels)))
    rim = np.unique(walls[(points[walls] != 0.5).any(axis=(1, 2))])
    inner = np.setdiff1d(np.arange(len(points)), walls)
    points[inner, 1] = 1.0 - points[inner, 1]
    mesh = meshio.Mesh(points, [("tetra", cells), ("triangle", walls)],
                       point_sets={"inner": inner, "rim": rim})
    with pytest.raises(TangledMeshError) as caught:
        odt_plugins.untangle(mesh)
    said = str(caught.value)
    assert f"found, and {len(inner)} vertices of point set 'inner' stay where they are; " in said
    assert "set 'rim'" not in said
    assert "regions=None" not in said


def test_on_request_the_best_mesh_comes_back():
    points, cells = hopeless()
    out, rows = odt_plugins.untangle((points, cells), partial=True)
    was, now = (odt_plugins.quality(mesh).inverted for mesh in ((points, cells), (out, rows)))
    assert 0 < now < was
    boundary = ((points == 0) | (points == 1)).any(axis=1)
    assert np.array_equal(out[boundary], points[boundary])
    one = np.zeros(len(cells), int)
    assert contract.facets(rows, one) == contract.facets(cells, one)


def test_the_result_is_as_good_as_that_of_the_mesh_without_the_tangle():
    """The airfoil with its boundary bent and the inner vertices left behind."""
    start = read_start(AIRFOIL)
    points, whole = next((p, w) for how, p, w in tangles(start) if how == "bent")
    found = odt_plugins.optimize_with_report((points, start.cells))[1].after
    best = odt_plugins.optimize_with_report((whole, start.cells))[1].after
    assert found.mean_quality > best.mean_quality - 0.005
    assert found.p1_quality > best.p1_quality - 0.02


@pytest.mark.parametrize("partitioned", [False, True])
def test_the_sizes_of_cells_that_stayed_are_kept(partitioned):
    """Cells around one inverted vertex of a mesh whose cells are finer on one side."""
    points, cells, _ = contract.grid(2, 72 if partitioned else 12)
    points[:, 0] **= 2
    vertex = int(np.flatnonzero(np.abs(points - [0.33, 0.5]).max(axis=1) < 0.06)[0])
    points[vertex] = [0.9, 0.9]
    out = odt_plugins.optimize((points, cells), keep=(), blocks=2 if partitioned else None)
    areas = contract.volumes(*out)
    middle = out[0][out[1]].mean(axis=1)[:, 0]
    assert (areas > 0).all()
    assert areas[middle < 0.1].mean() < 0.4 * areas[middle > 0.7].mean()


@pytest.mark.parametrize("dim", [2, 3])
def test_a_rest_mesh_gives_the_shapes(dim):
    rest, cells, _ = contract.grid(dim, 4)
    points = rest.copy()
    inner = ((points > 0) & (points < 1)).all(axis=1)
    points[inner] = 0.5
    points[:, 0] *= 1.2
    by_rest, _ = odt_plugins.untangle((points, cells), rest=(rest, cells))
    same, _ = odt_plugins.untangle((points, cells), rest=rest)
    assert np.array_equal(by_rest, same)
    same, _ = odt_plugins.untangle((points, cells), rest=rest.tolist())
    assert np.array_equal(by_rest, same)
    with pytest.raises(InvalidMeshError, match=r"1 point \(first: point 0\) with NaN .* rest mesh"):
        odt_plugins.untangle((points, cells), rest=np.vstack([rest[:1] * np.nan, rest[1:]]))
    plain, _ = odt_plugins.untangle((points, cells))
    wanted = rest * [1.2, *[1.0] * (dim - 1)]
    assert np.abs(by_rest - wanted).max() < 0.3 * np.abs(plain - wanted).max()
    with pytest.raises(InvalidMeshError, match=r"rest mesh with points of shape"):
        odt_plugins.untangle((points, cells), rest=rest[:-1])
    with pytest.raises(InvalidMeshError, match=r"flat in the rest mesh"):
        odt_plugins.untangle((points, cells), rest=points)


def test_curved_surfaces_and_wrong_options_are_refused():
    points, cells, _ = contract.bowl(4)
    with pytest.raises(UnsupportedMeshError, match="curved surface"):
        odt_plugins.untangle((points, cells))
    with pytest.raises(InvalidOptionError, match="repair='always'"):
        odt_plugins.optimize((points, cells), repair="always")


def test_cells_that_cannot_agree_are_refused_as_before():
    """A band of triangles with a half turn, flattened; and cells that are there twice."""
    points = np.array([[0.0, 0], [1, 0], [2, 0.1], [0.2, 1], [1.1, 1.2]])
    band = np.array([[0, 1, 2], [1, 2, 3], [2, 3, 4], [3, 4, 0], [4, 0, 1]])
    assert odd_cells(points, band.astype(np.int32)) is None
    with pytest.raises(TangledMeshError, match="overlapping a neighbour"):
        odt_plugins.optimize((points, band))
    points, cells, _ = knotted(2)
    with pytest.raises(InvalidMeshError, match="same vertices as an earlier cell"):
        odt_plugins.optimize((points, np.concatenate([cells, cells[5:6]])))


@pytest.mark.parametrize("dim", [2, 3])
def test_cells_of_any_orientation_agree_with_positive_volume(dim):
    points, cells, _ = knotted(dim)
    rng = np.random.default_rng(3)
    flipped = rng.random(len(cells)) < 0.5
    mixed = np.where(flipped[:, None], contract.negative(cells), cells).astype(np.int32)
    found, orientation = tangled_mesh(points, mixed)
    assert (orientation, found.turned) == (1, flipped.sum())
    assert np.array_equal(contract.volumes(points, found.cells) < 0,
                          contract.volumes(points, cells) < 0)
    found, orientation = tangled_mesh(points, contract.negative(cells))
    assert (orientation, found.turned) == (-1, 0)


def test_the_promise_knows_the_exact_sign_of_a_thin_cell():
    """Rounded the volume is positive; exactly it is not."""
    points = np.array([[0.1, 0.1], [0.3, 0.3], [0.7, 0.7], [0.0, 1.0]])
    rng = np.random.default_rng(0)
    for _ in range(10_000):
        points[:3] = (rng.random(3)[:, None] + 1e-17) * [1.0, 1.0 + rng.random()]
        a, b, c = ([Fraction(x) for x in p] for p in points[:3].tolist())
        true = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if true <= 0 < odt_plugins.figures.volumes(points, np.array([[0, 1, 2]]))[0]:
            break
    else:
        pytest.fail("no such cell was found")
    valid = points.copy()
    valid[2, 0] -= 0.1
    before, _ = simplex_mesh(valid, np.array([[0, 1, 2]]))
    cells = np.array([[0, 1, 2]], dtype=np.int32)
    assert any("not positive" in said
               for said in broken_promises(before, points, cells, before.regions, ()))


def test_cells_stay_without_connectivity():
    dart = np.array([[0.0, 0.0], [1.0, 0.4], [2.0, 0.0], [1.0, 2.0]]), [[0, 1, 2], [0, 2, 3]]
    assert len(odt_plugins.optimize(dart)[1]) == 2
    said = r"no other places .* smoothing={'connectivity': 'none'}.*auto"
    with pytest.raises(TangledMeshError, match=said):
        odt_plugins.optimize(dart, smoothing={"connectivity": "none"})
    points, cells = knotted(3)[:2]
    out, rows = odt_plugins.optimize((points, cells), smoothing={"connectivity": "none"})
    assert (out != points).any()
    assert {frozenset(row) for row in rows.tolist()} == {frozenset(row) for row in cells.tolist()}
    with pytest.raises(odt_plugins.InvalidOptionError, match=r"smoothing={'connectivity': 'none'}"):
        odt_plugins.optimize((points, cells), smoothing={"connectivity": "none"}, insert=True)


@pytest.mark.parametrize("more", [False, True])
@pytest.mark.parametrize("work", ["untangle", "optimize"])
def test_inserted_vertices_have_the_data_around_them(work, more):
    """More: beside a mesh into which the engine inserts some as well."""
    pv = pytest.importorskip("pyvista")
    points, cells = schoenhardt()
    if more:
        other, rows = ball(60, 1)
        points = np.concatenate([points, other + np.array([4.0, 0.0, 0.0])])
        cells = np.concatenate([cells, rows + 6])
    n, field = len(points), points @ [1.0, 2.0, 3.0]
    grid = pv.UnstructuredGrid({pv.CellType.TETRA: cells}, points)
    grid.point_data["temperature"], grid.point_data["number"] = field, np.arange(n)
    grid.cell_data["material"] = np.full(len(cells), 7)
    grid.cell_data["size"] = np.arange(len(cells))
    with pytest.raises(TangledMeshError, match="try insert=True, moving"):
        odt_plugins.optimize(grid)
    function = getattr(odt_plugins, f"{work}_with_report")
    out, report = function(grid, insert=0.2)
    assert report.untangled["added"] == 1
    assert "0 vertices moved, 1 added, 0 flips; 0 left" in str(report)
    assert report.counts["vertices added"] >= 1 + (more and work == "optimize")
    removed = report.counts["vertices removed"]
    assert len(out.points) == n + report.counts["vertices added"] - removed
    rows = out.cells_dict[pv.CellType.TETRA]
    assert (contract.volumes(out.points, rows) > 0).all()
    assert np.array_equal(out.points[:6], points[:6])
    assert out.points[: n - removed + 1][-1, 0] < 1.0
    assert np.allclose(out.point_data["temperature"], out.points @ [1.0, 2.0, 3.0], atol=1e-12)
    kept = np.setdiff1d(np.arange(n), out.point_data["number"][: n - removed])
    assert len(kept) == removed
    assert (out.cell_data["material"] == 7).all()
    assert np.array_equal(out.cell_data["size"], report.cell_origin)
    assert len(report.cell_origin) == len(rows)
    assert report.before.inverted == 1
    assert len(report.to_dict()["binding"]) > 0


def test_vertices_of_untangling_count_among_those_that_may_come():
    points, cells = schoenhardt()
    for more in (0, 4):
        with pytest.raises(TangledMeshError, match="nor flips nor vertices more"):
            odt_plugins.untangle((np.concatenate([points, points[:more]]), cells), insert=0.1)
    three = np.concatenate([points + 4.0 * i * np.eye(3)[0] for i in range(3)])
    rows = np.concatenate([cells + 6 * i for i in range(3)])
    for more, insert, most in ((0, 0.17, 3), (0, 0.23, 4), (0, 0.5, 9), (6, 0.17, 3)):
        out, _ = odt_plugins.optimize(
            (np.concatenate([three, three[:more]]), rows), insert=insert, keep=())
        assert 21 <= len(out) - more <= 18 + most


def test_densities_of_vertices_reach_inserted_ones():
    points, cells = schoenhardt()
    for density in (np.arange(1.0, 7.0), np.ones(4), "keep"):
        out = odt_plugins.optimize((points, cells), insert=True, density=density)
        assert odt_plugins.quality(out).inverted == 0


def test_vertices_are_inserted_into_tetrahedra_alone():
    points, cells, _ = knotted(2)
    with pytest.raises(InvalidOptionError, match="insert=True for a mesh of triangles"):
        odt_plugins.untangle((points, cells), insert=True)


@pytest.mark.parametrize("dim", [2, 3])
def test_untangling_reports_and_tells_how_far_it_is(dim):
    points, cells, _ = tangled(dim, 6, "bent")
    told = []
    out, report = odt_plugins.untangle_with_report(
        (points, cells), progress=lambda stage, share: told.append((stage, share)))
    same = odt_plugins.untangle((points, cells))
    assert all(np.array_equal(a, b) for a, b in zip(same, out, strict=True))
    shares = [share for _, share in told]
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert shares == sorted(shares)
    assert len({share for stage, share in told if stage == "untangling" and share < 1.0}) > 1
    assert report.before == odt_plugins.quality((points, cells))
    assert report.after == odt_plugins.quality(out)
    assert report.untangled["inverted"] == report.before.inverted > 0
    assert report.stop_reason == "untangled"
    told.clear()
    odt_plugins.optimize((points, cells), progress=lambda stage, share: told.append((stage, share)))
    shares = [share for _, share in told]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert any(stage == "untangling" and 0.0 < share <= 0.3 for stage, share in told)
    assert any(stage != "untangling" and 0.3 < share < 1.0 for stage, share in told)
    assert odt_plugins.untangle_with_report(contract.grid(dim, 2)[:2])[1].untangled is None


def test_no_option_is_advised_where_untangling_would_do_no_more_with_it():
    points, cells, _ = tangled(3, 6, "bent")
    for mesh in ((points, cells), contract.grid(3, 3)[:2]):
        binding = odt_plugins.untangle_with_report(mesh)[1].binding
        assert {cell.hint for cell in binding} == {""}
    assert any(cell.hint for cell in odt_plugins.optimize_with_report(mesh)[1].binding)


def test_options_without_effect_on_untangling_are_refused():
    mesh = contract.grid(2, 2)[:2]
    for function in (odt_plugins.untangle, odt_plugins.untangle_with_report):
        with pytest.raises(InvalidOptionError,
                           match="got smoothing= for untangling; expected some"):
            function(mesh, smoothing={"cycles": 2})
        for name in ("solver", "layers"):
            with pytest.raises(InvalidOptionError, match=f"got {name}= for untangling"):
                function(mesh, **{name: "keep"})
        with pytest.raises(InvalidOptionError, match="did you mean 'threads'"):
            function(mesh, thread=2)
        with pytest.raises(InvalidOptionError, match=r"\['boundry'\]; .*'progress'\]$"):
            function(mesh, boundry="slide")


def test_blocks_of_a_pyvista_mesh_are_untangled_one_by_one():
    pv = pytest.importorskip("pyvista")
    points, cells, _ = knotted(3)
    grid = pv.UnstructuredGrid({pv.CellType.TETRA: cells}, points)
    blocks = pv.MultiBlock({"a": grid, "b": grid})
    out, report = odt_plugins.untangle_with_report(blocks)
    assert [r.untangled["left"] for r in report.parts] == [0, 0]
    same = odt_plugins.untangle(blocks)
    assert np.array_equal(same["b"].points, out["b"].points)
