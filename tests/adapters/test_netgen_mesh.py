"""Meshes of Netgen and NGSolve: CAD parts, curved elements, problems solved on the result."""

from __future__ import annotations

import numpy as np
import pytest

import odt_plugins
from odt_plugins.errors import (
    DataNotKeptWarning,
    InvalidMeshError,
    InvalidOptionError,
    UnsupportedMeshError,
)

pytest.importorskip("netgen")
ngsolve = pytest.importorskip("ngsolve")


def part(size=0.5, **options):
    """A pin of iron in a block of air, by Netgen, without its own optimisation."""
    from netgen.occ import Box, Cylinder, Glue, OCCGeometry, Z

    pin = Cylinder((0, 0, 0), Z, r=0.5, h=1)
    pin.faces.name = "mantle"
    pin.mat("iron")
    block = Box((-1, -1, 0), (1, 1, 1)) - pin
    block.mat("air")
    block.faces.Max(Z).name = "top"
    return OCCGeometry(Glue([block, pin])).GenerateMesh(maxh=size, optsteps3d=0, **options)


def figures(mesh):
    """Volumes of the domains and areas of the boundaries by NGSolve.

    Where curved elements fold, as some of Netgen's that were not optimised do, it counts their
    volumes twice.
    """
    one = ngsolve.CF(1)
    return [[*ngsolve.Integrate(one, mesh, order=9, region_wise=True)],
            [*ngsolve.Integrate(one, mesh, ngsolve.BND, order=9, region_wise=True)]]


@pytest.mark.parametrize("order", [1, 3])
def test_domains_boundaries_and_curved_elements_come_back(order):
    mesh = ngsolve.Mesh(part())
    if order > 1:
        mesh.Curve(order)
    before = figures(mesh)
    places = np.array(mesh.ngmesh.Coordinates())
    out, report = odt_plugins.optimize_with_report(mesh)
    assert type(out) is ngsolve.Mesh
    assert report.regions_from == ("material",)
    assert report.after.mean_quality > report.before.mean_quality
    assert out.GetCurveOrder() == mesh.GetCurveOrder() == order
    assert out.GetMaterials() == mesh.GetMaterials() == ("air", "iron")
    assert out.GetBoundaries() == mesh.GetBoundaries()
    assert {"mantle", "top"} <= set(out.GetBoundaries())
    assert out.GetBBoundaries() == mesh.GetBBoundaries()
    for old, new in zip(before, figures(out), strict=True):
        assert new == pytest.approx(old, rel=1e-9 if order == 1 or len(old) > 2 else 1e-3)
    assert np.array_equal(np.array(mesh.ngmesh.Coordinates()), places)
    assert figures(mesh) == before
    assert odt_plugins.quality(out) == report.after
    space = ngsolve.H1(out, order=2, dirichlet="top")
    u, v = space.TnT()
    form = ngsolve.BilinearForm(ngsolve.grad(u) * ngsolve.grad(v) * ngsolve.dx).Assemble()
    load = ngsolve.LinearForm(v * ngsolve.dx("iron")).Assemble()
    solution = ngsolve.GridFunction(space)
    solution.vec.data = form.mat.Inverse(space.FreeDofs()) * load.vec
    assert ngsolve.Integrate(solution, out) > 0


def test_vertices_are_inserted_into_a_curved_mesh():
    mesh = part()
    mesh.Curve(2)
    out, report = odt_plugins.optimize_with_report(mesh, insert=True)
    added, removed = (report.counts[f"vertices {what}"] for what in ("added", "removed"))
    assert added
    assert len(out.Points()) == len(mesh.Points()) + added - removed
    assert out.GetCurveOrder() == 2
    assert odt_plugins.quality(out) == report.after
    (volumes, areas), new = figures(ngsolve.Mesh(mesh)), figures(ngsolve.Mesh(out))
    assert new[0] == pytest.approx(volumes, rel=1e-3)
    assert new[1] == pytest.approx(areas, rel=1e-9)


def off_the_ball(mesh):
    """How far the vertices of the surface are from the unit sphere."""
    x = np.array(mesh.Coordinates())
    faces = mesh.Elements2D().NumPy()["nodes"] - 1
    return np.abs(np.linalg.norm(x[np.unique(faces)], axis=1) - 1).max()


@pytest.mark.parametrize("kind", ["occ", "csg"])
def test_points_of_a_face_slide_on_the_geometry(kind):
    if kind == "occ":
        from netgen.occ import OCCGeometry, Pnt, Sphere

        geometry = OCCGeometry(Sphere(Pnt(0, 0, 0), 1))
    else:
        from netgen.csg import CSGeometry, Pnt, Sphere

        geometry = CSGeometry()
        geometry.Add(Sphere(Pnt(0, 0, 0), 1))
    mesh = geometry.GenerateMesh(maxh=0.3, optsteps2d=0, optsteps3d=0)
    mesh.Curve(3)
    old = np.array(mesh.Coordinates())
    assert off_the_ball(mesh) < 1e-6
    out, report = odt_plugins.optimize_with_report(mesh, boundary="slide")
    new = np.array(out.Coordinates())
    skin = np.unique(mesh.Elements2D().NumPy()["nodes"]) - 1
    assert (old[skin] != new[skin]).any(axis=1).sum() > 50
    assert off_the_ball(out) < 1e-6
    assert report.after.mean_quality > report.before.mean_quality
    assert odt_plugins.quality(out) == report.after
    volume = ngsolve.Integrate(ngsolve.CF(1), ngsolve.Mesh(out), order=9)
    assert volume == pytest.approx(4 / 3 * np.pi, rel=1e-3)
    shell = geometry.GenerateMesh(maxh=0.4, optsteps2d=0, perfstepsend=3)
    surface = odt_plugins.optimize(shell)
    assert len(surface.Elements3D()) == 0
    assert (np.array(surface.Coordinates()) != np.array(shell.Coordinates())).any()
    assert off_the_ball(surface) < 1e-6


