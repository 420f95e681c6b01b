"""Models of Gmsh in memory: CAD parts, cells of higher order, periodic links, all or nothing."""

from __future__ import annotations

import re
from collections import Counter
from contextlib import contextmanager
from dataclasses import replace

import contract
import numpy as np
import pytest

import odt_plugins
from odt_plugins.adapters import gmsh_model
from odt_plugins.errors import InvalidMeshError, InvalidOptionError, UnsupportedMeshError
from odt_plugins.figures import radius_ratio

gmsh = pytest.importorskip("gmsh")


@contextmanager
def part(dim=3, size=0.4, order=1):
    """A plate with a pin in it, two volumes with groups, or two faces of it; meshed."""
    model = contract.GmshModel().current()
    box = model.occ.addBox(-0.7, -0.7, 0, 1.4, 1.4, 0.5)
    pin = model.occ.addCylinder(0, 0, 0, 0, 0, 0.5, 0.4)
    model.occ.fragment([(3, box)], [(3, pin)])
    model.occ.synchronize()
    model.addPhysicalGroup(3, [2], 11, name="pin")
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.option.setNumber("Mesh.ElementOrder", order)
    gmsh.option.setNumber("Mesh.Optimize", 0)
    model.mesh.generate(dim)
    try:
        yield model
    finally:
        gmsh.option.restoreDefaults()
        gmsh.option.setNumber("General.Terminal", 0)
        model.remove()


def dump(model):
    """All that the mesh is made of, by entity."""
    return {entity: [*model.mesh.getNodes(*entity), *(
        np.array(part) for parts in model.mesh.getElements(*entity) for part in parts)]
        for entity in model.getEntities()}


def same(a, b):
    return sorted(a) == sorted(b) and all(
        len(x) == len(y) and all(map(np.array_equal, x, y)) for x, y in zip(
            a.values(), b.values(), strict=True))


def corners(model, number=4):
    tags, nodes = model.mesh.getElementsByType(number)
    return tags, nodes.reshape(len(tags), -1)


def places(model):
    tags, flat, _ = model.mesh.getNodes()
    out = np.full((int(tags.max()) + 1, 3), np.nan)
    out[tags] = flat.reshape(-1, 3)
    return out


def test_a_part_keeps_all_but_its_volumes(tmp_path):
    with part() as model:
        before, tags = dump(model), corners(model)
        out, report = odt_plugins.optimize_with_report(model)
        after = dump(model)
        assert out is gmsh.model
        assert report.regions_from == ("entities",)
        assert list(after) == list(before)
        for entity in before:
            if entity[0] < 3:
                assert all(map(np.array_equal, before[entity], after[entity])), entity
            else:
                assert np.array_equal(np.sort(before[entity][0]), np.sort(after[entity][0]))
        assert model.getPhysicalName(3, 11) == "pin"
        assert model.getPhysicalGroups() == [(3, 11)]
        now = corners(model)
        assert len(np.unique(now[0])) == len(now[0])
        old = {int(t): frozenset(c.tolist()) for t, c in zip(*tags, strict=True)}
        keys = {cell: tag for tag, cell in old.items()}
        for tag, cell in zip(*now, strict=True):
            cell = frozenset(cell.tolist())
            assert keys.get(cell, int(tag)) == tag
        theirs = model.mesh.getElementQualities(now[0], "gamma")
        p = places(model)
        assert theirs == pytest.approx(radius_ratio(p, now[1].astype(np.int64)), abs=1e-12)
        assert theirs.min() == pytest.approx(report.after.min_quality)
        assert report.after.mean_quality > report.before.mean_quality
        node = int(before[3, 2][0][0])
        assert np.array_equal(model.mesh.getNode(node)[0], p[node])
        assert model.mesh.getNode(node)[2:] == (3, 2)
        assert odt_plugins.quality(model) == report.after
        gmsh.option.setNumber("Mesh.SaveAll", 1)
        gmsh.option.setNumber("Mesh.Binary", 1)
        gmsh.write(str(tmp_path / "part.msh"))
        assert odt_plugins.quality(tmp_path / "part.msh") == report.after


