"""Models of Gmsh and Netgen whose boundary has other sizes: groups and names stay where they are.

Gmsh and Netgen measure, and read what was written; the geometry tells where nodes are.
"""

from __future__ import annotations

import numpy as np
import pytest
from gmsh_sessions import group_sizes, session, two_solids

import odt_plugins
import odt_plugins.engine.remesh.finish as remesh_finish
from odt_plugins.errors import UnsupportedMeshError


def skin_of(cells, domains):
    """Facets with a cell on one side only, or cells of two domains, each once, sorted."""
    k = cells.shape[1]
    facets = np.sort(np.concatenate([np.delete(cells, i, axis=1) for i in range(k)]), axis=1)
    rows, inverse, count = np.unique(facets, axis=0, return_inverse=True, return_counts=True)
    domain = np.tile(domains, k)
    low, high = np.full(len(rows), domain.max()), np.full(len(rows), domain.min())
    np.minimum.at(low, inverse.ravel(), domain)
    np.maximum.at(high, inverse.ravel(), domain)
    return rows[(count == 1) | (low != high)]


def faces_of(facets):
    """Rows, sorted."""
    return np.unique(np.sort(facets, axis=1), axis=0)


def plate(model):
    """A block with a round hole, in groups, one of curves."""
    model.add("plate")
    model.occ.cut([(3, model.occ.addBox(0, 0, 0, 2, 1.6, 0.5))],
                  [(3, model.occ.addCylinder(1, 0.8, 0, 0, 0, 0.5, 0.4))])
    model.occ.synchronize()
    hole = [tag for _, tag in model.getEntities(2) if model.getType(2, tag) == "Cylinder"]
    flat = [tag for _, tag in model.getEntities(2) if tag not in hole]
    rim = [tag for _, tag in model.getEntities(1) if model.getType(1, tag) == "Circle"]
    straight = [tag for _, tag in model.getEntities(1) if tag not in rim]
    for dim, tags, tag, name in ((3, [1], 1, "steel"), (2, hole, 2, "hole"), (2, flat, 3, "flat"),
                                 (1, rim, 4, "rim"), (1, straight, 5, "edges")):
        model.addPhysicalGroup(dim, tags, tag, name)


def disc(model):
    """A disc in the plane with a square of another material in it."""
    model.add("disc")
    model.occ.fragment([(2, model.occ.addDisk(0, 0, 0, 1, 1))],
                       [(2, model.occ.addRectangle(-0.4, -0.4, 0, 0.8, 0.8))])
    model.occ.synchronize()
    rim = [tag for _, tag in model.getEntities(1) if model.getType(1, tag) != "Line"]
    inner = [tag for _, tag in model.getEntities(1) if tag not in rim]
    areas = {tag: model.occ.getMass(2, tag) for _, tag in model.getEntities(2)}
    small = min(areas, key=areas.get)
    for dim, tags, tag, name in ((2, [small], 1, "core"), (2, [*areas.keys() - {small}], 2, "ring"),
                                 (1, rim, 3, "rim"), (1, inner, 4, "between")):
        model.addPhysicalGroup(dim, tags, tag, name)


def elements(model, dim):
    """Nodes of the simplices of a dimension, and the tag of the entity of each."""
    rows, owner = [np.zeros((0, dim + 1), dtype=np.int64)], []
    for _, tag in model.getEntities(dim):
        for nodes in model.mesh.getElements(dim, tag)[2]:
            rows.append(nodes.reshape(-1, dim + 1).astype(np.int64))
            owner += [tag] * len(rows[-1])
    return np.concatenate(rows), np.array(owner)


def off_the_geometry(model):
    """How far nodes are at most from their faces and curves, and from where parameters say."""
    most = 0.0
    for entity in model.getEntities(1) + model.getEntities(2):
        tags, flat, parameters = model.mesh.getNodes(*entity)
        if len(tags):
            assert len(parameters) == entity[0] * len(tags)
            for there in (model.getClosestPoint(*entity, flat)[0],
                          model.getValue(*entity, parameters)):
                most = max(most, float(np.abs(there - flat).max()))
    return most


