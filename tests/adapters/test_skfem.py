"""Meshes of scikit-fem: those of second order, boundaries, and what is refused."""

from __future__ import annotations

import dataclasses
import functools

import contract
import numpy as np
import pytest
from scipy.spatial import Delaunay

import odt_plugins
from odt_plugins.errors import InvalidMeshError, InvalidOptionError, UnsupportedMeshError

skfem = pytest.importorskip("skfem")
poisson = pytest.importorskip("skfem.models.poisson")


def start(dim, order=1):
    """A mesh whose inner vertices are off their places, with all that can be on it."""
    plain = skfem.MeshTri.init_sqsymmetric() if dim == 2 else skfem.MeshTet.init_ball(1)
    mesh = plain.refined(2 if dim == 2 else 1)
    inner = mesh.interior_nodes()
    x = mesh.doflocs.copy()
    step = np.random.default_rng(3).uniform(-1, 1, (dim, len(inner)))
    x[:, inner] += (0.12 if dim == 2 else 0.05) * mesh.param() * step
    mesh = type(mesh)(x, mesh.t)
    if order == 2:
        kind = skfem.MeshTri2 if dim == 2 else skfem.MeshTet2
        mesh = kind.from_mesh(mesh)
        moved = mesh.doflocs.copy()
        edge = np.setdiff1d(mesh.dofs.get_facet_dofs(mesh.boundary_facets()).flatten(),
                            np.arange(mesh.nvertices))
        moved[:, edge] *= 1.01
        mesh = kind(moved, mesh.t)
    return mesh.with_subdomains({"left": lambda y: y[0] < y[0].mean()}).with_boundaries(
        {"top": lambda y: y[dim - 1] > 0.7})


def energy(mesh):
    """Of a function on the boundary, continued harmonically; its value tells of the boundary."""
    element = {2: skfem.ElementTriP1(), 3: skfem.ElementTetP1()}[mesh.dim()]
    if mesh.doflocs.shape[1] > mesh.nvertices:
        element = {2: skfem.ElementTriP2(), 3: skfem.ElementTetP2()}[mesh.dim()]
    basis = skfem.Basis(mesh, element)
    stiffness = poisson.laplace.assemble(basis)
    u = np.zeros(basis.N)
    top = basis.get_dofs("top")
    u[top] = basis.doflocs[0, top]
    u = skfem.solve(*skfem.condense(stiffness, x=u, D=basis.get_dofs()))
    return u @ stiffness @ u, (poisson.unit_load.assemble(basis)).sum()


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("dim", [2, 3])
def test_problems_can_be_solved_on_the_result(dim, order):
    mesh = start(dim, order)
    before = (mesh.doflocs.copy(), mesh.t.copy())
    out, report = odt_plugins.optimize_with_report(mesh)
    assert type(out) is type(mesh)
    assert np.array_equal(mesh.doflocs, before[0])
    assert np.array_equal(mesh.t, before[1])
    assert report.after.mean_quality > report.before.mean_quality
    # scikit-fem takes nodes of edges for vertices that are in no element.
    if order == 1:
        assert out.is_valid(raise_=True)
    same = out.doflocs.shape == mesh.doflocs.shape
    assert same == (order == 1 or dim == 2)
    assert len(out.boundaries["top"]) == len(mesh.boundaries["top"])
    old, new = energy(mesh), energy(out)
    assert new[1] == pytest.approx(old[1], rel=1e-12)
    assert new[0] == pytest.approx(old[0], rel=0.2)
    inside = np.zeros(out.nelements, dtype=bool)
    inside[out.subdomains["left"]] = True

    def volume(mesh, cells):
        return poisson.unit_load.assemble(skfem.CellBasis(
            mesh, mesh.elem(), elements=cells)).sum()

    assert volume(out, out.subdomains["left"]) == pytest.approx(
        volume(mesh, mesh.subdomains["left"]), rel=1e-12)


def test_nodes_of_edges_stay_on_the_curved_boundary():
    mesh = start(3, 2)
    out = odt_plugins.optimize(mesh)

    def boundary(mesh):
        basis = skfem.Basis(mesh, skfem.ElementTetP2())
        places = basis.doflocs[:, basis.get_dofs().flatten()]
        return places[:, np.lexsort(places)]

    assert np.array_equal(boundary(out), boundary(mesh))


def test_regions_are_named_by_subdomains():
    mesh = start(2)
    _, report = odt_plugins.optimize_with_report(mesh)
    assert report.regions_from == ("left",)
    _, report = odt_plugins.optimize_with_report(mesh, regions=None)
    assert report.regions_from == ()
    with pytest.raises(InvalidOptionError, match="right"):
        odt_plugins.optimize(mesh, regions="right")
    plain = skfem.MeshTri().refined(1)
    assert odt_plugins.optimize(plain).boundaries is None
    assert odt_plugins.optimize(plain).subdomains is None


def test_a_class_of_the_users_comes_back():
    class Mine(skfem.MeshTri1):
        pass

    plain = start(2)
    assert type(odt_plugins.optimize(Mine(plain.doflocs, plain.t))) is Mine