@pytest.mark.parametrize(("dim", "order"), [(3, 2), (2, 2), (3, 3)])
def test_elements_of_higher_order_stay_so(dim, order):
    with part(dim, 0.5, order) as model:
        if dim == 2:
            model.removeEntities(model.getEntities(3))
            model.removeEntities([(2, 1)], recursive=False)
        kind = {(3, 2): 11, (2, 2): 9, (3, 3): 29}[dim, order]
        before = dump(model)
        least = model.mesh.getElementQualities(corners(model, kind)[0], "minSICN")
        _, report = odt_plugins.optimize_with_report(model)
        after = dump(model)
        assert report.after.mean_quality > report.before.mean_quality
        for entity in before:
            if entity[0] < dim:
                assert all(map(np.array_equal, before[entity], after[entity])), entity
        assert not same(before, after)
        tags, cells = corners(model, kind)
        assert set(np.unique(cells).tolist()) <= set(model.mesh.getNodes()[0].tolist())
        assert model.mesh.getElementQualities(tags, "minSICN").min() >= min(least.min(), 0.2)
        assert np.isfinite(places(model)[cells]).all()
        used = {int(node) for key in after if key[0] < dim for node in after[key][0]}
        for entity in after:
            if entity[0] == dim:
                own = model.mesh.getNodes(*entity)[0]
                here = np.concatenate(model.mesh.getElements(*entity)[2])
                assert set(own.tolist()) == set(here.tolist()) - used


def test_faces_keep_parametric_coordinates():
    with part(2) as model:
        model.removeEntities(model.getEntities(3))
        before = dump(model)
        odt_plugins.optimize(model)
        after = dump(model)
        moved = 0
        for entity in before:
            tags, flat, parameters = after[entity][:3]
            assert len(parameters) == len(before[entity][2])
            if entity[0] != 2 or not len(tags):
                continue
            still = before[entity][1].reshape(-1, 3) == flat.reshape(-1, 3)
            still = still.all(axis=1)
            moved += (~still).sum()
            assert np.array_equal(before[entity][2].reshape(-1, 2)[still],
                                  parameters.reshape(-1, 2)[still])
            assert np.abs(model.getValue(*entity, parameters) - flat).max() < 1e-9
        assert moved > 10


def off_the_geometry(model):
    """How far nodes are at most from their faces and curves, and from where their parameters are.

    Also how many nodes of each dimension there are.
    """
    most, count = 0.0, {1: 0, 2: 0}
    for entity in model.getEntities(1) + model.getEntities(2):
        tags, flat, parameters = model.mesh.getNodes(*entity)
        if len(tags):
            there = [model.getClosestPoint(*entity, flat)[0]]
            # Gmsh gives none to some nodes of elements of second order.
            if len(parameters) == entity[0] * len(tags):
                there.append(model.getValue(*entity, parameters))
            most = max(most, *(float(np.abs(x - flat).max()) for x in there))
            count[entity[0]] += len(tags)
    return most, count


@pytest.mark.parametrize(("kind", "order"), [("addCylinder", 1), ("addTorus", 1), ("addTorus", 2)])
def test_vertices_of_a_cad_face_slide_on_it(kind, order, tmp_path):
    model = contract.GmshModel().current()
    sizes = (0, 0, 1, 0.5) if kind == "addCylinder" else (1, 0.4)
    getattr(model.occ, kind)(0, 0, 0, *sizes)
    model.occ.synchronize()
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.3)
    gmsh.option.setNumber("Mesh.Optimize", 0)
    gmsh.option.setNumber("Mesh.ElementOrder", order)
    model.mesh.generate(3)
    gmsh.option.setNumber("Mesh.ElementOrder", 1)
    before = dump(model)
    _, report = odt_plugins.optimize_with_report(model, boundary="slide")
    after = dump(model)
    moved = {dim: sum(int((before[e][1] != after[e][1]).reshape(-1, 3).any(axis=1).sum())
                      for e in before if e[0] == dim) for dim in range(3)}
    assert moved[0] == 0
    assert moved[2] > 50
    assert (moved[1] > 0) == (kind != "addTorus")
    off, count = off_the_geometry(model)
    assert off < (1e-9 if order == 1 else 1e-6)
    assert sum(count.values()) > 60
    assert report.after.mean_quality > report.before.mean_quality
    for entity in before:
        if entity[0] < 3:
            assert np.array_equal(before[entity][0], after[entity][0])
            assert all(map(np.array_equal, before[entity][3:], after[entity][3:]))
    tags, cells = corners(model, 4 if order == 1 else 11)
    if order == 1:
        theirs = model.mesh.getElementQualities(tags, "gamma")
        assert theirs.min() == pytest.approx(report.after.min_quality)
    gmsh.option.setNumber("Mesh.Binary", 1)
    gmsh.write(str(tmp_path / "part.msh"))
    told = odt_plugins.quality(tmp_path / "part.msh")
    assert replace(told, n_points=0) == replace(report.after, n_points=0)
    volume = model.occ.getMass(3, 1)
    x = places(model)[cells[:, :4]]
    size = np.abs(np.linalg.det(x[:, 1:] - x[:, :1])).sum() / 6
    assert 0.85 * volume < size < volume