def expect_sound(model, dim, *, between=True):
    """Facets are those of the cells, elements have nodes of their closure, tags are there once."""
    cells, domain = elements(model, dim)
    domain = domain if between else np.ones_like(domain)
    np.testing.assert_array_equal(faces_of(elements(model, dim - 1)[0]), skin_of(cells, domain))
    nodes, every = model.mesh.getNodes()[0], model.mesh.getElements()[1]
    assert len(np.unique(nodes)) == len(nodes)
    every = np.concatenate(every)
    assert len(np.unique(every)) == len(every)
    used = []
    for entity in model.getEntities():
        own = set(model.mesh.getNodes(*entity)[0].tolist())
        closure = set(model.mesh.getNodes(*entity, includeBoundary=True)[0].tolist())
        found = {int(node) for part in model.mesh.getElements(*entity)[2] for node in part}
        assert found <= closure
        assert own <= found or not found
        used += found
    assert set(used) == set(nodes.tolist())


@pytest.mark.parametrize("scale", [1.6, 0.6])
@pytest.mark.parametrize("make", [plate, disc])
def test_gmsh_finds_its_groups_on_the_geometry(make, scale, tmp_path):
    dim = 3 if make is plate else 2
    with session() as gmsh:
        model = gmsh.model
        make(model)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.35)
        model.mesh.generate(dim)
        was, count = group_sizes(gmsh), [len(elements(model, d)[0]) for d in range(dim + 1)]
        names = model.getPhysicalGroups()
        _, report = odt_plugins.remesh_with_report(model, scale=scale, envelope=0.02,
                                                   free="periodic")
        assert report.fallback is None
        now, after = group_sizes(gmsh), [len(elements(model, d)[0]) for d in range(dim + 1)]
        assert model.getPhysicalGroups() == names
        for d in range(1, dim + 1):
            assert (after[d] < 0.9 * count[d]) if scale > 1 else (after[d] > count[d])
        assert off_the_geometry(model) < 1e-9
        expect_sound(model, dim)
        assert now == pytest.approx(was, rel=0.03)
        for key in was:
            if key[2] in ("edges", "between", "core"):
                assert now[key] == pytest.approx(was[key], rel=1e-12)
        gmsh.write(str(tmp_path / "part.msh"))
        gmsh.open(str(tmp_path / "part.msh"))
        assert group_sizes(gmsh) == pytest.approx(now, rel=1e-12)
        assert [len(elements(gmsh.model, d)[0]) for d in range(1, dim + 1)] == after[1:]


def test_faces_of_gmsh_without_nodes_of_their_own_are_refined():
    with session() as gmsh:
        model = gmsh.model
        model.occ.fragment([(2, model.occ.addRectangle(0, 0, 0.5, 1, 1))],
                           [(2, model.occ.addDisk(1, 0.5, 0.5, 0.2, 0.2))])
        model.occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMin", 0.25)
        model.mesh.generate(2)
        bare = [entity for entity in model.getEntities(2)
                if not len(model.mesh.getNodes(*entity)[0])]
        assert bare
        odt_plugins.remesh(model, scale=0.6)
        assert all(len(model.mesh.getNodes(*entity)[0]) for entity in bare)
        assert off_the_geometry(model) < 1e-9
        expect_sound(model, 2)


def test_a_discrete_model_of_a_file_keeps_its_groups(tmp_path):
    with session() as gmsh:
        two_solids(gmsh.model)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.3)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(tmp_path / "part.msh"))
        gmsh.open(str(tmp_path / "part.msh"))
        model = gmsh.model
        was, count = group_sizes(gmsh), len(elements(model, 2)[0])
        odt_plugins.remesh(model, scale=1.5, envelope=0.01, free="periodic")
        assert len(elements(model, 2)[0]) < 0.7 * count
        assert group_sizes(gmsh) == pytest.approx(was, rel=1e-9)
        expect_sound(model, 3, between=False)


@pytest.mark.parametrize("scale", [1.6, 0.6])
def test_new_nodes_of_a_curved_surface_are_on_it(scale):
    with session() as gmsh:
        gmsh.model.occ.addTorus(0, 0, 0, 1, 0.4)
        gmsh.model.occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.3)
        gmsh.model.mesh.generate(2)
        count = len(elements(gmsh.model, 2)[0])
        odt_plugins.remesh(gmsh.model, scale=scale, envelope=0.02)
        after = len(elements(gmsh.model, 2)[0])
        assert (after < 0.6 * count) if scale > 1 else (after > 2 * count)
        assert off_the_geometry(gmsh.model) < 1e-9