def test_sizes_of_a_function_come_onto_the_geometry():
    from netgen.occ import OCCGeometry, Pnt, Sphere

    mesh = OCCGeometry(Sphere(Pnt(0, 0, 0), 1)).GenerateMesh(maxh=2, optsteps3d=0)
    out = odt_plugins.remesh(mesh, lambda x: 0.5 * (0.3 + np.abs(x[:, 0])))
    assert len(out.Elements2D()) > len(mesh.Elements2D())
    assert off_the_ball(out) < 1e-6


def test_a_mesh_in_the_plane_keeps_its_edges(tmp_path):
    from netgen.geom2d import SplineGeometry

    geometry = SplineGeometry()
    geometry.AddRectangle((-1, -1), (1, 1), bc="wall", leftdomain=1, rightdomain=0)
    geometry.AddCircle((0, 0), 0.4, bc="ring", leftdomain=2, rightdomain=1)
    geometry.SetMaterial(1, "outer")
    geometry.SetMaterial(2, "inner")
    mesh = ngsolve.Mesh(geometry.GenerateMesh(maxh=0.3, optsteps2d=0))
    mesh.Curve(3)
    out, report = odt_plugins.optimize_with_report(mesh)
    assert report.after.mean_quality >= report.before.mean_quality
    assert out.GetMaterials() == ("outer", "inner")
    assert set(out.GetBoundaries()) == {"wall", "ring"}
    for old, new in zip(figures(mesh), figures(out), strict=True):
        assert new == pytest.approx(old, rel=1e-9)
    assert out.GetCurveOrder() == 3
    out.ngmesh.Save(str(tmp_path / "plane.vol"))
    assert odt_plugins.quality(tmp_path / "plane.vol").n_cells == report.after.n_cells


def test_periodic_identifications_stay():
    from netgen.occ import Box, IdentificationType, OCCGeometry, X

    box = Box((0, 0, 0), (1, 1, 1))
    box.faces.Min(X).Identify(box.faces.Max(X), "across", IdentificationType.PERIODIC)
    mesh = OCCGeometry(box).GenerateMesh(maxh=0.4, optsteps3d=0)
    for options in ({}, {"insert": True}, {"boundary": "slide"}):
        out = odt_plugins.optimize(mesh, **options)
        pairs = out.GetIdentifications()
        assert len(pairs) == len(mesh.GetIdentifications()) > 4
        places = np.array(out.Coordinates())
        for a, b, number in pairs:
            apart = places[b.nr - 1] - places[a.nr - 1]
            assert np.abs(apart) == pytest.approx([1, 0, 0], abs=1e-9)
            assert out.GetIdentificationType(number) == IdentificationType.PERIODIC
    _, report = odt_plugins.optimize_with_report(mesh, boundary="slide")
    assert "of periodic faces stay" in str(report)
    assert "free" not in str(report)
    with pytest.raises(UnsupportedMeshError, match="identified points"):
        odt_plugins.optimize(mesh, boundary="slide", free="periodic")


def test_what_ngsolve_adds_is_lost_with_a_warning():
    mesh = ngsolve.Mesh(part(0.8))
    space = ngsolve.VectorH1(mesh, order=1)
    shift = ngsolve.GridFunction(space)
    mesh.SetDeformation(shift)
    mesh.SetPML(ngsolve.pml.Radial(rad=1, alpha=1j, origin=(0, 0, 0)), "air")
    with pytest.warns(DataNotKeptWarning, match="the deformation and absorbing layers"):
        out = odt_plugins.optimize(mesh)
    assert out.deformation is None
    assert mesh.deformation is not None
    mesh = ngsolve.Mesh(part(0.8))
    mesh.Refine()
    with pytest.warns(DataNotKeptWarning, match="^levels of refinement of the mesh"):
        out = odt_plugins.optimize(mesh)
    assert figures(out)[0] == pytest.approx(figures(mesh)[0], rel=1e-9)


def test_what_cannot_be_kept_is_named():
    from netgen.geom2d import SplineGeometry
    from netgen.meshing import Mesh

    mesh = part(0.8)
    with pytest.raises(InvalidOptionError, match=r"expected one of .'material'."):
        odt_plugins.optimize(mesh, regions="iron")
    mesh.SecondOrder()
    with pytest.raises(UnsupportedMeshError, match=r"type 21 .*Curve\(2\)"):
        odt_plugins.optimize(mesh)
    square = SplineGeometry()
    square.AddRectangle((0, 0), (1, 1))
    with pytest.raises(UnsupportedMeshError, match=r"triangles only, try GenerateMesh\(\) without"):
        odt_plugins.optimize(square.GenerateMesh(maxh=0.3, quad_dominated=True))
    with pytest.raises(InvalidMeshError, match=r"no elements \(0 points\)"):
        odt_plugins.optimize(Mesh(3))
    mesh = part(0.8)
    mesh.AddPoints(np.array([[5.0, 5.0, 5.0]]))
    with pytest.raises(UnsupportedMeshError, match=r"1 point in no element .*mesh\.Compress\(\)"):
        odt_plugins.optimize(mesh)
    mesh.Compress()
    assert odt_plugins.quality(mesh).n_cells > 0