def test_vertices_slide_on_the_parametrisation_of_a_surface_from_a_file(tmp_path):
    first = contract.GmshModel().current()
    first.occ.addTorus(0, 0, 0, 1, 0.4)
    first.occ.synchronize()
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.2)
    first.mesh.generate(2)
    gmsh.write(str(tmp_path / "torus.stl"))
    model = contract.GmshModel().current()
    gmsh.merge(str(tmp_path / "torus.stl"))
    model.mesh.classifySurfaces(np.pi / 4, True, True, np.pi)
    model.mesh.createGeometry()
    loop = model.geo.addSurfaceLoop([tag for _, tag in model.getEntities(2)])
    model.geo.addVolume([loop])
    model.geo.synchronize()
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
    model.mesh.generate(3)
    assert {model.getType(*entity) for entity in model.getEntities(2)} == {"Discrete surface"}
    before = dump(model)
    odt_plugins.optimize(model, boundary="slide")
    assert off_the_geometry(model)[0] < 1e-5
    assert sum(not np.array_equal(before[e][1], part[1]) for e, part in dump(model).items()
               if e[0] == 2) > 1


def test_a_cut_sphere_is_resized_though_feet_are_beyond_its_rim():
    model = contract.GmshModel().current()
    model.occ.cut([(3, model.occ.addSphere(0, 0, 0, 1))],
                  [(3, model.occ.addBox(-2, -2, 0.5, 4, 4, 2))])
    model.occ.synchronize()
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.25)
    model.mesh.generate(3)
    before = len(model.mesh.getElementsByType(2)[0])
    _, report = odt_plugins.remesh_with_report(model, scale=1.5, envelope=1e-2)
    assert report.slid["envelope"] < 0.1                # chords of 0.25 are 0.01 from the sphere
    assert report.fallback is None
    assert len(model.mesh.getElementsByType(2)[0]) < 0.8 * before
    assert off_the_geometry(model)[0] < 1e-9


def test_the_rim_of_every_entity_is_asked_once_for_the_places_on_it(monkeypatch):
    asked = Counter()

    def counting(name, call):
        def counted(*given, **options):
            asked[name] += 1
            return call(*given, **options)
        return staticmethod(counted)

    with part(size=0.3) as model:
        for name in ("getBoundary", "getClosestPoint"):
            monkeypatch.setattr(model, name, counting(name, getattr(model, name)))
        odt_plugins.optimize(model, boundary="slide", finish=False)
    assert 0 < asked["getBoundary"] <= asked["getClosestPoint"]


def test_vertices_that_were_taken_off_the_geometry_are_counted():
    with part(size=0.2) as model:
        tags, flat, _ = max((model.mesh.getNodes(*entity) for entity in model.getEntities(2)),
                            key=lambda nodes: len(nodes[0]))
        model.mesh.setNode(tags[0], flat[:3] * 1.05, [])
        _, report = odt_plugins.optimize_with_report(model, boundary="slide")
    assert any("1 vertex of the surface is not on the geometry" in note for note in report.notes)


def test_faces_of_a_model_without_volumes_stay_on_it():
    for options in ({}, {"boundary": "slide"}):
        with part(2) as model:
            model.removeEntities(model.getEntities(3))
            before = dump(model)
            _, report = odt_plugins.optimize_with_report(model, **options)
            assert report.after.mean_quality > report.before.mean_quality
            assert off_the_geometry(model)[0] < 1e-9
            same_curves = all(np.array_equal(before[e][1], model.mesh.getNodes(*e)[1])
                              for e in before if e[0] < 2)
            assert same_curves == (not options)


def test_vertices_are_inserted_and_removed():
    with part() as model:
        most = model.mesh.getMaxNodeTag()
        before = len(model.mesh.getNodes()[0])
        _, report = odt_plugins.optimize_with_report(model, insert=True)
        added, removed = (report.counts[f"vertices {what}"] for what in ("added", "removed"))
        _, cells = corners(model)
        own = model.mesh.getNodes()[0]
        assert len(own) - before == added - removed
        assert set(np.unique(cells).tolist()) <= set(own.tolist())
        assert len(np.unique(own)) == len(own)
        assert added
        assert own.max() == most + added