def test_other_meshes_of_skfem_are_refused():
    mesh = skfem.MeshTri1DG.from_mesh(skfem.MeshTri().refined(1))
    call = "MeshTri(mesh.p, mesh.dofs.element_dofs).remove_duplicate_nodes()"
    with pytest.raises(UnsupportedMeshError, match="got a MeshTri1DG") as caught:
        odt_plugins.optimize(mesh)
    assert str(caught.value).endswith(f"MeshTet2, try {call}")
    joined = eval(call, {"MeshTri": skfem.MeshTri, "mesh": mesh})
    assert odt_plugins.optimize(joined).p.shape == (2, 9)
    with pytest.raises(UnsupportedMeshError, match=r"MeshLine1; .* or MeshTet2$"):
        odt_plugins.optimize(skfem.MeshLine())
    with pytest.raises(UnsupportedMeshError, match=r"MeshQuad1; .*to_meshtri\(\)"):
        odt_plugins.optimize(skfem.MeshQuad())
    assert odt_plugins.optimize(skfem.MeshQuad().to_meshtri()).nelements == 2
    points, cells, _ = contract.grid(2, 2)
    apart = skfem.MeshTri(points[cells.ravel()].T, np.arange(cells.size).reshape(-1, 3).T)
    with pytest.warns(odt_plugins.ODTWarning, match=r"mesh\.remove_duplicate_nodes\(\)"):
        odt_plugins.optimize(apart)
    assert hasattr(apart, "remove_duplicate_nodes")
    broken = skfem.MeshTri(points.T, np.zeros((3, 2), dtype=int))
    with pytest.raises(InvalidMeshError, match="element"):
        odt_plugins.optimize(broken)


@pytest.mark.parametrize("kind", [skfem.MeshTri, skfem.MeshTet])
def test_oriented_boundaries_stay_oriented(kind):
    """The flux of x out of a part is that of before, as scikit-fem integrates it."""
    mesh = kind().refined(3)
    inner = (np.abs(mesh.p - 0.5) < 0.49).all(axis=0)
    rng = np.random.default_rng(4)
    places = mesh.p + np.where(inner, rng.uniform(-0.03, 0.03, mesh.p.shape), 0.0)
    left = np.flatnonzero(mesh.p[0][mesh.t].mean(axis=0) < 0.5)
    mesh = kind(places, mesh.t)
    mesh = mesh.with_boundaries({"rim": mesh.facets_around(np.arange(mesh.nelements)),
                                 "left": mesh.facets_around(left)})
    better = odt_plugins.optimize(mesh)
    assert not np.array_equal(better.p, mesh.p)
    element = skfem.ElementTriP1() if kind is skfem.MeshTri else skfem.ElementTetP1()
    for name in ("rim", "left"):
        fluxes = []
        for one in (mesh, better):
            basis = skfem.FacetBasis(one, element, facets=one.boundaries[name])
            form = skfem.Functional(lambda w: sum(w.x[i] * w.n[i] for i in range(len(w.x))))
            fluxes.append(form.assemble(basis))
        assert fluxes[1] == pytest.approx(fluxes[0], rel=1e-9)
        assert abs(fluxes[0]) > 0.1


@pytest.mark.parametrize(("n", "size"), [(4, 0.12), (5, 0.15)])
def test_resized_boundaries_point_out_of_their_subdomain(n, size):
    """Also beside edges of the surface, and where the interface is as rough as the mesh."""
    points, cells, labels = contract.grid(3, n)
    mesh = skfem.MeshTet(points.T.copy(), cells.T.copy())
    mesh = mesh.with_subdomains({"part": np.flatnonzero(labels == 7)})
    mesh = mesh.with_boundaries({"around": mesh.facets_around("part")})
    out = odt_plugins.remesh(mesh, size)
    found, wanted = out.boundaries["around"], out.facets_around("part")
    assert len(found) > len(mesh.boundaries["around"])
    assert (dict(zip(found.tolist(), found.ori.tolist(), strict=True))
            == dict(zip(wanted.tolist(), wanted.ori.tolist(), strict=True)))


@pytest.mark.parametrize("seed", [5, 22, 37])
def test_resized_boundaries_point_out_of_a_subdomain_that_another_one_parts(seed):
    rng = np.random.default_rng(seed)
    points = rng.random((80, 2))
    points = np.concatenate([points, [[0, 0], [1, 0], [0, 1], [1, 1]]])
    mesh = skfem.MeshTri(points.T.copy(), Delaunay(points).simplices.T.astype(np.int64))
    inside = np.flatnonzero(points[mesh.t].mean(axis=0)[:, 0] < 0.5)
    mesh = mesh.with_subdomains({"part": inside, "some": inside[::2]})
    mesh = mesh.with_boundaries({"around": mesh.facets_around("part")})
    out = odt_plugins.remesh(mesh, scale=1.4)
    found, wanted = out.boundaries["around"], out.facets_around("part")
    assert (dict(zip(found.tolist(), found.ori.tolist(), strict=True))
            == dict(zip(wanted.tolist(), wanted.ori.tolist(), strict=True)))