def test_vertices_come_inside_once_though_a_body_on_its_geometry_is_finished_twice(monkeypatch):
    run, asked = remesh_finish.run, []
    monkeypatch.setattr(remesh_finish, "POOR", 1.0)
    monkeypatch.setattr(remesh_finish, "run", lambda mesh, options, *how, **more: asked.append(
        (options.boundary, options.insert > 0)) or run(mesh, options, *how, **more))
    with session() as gmsh:
        plate(gmsh.model)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.4)
        gmsh.model.mesh.generate(3)
        odt_plugins.remesh(gmsh.model, scale=1.2, envelope=0.02, free="periodic")
        expect_sound(gmsh.model, 3)
        assert off_the_geometry(gmsh.model) < 1e-9
    assert ("slide", False) in asked
    assert ("slide", True) not in asked
    assert ("fixed", True) in asked


def dump(model, dims):
    return [np.array(part) for dim in dims for entity in model.getEntities(dim) for part in (
        *model.mesh.getNodes(*entity), *(x for y in model.mesh.getElements(*entity) for x in y))]


def test_a_fixed_boundary_of_a_model_stays_bit_for_bit():
    with session() as gmsh:
        plate(gmsh.model)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.4)
        gmsh.model.mesh.generate(3)
        before = dump(gmsh.model, (0, 1, 2))
        odt_plugins.remesh(gmsh.model, scale=0.7, boundary="fixed")
        assert all(a.tobytes() == b.tobytes() for a, b in zip(
            before, dump(gmsh.model, (0, 1, 2)), strict=True))


def test_a_refusal_of_gmsh_gives_faces_and_curves_back(monkeypatch):
    with session() as gmsh:
        model = gmsh.model
        plate(model)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.4)
        model.mesh.generate(3)
        before, count, add = dump(model, range(4)), [], model.mesh.addElementsByType

        def refuses(*arguments):
            count.append(arguments)
            if len(count) == 12:
                raise RuntimeError("no more")
            return add(*arguments)

        monkeypatch.setattr(model.mesh, "addElementsByType", staticmethod(refuses))
        with pytest.raises(RuntimeError, match="no more"):
            odt_plugins.remesh(model, scale=0.6, envelope=0.02, free="periodic")
        assert all(a.tobytes() == b.tobytes() for a, b in zip(
            before, dump(model, range(4)), strict=True))


def test_periodic_surfaces_of_gmsh_that_would_come_apart_are_refused():
    with session() as gmsh:
        model = gmsh.model
        model.occ.addBox(0, 0, 0, 1, 1, 1)
        model.occ.synchronize()
        model.mesh.setPeriodic(2, [2], [1], [1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1])
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.4)
        model.mesh.generate(3)
        before = dump(model, range(4))
        with pytest.raises(UnsupportedMeshError, match=r"periodic .* out of free"):
            odt_plugins.remesh(model, scale=1.5, envelope=0.02, free="periodic")
        assert all(map(np.array_equal, before, dump(model, range(4))))
        links = model.mesh.getPeriodicNodes(2, 2)
        odt_plugins.remesh(model, scale=1.5, envelope=0.02)
        assert all(map(np.array_equal, links, model.mesh.getPeriodicNodes(2, 2)))
        expect_sound(model, 3)


def netgen_part(kind, size):
    """A block with a round hole whose faces and edges have names, or the like."""
    occ = pytest.importorskip("netgen.occ")
    if kind == "occ":
        body = occ.Box((0, 0, 0), (2, 1.6, 0.5)) - occ.Cylinder((1, 0.8, 0), occ.Z, r=0.4, h=0.5)
        body.faces.name = "wall"
        body.faces[occ.Z > 0.49].name = "top"
        body.edges[occ.Z > 0.49].name = "upper"
        body.mat("steel")
        return occ.OCCGeometry(body).GenerateMesh(maxh=size, optsteps3d=0)
    if kind == "csg":
        from netgen import csg

        solid = csg.Cylinder(csg.Pnt(0, 0, 0), csg.Pnt(0, 0, 1), 0.5).bc("mantle") * csg.OrthoBrick(
            csg.Pnt(-1, -1, 0), csg.Pnt(1, 1, 1)).bc("lids")
        geometry = csg.CSGeometry()
        geometry.Add(solid.mat("rod"))
        return geometry.GenerateMesh(maxh=size, optsteps3d=0)
    outer = occ.Circle((0, 0), 1).Face()
    outer.edges.name = "rim"
    inner = occ.MoveTo(-0.4, -0.4).Rectangle(0.8, 0.8).Face()
    inner.faces.name = "core"
    both = occ.Glue([outer - inner, inner])
    return occ.OCCGeometry(both, dim=2).GenerateMesh(maxh=size)