def test_periodic_curves_stay_linked_and_periodic_surfaces_do_not_move():
    shift = [1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    model = contract.GmshModel().current()
    model.occ.addRectangle(0, 0, 0, 1, 1)
    model.occ.synchronize()
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.15)
    model.mesh.setPeriodic(1, [2], [4], shift)
    model.mesh.generate(2)
    links = model.mesh.getPeriodicNodes(1, 2)
    before = dump(model)
    odt_plugins.optimize(model)
    assert not same(before, dump(model))
    assert all(map(np.array_equal, links, model.mesh.getPeriodicNodes(1, 2)))

    model = contract.GmshModel().current()
    model.occ.addSphere(0, 0, 0, 1)
    other = model.occ.copy([(3, 1)])
    model.occ.translate(other, 3, 0, 0)
    model.occ.synchronize()
    shift[3] = 3
    model.mesh.setPeriodic(2, [2], [1], shift)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
    model.mesh.generate(2)
    before = dump(model)
    with pytest.raises(UnsupportedMeshError, match=r"surface 2 and its master 1.*out of free"):
        odt_plugins.optimize(model, envelope=0.1, free="periodic")
    _, report = odt_plugins.optimize_with_report(model, envelope=0.1)
    assert f"{len(model.mesh.getNodes()[0])} vertices of periodic faces stay" in str(report)
    assert "free" not in str(report)
    assert same(before, dump(model))
    model.mesh.generate(3)
    links = model.mesh.getPeriodicNodes(2, 2)
    odt_plugins.optimize(model)
    assert all(map(np.array_equal, links, model.mesh.getPeriodicNodes(2, 2)))
    gmsh.option.restoreDefaults()
    gmsh.option.setNumber("General.Terminal", 0)


@pytest.mark.parametrize("order", [1, 2])
def test_periodic_surfaces_stay_and_others_slide(order):
    model = contract.GmshModel().current()
    model.occ.addBox(0, 0, 0, 1, 1, 1)
    model.occ.synchronize()
    model.mesh.setPeriodic(2, [2], [1], [1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1])
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.25)
    gmsh.option.setNumber("Mesh.ElementOrder", order)
    model.mesh.generate(3)
    links = model.mesh.getPeriodicNodes(2, 2)
    before = {tag: model.mesh.getNodes(2, tag)[1] for tag in (1, 2, 3, 4, 5, 6)}
    _, report = odt_plugins.optimize_with_report(model, boundary="slide", keep=())
    assert "of periodic faces stay" in str(report)
    assert "periodic'" not in str(report)
    assert all(map(np.array_equal, links, model.mesh.getPeriodicNodes(2, 2)))
    for tag in (1, 2):
        assert np.array_equal(before[tag], model.mesh.getNodes(2, tag)[1])
    assert any(not np.array_equal(before[tag], model.mesh.getNodes(2, tag)[1])
               for tag in (3, 4, 5, 6))
    gmsh.option.restoreDefaults()
    gmsh.option.setNumber("General.Terminal", 0)


def test_a_refusal_of_gmsh_leaves_the_model_as_it_was(monkeypatch):
    with part() as model:
        before = dump(model)
        calls = []

        def refuses(*arguments):
            calls.append(arguments)
            if len(calls) == 2:
                raise RuntimeError("no more")
            return add(*arguments)

        add = model.mesh.addElementsByType
        monkeypatch.setattr(model.mesh, "addElementsByType", staticmethod(refuses))
        with pytest.raises(RuntimeError, match="no more"):
            odt_plugins.optimize(model)
        assert len(calls) == 4
        assert same(before, dump(model))


@pytest.mark.parametrize(("change", "order"), [
    (odt_plugins.optimize, 2), (lambda model, **told: odt_plugins.remesh(model, 0.5, **told), 1)])
def test_who_stops_a_run_at_its_end_finds_the_model_as_it_was(change, order):
    def stop(_stage, share):
        if share == 1.0:
            raise KeyboardInterrupt

    with part(order=order) as model:
        before = dump(model)
        with pytest.raises(KeyboardInterrupt):
            change(model, progress=stop)
        assert same(before, dump(model))


@pytest.mark.parametrize("change", [
    odt_plugins.optimize, lambda model: odt_plugins.remesh(model, scale=0.7)])