@pytest.mark.parametrize("change", [
    odt_plugins.optimize, lambda mesh: odt_plugins.remesh(mesh, scale=0.8)])
@pytest.mark.parametrize("kind", [skfem.MeshTri, skfem.MeshTet])
@pytest.mark.parametrize("high", [False, True])
def test_boundaries_that_point_into_their_subdomain_still_do(kind, high, change):
    mesh = kind().refined(3)
    mesh = mesh.with_subdomains({"part": lambda x: (x[0] < 0.5) ^ high})
    mesh = mesh.with_boundaries({"around": mesh.facets_around("part", flip=True)})
    out = change(mesh)
    found, wanted = out.boundaries["around"], out.facets_around("part", flip=True)
    assert (dict(zip(found.tolist(), found.ori.tolist(), strict=True))
            == dict(zip(wanted.tolist(), wanted.ori.tolist(), strict=True)))


@pytest.mark.parametrize("resize", [False, True])
def test_subdomains_and_boundaries_may_be_masks_and_lists(resize):
    points, cells, _ = contract.grid(3, 4)
    mesh = skfem.MeshTet(np.ascontiguousarray(points.T), np.ascontiguousarray(cells.T))
    middle, outer = points[mesh.t.T].mean(axis=1), mesh.facets_satisfying(
        lambda x: np.isclose(x[0], points[:, 0].min()))
    left = middle[:, 0] < np.median(middle[:, 0])
    side = np.isin(np.arange(mesh.facets.shape[1]), outer)
    index = dataclasses.replace(mesh, _subdomains={"left": np.flatnonzero(left)},
                                _boundaries={"side": outer})
    masked = dataclasses.replace(mesh, _subdomains={"left": left}, _boundaries={"side": side})
    listed = dataclasses.replace(mesh, _subdomains={"left": np.flatnonzero(left).tolist()},
                                 _boundaries={"side": outer.tolist()})
    out, by_mask, by_list = (
        odt_plugins.remesh(one, scale=0.9) if resize else odt_plugins.optimize(one)
        for one in (index, masked, listed))
    assert out.t.shape != mesh.t.shape
    assert by_mask.subdomains["left"].dtype == by_mask.boundaries["side"].dtype == np.bool_
    assert by_mask.subdomains["left"].shape == (by_mask.t.shape[1],)
    assert by_mask.boundaries["side"].shape == (by_mask.facets.shape[1],)
    for name, members in (("subdomains", "left"), ("boundaries", "side")):
        known = np.sort(getattr(out, name)[members])
        assert np.array_equal(np.flatnonzero(getattr(by_mask, name)[members]), known)
        assert np.array_equal(np.sort(getattr(by_list, name)[members]), known)


@pytest.mark.parametrize("members", [
    np.array([99999]), np.ones(3, dtype=bool), np.array([0.5]), [[1], [2, 3]]])
@pytest.mark.parametrize("what", ["subdomain", "boundary"])
def test_members_out_of_range_are_refused_by_the_name_of_their_set(what, members):
    points, cells, _ = contract.grid(3, 3)
    where = {"subdomain": "_subdomains", "boundary": "_boundaries"}[what]
    mesh = dataclasses.replace(
        skfem.MeshTet(np.ascontiguousarray(points.T), np.ascontiguousarray(cells.T)),
        **{where: {"part": members}})
    with pytest.raises(InvalidMeshError, match=rf"^{what} 'part' has .*; expected indices"):
        odt_plugins.optimize(mesh)


@functools.cache
def changed(resize, kind):
    """The mesh and its result, where sets are arrays of their usual type or of another kind."""
    points, cells, _ = contract.grid(3, 5)
    mesh = skfem.MeshTet(np.ascontiguousarray(points.T), np.ascontiguousarray(cells.T))
    members, outer = np.arange(100), mesh.boundary_facets()

    def some(row):
        return (row,) if kind is tuple else row.astype(kind)

    given = dataclasses.replace(
        mesh, _subdomains={"part": some(members)}, _boundaries={"side": some(outer[outer < 127])})
    return mesh, odt_plugins.remesh(given, scale=0.6) if resize else odt_plugins.optimize(given)


@pytest.mark.parametrize("resize", [False, True])
@pytest.mark.parametrize("kind", [np.uint8, np.int8, tuple])
def test_indices_of_few_bits_and_of_nonzero_name_what_others_do(kind, resize):
    mesh, out = changed(resize, np.int64)
    _, alike = changed(resize, kind)
    assert mesh.t.shape[1] > 256
    assert out.t.shape != mesh.t.shape
    for one, other in ((out.subdomains["part"], alike.subdomains["part"]),
                       (out.boundaries["side"], alike.boundaries["side"])):
        assert one.max() > np.iinfo(np.int8).max or not resize
        assert np.array_equal(one, other)