def names_of(mesh):
    """Sizes of domains, boundaries and edges by their names, by NGSolve, and all names."""
    ngsolve = pytest.importorskip("ngsolve")
    mesh = ngsolve.Mesh(mesh)
    kinds = [(ngsolve.VOL, mesh.GetMaterials()), (ngsolve.BND, mesh.GetBoundaries())]
    if mesh.dim == 3:
        kinds.append((ngsolve.BBND, mesh.GetBBoundaries()))
    return [names for _, names in kinds], [
        [*ngsolve.Integrate(ngsolve.CF(1), mesh, kind, region_wise=True)] for kind, _ in kinds]


def rows_of(mesh, dim):
    found = (mesh.Elements1D, mesh.Elements2D, mesh.Elements3D)[dim - 1]()
    table = found.NumPy()
    return (np.array(table["nodes"][:, : dim + 1], dtype=np.int64) - 1, np.array(table["index"]))


@pytest.mark.parametrize(("kind", "size", "scale"), [
    ("occ", 0.4, 0.6), ("csg", 0.16, 1.8), ("csg", 0.35, 0.5),
    ("plane", 0.28, 1.8), ("plane", 0.28, 0.5)])
def test_netgen_finds_its_names_on_the_geometry(kind, size, scale, tmp_path):
    mesh = netgen_part(kind, size)
    dim = mesh.dim
    count = [len(rows_of(mesh, d)[0]) for d in range(1, dim + 1)]
    out, report = odt_plugins.remesh_with_report(mesh, scale=scale, envelope=0.05, free="periodic")
    assert report.fallback is None
    after = [len(rows_of(out, d)[0]) for d in range(1, dim + 1)]
    for one, other in zip(after, count, strict=True):
        assert (one < other) if scale > 1 else (one > other)
    cells, domain = rows_of(out, dim)
    np.testing.assert_array_equal(faces_of(rows_of(out, dim - 1)[0]), skin_of(cells, domain))
    (names, was), (same, now) = names_of(mesh), names_of(out)
    assert names == same
    for old, new in zip(was, now, strict=True):
        assert new == pytest.approx(old, rel=0.06)
    x = np.array(out.Coordinates())
    middle = {"occ": (1, 0.8), "csg": (0, 0), "plane": (0, 0)}[kind]
    radius = {"occ": 0.4, "csg": 0.5, "plane": 1.0}[kind]
    skin = np.unique(rows_of(out, dim - 1)[0])
    r = np.linalg.norm(x[skin, :2] - middle, axis=1)
    assert ((np.abs(r - radius) < 0.04) == (np.abs(r - radius) < 1e-9)).mean() > 0.97
    lines = rows_of(out, 1)[0]
    assert (np.linalg.norm(x[lines[:, 0]] - x[lines[:, 1]], axis=1) > 0).all()
    out.Save(str(tmp_path / "part.vol"))
    assert odt_plugins.quality(tmp_path / "part.vol").n_cells == report.after.n_cells
    finer = out.Copy()
    finer.Refine()
    exact = {"occ": (3.2 - 0.16 * np.pi) / 2, "csg": 0.25 * np.pi, "plane": np.pi}[kind]
    sizes = [abs(sum(names_of(x)[1][0]) - exact) for x in (out, finer)]
    assert sizes[1] < 0.4 * sizes[0]


def test_a_mesh_of_netgen_without_geometry_keeps_its_names():
    meshing = pytest.importorskip("netgen.meshing")
    full = netgen_part("occ", 0.5)
    mesh = meshing.Mesh(3)
    mesh.AddPoints(np.array(full.Coordinates()))
    for number in (1, 2):
        mesh.Add(meshing.FaceDescriptor(surfnr=number, domin=1, domout=0, bc=number))
    mesh.SetBCName(0, "low")
    mesh.SetBCName(1, "else")
    mesh.SetMaterial(1, "steel")
    x = np.array(full.Coordinates())
    for number, rows in ((1, rows_of(full, 2)[0]), (2, rows_of(full, 2)[0])):
        low = x[rows].max(axis=1)[:, 2] < 1e-9
        mesh.AddElements(dim=2, index=number, base=0,
                         data=np.ascontiguousarray(rows[low == (number == 1)], dtype=np.int32))
    mesh.AddElements(dim=3, index=1, base=0,
                     data=np.ascontiguousarray(rows_of(full, 3)[0], dtype=np.int32))
    out = odt_plugins.remesh(mesh, scale=1.5, envelope=0.02, free="periodic")
    (names, was), (same, now) = names_of(mesh), names_of(out)
    assert names == same
    assert names[1] == ("low", "else")
    count = [len(rows_of(one, 2)[0]) for one in (mesh, out)]
    assert count[1] < count[0]
    for old, new in zip(was[:2], now[:2], strict=True):
        assert new == pytest.approx(old, rel=0.01)
    cells, domain = rows_of(out, 3)
    np.testing.assert_array_equal(faces_of(rows_of(out, 2)[0]), skin_of(cells, domain))