def test_elements_of_a_surface_and_a_point_whose_nodes_are_on_the_volume_keep_them(change):
    points, cells, _ = contract.grid(3, 4)
    sides = np.sort(cells[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3), axis=1)
    skin, count = np.unique(sides, axis=0, return_counts=True)
    model = contract.GmshModel().current()
    for dim, tag in ((3, 1), (2, 5), (0, 3)):
        model.addDiscreteEntity(dim, tag)
    model.mesh.addNodes(3, 1, np.arange(len(points)) + 1, points.ravel())
    for tag, number, rows in ((1, 4, cells), (5, 2, skin[count == 1]), (3, 15, [0])):
        model.mesh.addElementsByType(tag, number, [], np.ravel(rows) + 1)
    before = places(model)
    change(model)
    at, (_, nodes) = places(model), corners(model, 2)
    a, b, c = np.moveaxis(at[nodes], 1, 0)
    assert np.sqrt((np.cross(b - a, c - a) ** 2).sum(axis=1)).sum() / 2 == pytest.approx(6)
    point = model.mesh.getElementsByType(15)[1]
    np.testing.assert_array_equal(at[point], before[[1]])


def test_what_cannot_be_kept_is_named():
    with part(size=0.7) as model:
        before = dump(model)
        with pytest.raises(InvalidOptionError, match="names no cell array"):
            odt_plugins.optimize(model, regions="pin")
        model.mesh.partition(2)
        with pytest.raises(UnsupportedMeshError, match=r"2 partitions; .*unpartition\(\)"):
            odt_plugins.optimize(model)
        model.mesh.unpartition()
        assert sorted(before) == sorted(dump(model))
    model = contract.GmshModel().current()
    model.addDiscreteEntity(3, 1)
    model.mesh.addNodes(3, 1, range(1, 9), contract.grid(3, 1)[0].ravel())
    model.mesh.addElementsByType(1, 5, [1], [1, 2, 4, 3, 5, 6, 8, 7])
    with pytest.raises(UnsupportedMeshError, match="type Hexahedron 8; expected tetra"):
        odt_plugins.optimize(model)
    model.mesh.addElementsByType(1, 4, [2], [1, 2, 3, 5])
    assert odt_plugins.quality(model).n_cells == 1
    model.addDiscreteEntity(3, 2)
    model.mesh.addNodes(3, 2, range(9, 19), np.arange(30.0))
    model.mesh.addElementsByType(2, 11, [3], range(9, 19))
    with pytest.raises(UnsupportedMeshError, match="Tetrahedron 10 beside Tetrahedron 4"):
        odt_plugins.optimize(model)


def test_gmsh_that_is_not_initialised_is_named(monkeypatch):
    monkeypatch.setattr(gmsh, "isInitialized", lambda: 0)
    with pytest.raises(InvalidMeshError, match=re.escape("try gmsh.initialize() first")):
        odt_plugins.optimize(gmsh.model)


def test_the_method_of_gmsh_does_what_the_function_does():
    odt_plugins.register("gmsh")
    odt_plugins.register("gmsh")
    meshes = []
    for how in (gmsh.model.mesh.odt, lambda **options: odt_plugins.optimize(gmsh.model, **options)):
        with part() as model:
            report = how(smoothing={"rounds": 3})
            meshes.append(dump(model))
            if len(meshes) == 1:
                assert report.after == odt_plugins.quality(model)
    assert same(*meshes)
    with pytest.raises(InvalidOptionError, match="did you mean 'threads'"):
        gmsh.model.mesh.odt(thread=3)
    assert gmsh_model.matches(gmsh.model)
    assert not gmsh_model.matches(gmsh.model.mesh)


def judged_by_gmsh():
    """Qualities of all tetrahedra of the current model by Gmsh's plugin, sorted."""
    for name in ("ICNMeasure", "CreateView", "Recompute"):
        gmsh.plugin.setNumber("AnalyseMeshQuality", name, 1)
    gmsh.plugin.setNumber("AnalyseMeshQuality", "DimensionOfElements", 3)
    gmsh.plugin.run("AnalyseMeshQuality")
    view = gmsh.view.getTags()[-1]
    values = np.sort(np.ravel(gmsh.view.getModelData(view, 0)[2]))
    gmsh.view.remove(view)
    return values


@pytest.mark.parametrize("options", [{}, {"insert": True}, {"boundary": "slide"}])
def test_the_quality_plugin_of_gmsh_and_a_written_file_agree(options, tmp_path):
    with part() as model:
        before = judged_by_gmsh()
        _, report = odt_plugins.optimize_with_report(model, **options)
        after = judged_by_gmsh()
        assert len(after) == report.after.n_cells
        assert after.mean() > before.mean()
        assert after.min() > before.min()
        gmsh.option.setNumber("Mesh.SaveAll", 1)
        gmsh.option.setNumber("Mesh.Binary", 1)
        gmsh.write(str(tmp_path / "part.msh"))
        name = model.getCurrent()
        gmsh.open(str(tmp_path / "part.msh"))
        assert np.array_equal(judged_by_gmsh(), after)
        gmsh.model.remove()
        gmsh.model.setCurrent(name)