def test_netgen_keeps_a_fixed_boundary_bit_for_bit():
    mesh = netgen_part("occ", 0.4)
    out = odt_plugins.remesh(mesh, scale=0.6, boundary="fixed")
    for dim in (1, 2):
        (rows, index), (after, same) = rows_of(mesh, dim), rows_of(out, dim)
        np.testing.assert_array_equal(index, same)
        places = [np.array(one.Coordinates())[nodes] for one, nodes in ((mesh, rows), (out, after))]
        assert places[0].tobytes() == places[1].tobytes()


def test_splines_of_netgen_stay_and_the_report_says_why():
    geom2d = pytest.importorskip("netgen.geom2d")
    geometry = geom2d.SplineGeometry()
    geometry.AddCircle((0, 0), 1, bc="rim")
    mesh = geometry.GenerateMesh(maxh=0.2)
    for scale in (1.5, 0.6):
        out, report = odt_plugins.remesh_with_report(mesh, scale=scale)
        assert "vertices on splines stay, since Netgen takes no parameters" in str(report)
        (rows, _), (after, _) = rows_of(mesh, 1), rows_of(out, 1)
        places = [np.array(one.Coordinates())[nodes] for one, nodes in ((mesh, rows), (out, after))]
        assert places[0].tobytes() == places[1].tobytes()
        assert (len(out.Elements2D()) < len(mesh.Elements2D())) == (scale > 1)


@pytest.mark.parametrize("scale", [1.5, 0.6])
def test_a_shell_of_netgen_is_curved_on_its_geometry(scale):
    occ, ngsolve = pytest.importorskip("netgen.occ"), pytest.importorskip("ngsolve")
    ball = occ.OCCGeometry(occ.Sphere(occ.Pnt(0, 0, 0), 1))
    mesh = ball.GenerateMesh(maxh=0.4, perfstepsend=3)
    out = odt_plugins.remesh(mesh, scale=scale, envelope=0.03)
    assert (len(out.Elements2D()) < len(mesh.Elements2D())) == (scale > 1)
    assert np.linalg.norm(np.array(out.Coordinates()), axis=1) == pytest.approx(1, abs=1e-9)
    out.Curve(3)
    area = ngsolve.Integrate(ngsolve.CF(1), ngsolve.Mesh(out), ngsolve.BND, order=9)
    assert area == pytest.approx(4 * np.pi, rel=1e-3)


def test_a_mesh_that_left_its_geometry_is_not_put_back_on_it():
    mesh = netgen_part("plane", 0.4)
    mesh.Coordinates()[:] *= 2.0
    out, report = odt_plugins.remesh_with_report(mesh, scale=0.4, envelope=0.02)
    assert "not on the geometry that the mesh refers to" in str(report)
    assert len(rows_of(out, 2)[0]) > len(rows_of(mesh, 2)[0])
    for old, new in zip(names_of(mesh)[1], names_of(out)[1], strict=True):
        assert new == pytest.approx(old, rel=0.01)


def off_geometry(model):
    """Largest distance of nodes, those between corners too, from where their parameters are."""
    off = 0.0
    for dim, tag in model.getEntities():
        nodes, places, at = model.mesh.getNodes(dim, tag, returnParametricCoord=True)
        if dim in (1, 2) and len(nodes):
            off = max(off, float(np.abs(model.getValue(dim, tag, at) - places).max()))
    return off


@pytest.mark.parametrize("make", [plate, disc])
@pytest.mark.parametrize("scale", [0.6, 1.3])
def test_nodes_between_corners_are_on_the_geometry(make, scale):
    import gmsh

    with session():
        make(gmsh.model)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.2)
        gmsh.model.mesh.generate(3 if make is plate else 2)
        gmsh.model.mesh.setOrder(2)
        assert off_geometry(gmsh.model) < 1e-9
        count = gmsh.model.mesh.getMaxNodeTag()
        _, report = odt_plugins.remesh_with_report(gmsh.model, scale=scale)
        assert gmsh.model.mesh.getMaxNodeTag() > count or scale > 1.0
        flatter = any("flatter" in note for note in report.notes)
        assert flatter or off_geometry(gmsh.model) < 1e-9
        assert make is plate or not flatter
