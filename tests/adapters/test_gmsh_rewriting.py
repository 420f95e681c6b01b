"""Files of Gmsh with everything in them go through, as Gmsh itself reads them before and after."""

from __future__ import annotations

import re
import warnings

import contract
import meshio
import numpy as np
import pytest
from gmsh_sessions import session

from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.api import optimize_file
from odt_plugins.cli import main as cli
from odt_plugins.errors import DataNotKeptWarning, MeshFileError

KINDS = [(2.2, 0), (2.2, 1), (4.0, 0), (4.1, 0), (4.1, 1)]
FIELD = np.array([1.0, 2.0, 3.0])
OWN = b"$MyOwn\n 1\ttwo 3.\n$EndMyOwn\n$Comments\nhello\n$EndComments\n"


@pytest.fixture
def gmsh():
    with session() as module:
        module.model.add("everything")
        yield module


def store(gmsh, path, version, binary, *, order=1, parts=0):
    """Two boxes, groups, periodic faces, gaps in the numbers of nodes, views of all kinds."""
    model, mesh = gmsh.model, gmsh.model.mesh
    model.occ.fragment([(3, model.occ.addBox(0, 0, 0, 1, 1, 1))],
                       [(3, model.occ.addBox(1, 0, 0, 1, 1, 1))])
    model.occ.synchronize()
    for dim, entity, name in ((3, 1, "one"), (3, 2, "two"), (2, 1, "skin"), (1, 1, "edge"),
                              (0, 1, "corner")):
        model.addPhysicalGroup(dim, [entity], 6 + entity, name)
    if version > 2.2:
        model.addPhysicalGroup(3, [1, 2], 3, "all")
    face = {tuple(np.round(model.occ.getCenterOfMass(2, tag), 6).tolist()): tag
            for _, tag in model.getEntities(2)}
    mesh.setPeriodic(2, [face[0.5, 1, 0.5]], [face[0.5, 0, 0.5]],
                     [1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 1, 0, 0, 0, 0, 1])
    for name, value in (("MeshSizeMax", 0.4), ("Optimize", 0), ("ElementOrder", order),
                        ("MshFileVersion", version), ("Binary", binary)):
        gmsh.option.setNumber(f"Mesh.{name}", value)
    mesh.generate(3)
    tags = np.unique(mesh.getNodes()[0])
    mesh.renumberNodes(tags.tolist(), (3 * tags + 5).tolist())
    if parts:
        mesh.partition(parts)
    gmsh.write(str(path))
    tets = mesh.getElementsByType(4 if order == 1 else 11)[0][:60]
    nodes, places, _ = mesh.getNodes()
    gmsh.option.setNumber("PostProcessing.SaveMesh", 0)
    for name, kind, of, rows in (
            ("heat", "NodeData", nodes, places.reshape(-1, 3) @ FIELD),
            ("stress", "ElementData", tets, np.arange(180.0)),
            ("corners", "ElementNodeData", tets, np.arange(240.0))):
        view = gmsh.view.add(name)
        for step in range(2):
            gmsh.view.addHomogeneousModelData(view, step, model.getCurrent(), kind, of,
                                              rows + step, step / 4, 3 if name == "stress" else 1)
        gmsh.view.write(view, str(path), append=True)
    with path.open("ab") as file:
        file.write(OWN)


def seen(gmsh, path):
    """What Gmsh sees in a file, of what a run does not change."""
    gmsh.clear()
    for view in gmsh.view.getTags():
        gmsh.view.remove(view)
    gmsh.open(str(path))
    model, mesh = gmsh.model, gmsh.model.mesh
    out = {"entities": model.getEntities(), "parts": model.getNumberOfPartitions()}
    for dim, tag in model.getPhysicalGroups():
        out[dim, tag] = (model.getPhysicalName(dim, tag),
                         model.getEntitiesForPhysicalGroup(dim, tag).tolist())
    for dim, tag in model.getEntities(2):
        master, one, two, affine = mesh.getPeriodicNodes(dim, tag)
        out["periodic", tag] = (master, sorted(zip(one.tolist(), two.tolist(), strict=True)),
                                affine.tolist())
    for dim, tag in [] if out["parts"] else model.getEntities():
        kinds, _, _ = mesh.getElements(dim, tag)
        out["size", dim, tag] = [round(float(mesh.getElementQualities(
            mesh.getElementsByType(kind, tag)[0], "volume").sum()), 9)
            for kind in kinds if dim]
    for view in gmsh.view.getTags():
        steps = int(gmsh.view.option.getNumber(view, "NbTimeStep"))
        found = [gmsh.view.getModelData(view, step) for step in range(steps)]
        out["view", gmsh.view.option.getString(view, "Name")] = [
            (kind, time, width) for kind, _, _, time, width in found]
    return out


@pytest.mark.parametrize(("version", "binary", "order", "parts"), [
    *[(*kind, 1, 0) for kind in KINDS], (2.2, 0, 2, 0), (4.1, 0, 2, 0), (4.1, 1, 2, 0),
    (4.1, 1, 1, 2)])
def test_everything_goes_through(version, binary, order, parts, gmsh, tmp_path):
    source, target = tmp_path / "a.msh", tmp_path / "b.msh"
    store(gmsh, source, version, binary, order=order, parts=parts)
    before = seen(gmsh, source)
    old = {int(n): row.tolist() for kind, numbers, nodes in zip(
        *gmsh.model.mesh.getElements(3), strict=True) for n, row in
        zip(numbers, np.sort(nodes.reshape(len(numbers), -1), axis=1), strict=True)}
    with pytest.warns(DataNotKeptWarning, match=r"keep values of 'corners\[0\]' at the corners of"):
        optimize_file(source, target)
    assert seen(gmsh, target) == before
    new = {int(n): row.tolist() for kind, numbers, nodes in zip(
        *gmsh.model.mesh.getElements(3), strict=True) for n, row in
        zip(numbers, np.sort(nodes.reshape(len(numbers), -1), axis=1), strict=True)}
    numbers = {tuple(row): n for n, row in old.items()}
    same = [n for n, row in new.items() if numbers.get(tuple(row)) == n]
    assert len(same) == len(numbers.keys() & {tuple(row) for row in new.values()}) < len(new)
    places = {int(n): x for n, x in zip(
        gmsh.model.mesh.getNodes()[0], gmsh.model.mesh.getNodes()[1].reshape(-1, 3), strict=True)}
    for view in gmsh.view.getTags():
        kind, tags, values, _, _ = gmsh.view.getModelData(view, 1)
        if kind == "NodeData":
            expected = [FIELD @ places[int(n)] + 1 for n in tags]
            assert np.allclose(np.ravel(values), expected, rtol=0, atol=1e-12)
        if kind == "ElementNodeData":
            assert {int(n) for n in tags} <= set(same)
    texts = [path.read_bytes() for path in (source, target)]
    assert texts[1].endswith(OWN)
    if not binary:
        names = [re.findall(rb"^\$\w+", text, re.MULTILINE) for text in texts]
        assert names[0] == names[1]


def old_style(path):
    """A file of version 1, with numbers that have gaps, of two regions."""
    points, cells, labels = contract.grid(3, 3)
    labels = np.unique(labels, return_inverse=True)[1] + 1
    tags = 10 * np.arange(len(points))[::-1] + 3
    rows = [f"{7 * i + 1} 4 {label} {label} 4 {' '.join(map(str, tags[cell]))}\n"
            for i, (cell, label) in enumerate(zip(cells, labels, strict=True))]
    path.write_text(f"$NOD\n{len(points)}\n" + "".join(
        f"{tag} {x!r} {y!r} {z!r}\n" for tag, (x, y, z) in zip(tags, points.tolist(), strict=True))
        + f"$ENDNOD\n$ELM\n{len(rows)}\n{''.join(rows)}$ENDELM\n")
    return points, cells, labels


@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_files_of_version_1(ends, gmsh, tmp_path):
    source, target = tmp_path / "a.msh", tmp_path / "b.msh"
    points, cells, labels = old_style(source)
    source.write_bytes(source.read_bytes().replace(b"\n", ends.encode()))
    mesh = read_file(source)
    assert np.array_equal(mesh.points, points)
    assert np.array_equal(np.concatenate([block.data for block in mesh.cells]), cells)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        optimize_file(source, target)
    text = target.read_bytes()
    assert text.startswith(f"$NOD{ends}{len(points)}{ends}".encode())
    assert text.count(b"\r\n") == (text.count(b"\n") if ends == "\r\n" else 0)
    unmoved = set(source.read_bytes().splitlines()[2: 2 + len(points)])
    assert len(unmoved & set(text.splitlines())) > len(points) // 2
    gmsh.open(str(target))
    sizes = {tag: gmsh.model.mesh.getElementQualities(
        gmsh.model.mesh.getElementsByType(4, tag)[0], "volume").sum() for _, tag in
        gmsh.model.getEntities(3)}
    for label in np.unique(labels).tolist():
        expected = contract.volumes(points, cells[labels == label]).sum() / 6
        assert sizes[label] == pytest.approx(expected)


def test_values_belong_to_the_nodes_that_they_name(tmp_path):
    """Nodes and values are in other orders than their numbers."""
    points, cells, _ = contract.grid(3, 2)
    path = tmp_path / "a.msh"
    write_file(path, meshio.Mesh(points, [("tetra", cells)], {"u": points @ FIELD}),
               file_format="gmsh22", binary=False)
    head, body, end = re.split(rb"(?<=\n1\n27\n)|(?=\$EndNodeData)", path.read_bytes())
    path.write_bytes(head + b"".join(body.splitlines(keepends=True)[::-1]) + end)
    mesh = read_file(path)
    assert np.allclose(mesh.point_data["u"], mesh.points @ FIELD)


@pytest.mark.parametrize("scale", ["0.7", "1.5"])
@pytest.mark.parametrize(("version", "binary"), [(2.2, 0), (4.1, 0), (4.1, 1)])
def test_values_of_nodes_that_come_and_go_are_right_for_readers_that_go_by_the_order(
        version, binary, scale, gmsh, tmp_path):
    """meshio takes values of nodes one after the other, Gmsh by their tags."""
    file, out = tmp_path / "in.msh", tmp_path / "out.msh"
    model = gmsh.model
    model.occ.fragment([(3, model.occ.addBox(0, 0, 0, 2, 1, 1))],
                       [(3, model.occ.addCylinder(1, 0.5, 0, 0, 0, 1, 0.3))])
    model.occ.synchronize()
    for dim in (2, 3):
        for _, tag in model.getEntities(dim):
            model.addPhysicalGroup(dim, [tag], 10 * dim + tag)
    for name, value in (("MeshSizeMax", 0.4), ("MshFileVersion", version), ("Binary", binary)):
        gmsh.option.setNumber(f"Mesh.{name}", value)
    model.mesh.generate(3)
    nodes, places, _ = model.mesh.getNodes()
    gmsh.option.setNumber("PostProcessing.SaveMesh", 0)
    gmsh.write(str(file))
    view = gmsh.view.add("heat")
    gmsh.view.addModelData(view, 0, model.getCurrent(), "NodeData", nodes,
                           (places.reshape(-1, 3) @ FIELD)[:, None])
    gmsh.view.write(view, str(file), append=True)
    words = ["remesh", str(file), str(out), "--scale", scale, "--free", "periodic"]
    assert cli.main(words) == 0
    mesh = meshio.read(out)
    assert len(mesh.points) != len(nodes)
    assert np.ravel(mesh.point_data["heat"]) == pytest.approx(mesh.points @ FIELD, abs=1e-12)
    gmsh.open(str(out))
    _, tags, values, _, _ = gmsh.view.getModelData(gmsh.view.getTags()[-1], 0)
    for tag, value in zip(tags.tolist(), values, strict=True):
        assert value[0] == pytest.approx(model.mesh.getNode(tag)[0] @ FIELD, abs=1e-12)


@pytest.mark.parametrize("scale", ["0.7", "1.5"])
def test_binary_files_of_version_2_with_links_are_read_by_meshio_where_nodes_went(
        scale, gmsh, tmp_path):
    """meshio reads no gaps between the numbers of nodes there."""
    file, out = tmp_path / "in.msh", tmp_path / "out.msh"
    model = gmsh.model
    model.occ.addRectangle(0, 0, 0, 1, 1)
    model.occ.synchronize()
    model.mesh.setPeriodic(1, [2], [4], [1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1])
    for name, value in (("MeshSizeMax", 0.15), ("MshFileVersion", 2.2), ("Binary", 1)):
        gmsh.option.setNumber(f"Mesh.{name}", value)
    model.mesh.generate(2)
    gmsh.write(str(file))
    assert cli.main(["remesh", str(file), str(out), "--scale", scale]) == 0
    before, after = meshio.gmsh.read(file), meshio.gmsh.read(out)
    assert len(after.points) != len(before.points)
    pairs, own = before.gmsh_periodic[0][3], after.gmsh_periodic[0][3]
    for side in (0, 1):
        assert np.array_equal(before.points[pairs[:, side]], after.points[own[:, side]])


@pytest.mark.parametrize(("version", "binary"), [(2.2, 0), (4.1, 1)])
def test_values_of_what_is_in_no_group_stay(version, binary, gmsh, tmp_path):
    """Gmsh stores a view on the whole model beside the elements and nodes of a group."""
    source, target = tmp_path / "a.msh", tmp_path / "b.msh"
    store(gmsh, source, version, binary)
    data = source.read_bytes()
    strange = [b"" if binary else b"999001 7.5 8.5 9.5\n", b"" if binary else b"999002 4.25\n"]
    if binary:
        strange = [np.array([(999001, [7.5, 8.5, 9.5])], "i4, (3,)f8").tobytes(),
                   np.array([(999002, 4.25)], "i4, f8").tobytes()]
    for name, row in zip((b"ElementData", b"NodeData"), strange, strict=True):
        head = re.search(rb"\$" + name + rb"\n(?:[^\n]*\n){5,9}?(\d\d+)\n", data)
        stop = data.index(b"\n" * binary + b"$End" + name, head.end())
        data = (data[:head.start(1)] + str(int(head[1]) + 1).encode() + data[head.end(1):stop]
                + row + data[stop:])
    source.write_bytes(data)
    mesh = read_file(source)
    assert np.array_equal(np.isnan(mesh.point_data["heat[0]"]), np.zeros(len(mesh.points), bool))
    with pytest.warns(DataNotKeptWarning, match="'corners"):
        optimize_file(source, target)
    text = target.read_bytes()
    assert all(text.count(row) == 1 for row in strange)


@pytest.mark.parametrize(("version", "binary"), [(2.2, 0), (2.2, 1), (4.1, 0), (4.1, 1)])
def test_a_mesh_that_is_there_with_every_view_is_one(version, binary, gmsh, tmp_path):
    """Gmsh appends the whole mesh with a view, unless it is told not to."""
    source, target = tmp_path / "a.msh", tmp_path / "b.msh"
    gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh.model.occ.synchronize()
    gmsh.model.addPhysicalGroup(3, [1], 1, "body")
    for name, value in (("MeshSizeMax", 0.4), ("Optimize", 0), ("MshFileVersion", version),
                        ("Binary", binary), ("SaveAll", 1)):
        gmsh.option.setNumber(f"Mesh.{name}", value)
    gmsh.option.setNumber("PostProcessing.SaveMesh", 1)
    gmsh.model.mesh.generate(3)
    # With elements that are in no group, which Gmsh leaves out beside a view.
    gmsh.write(str(source))
    nodes, places, _ = gmsh.model.mesh.getNodes()
    for name in ("one", "two"):
        view = gmsh.view.add(name)
        gmsh.view.addHomogeneousModelData(view, 0, gmsh.model.getCurrent(), "NodeData", nodes,
                                          places.reshape(-1, 3) @ FIELD)
        gmsh.view.write(view, str(source), append=True)
    assert source.read_bytes().count(b"$Nodes") == 3
    mesh = read_file(source)
    assert len(mesh.points) == len(nodes)
    optimize_file(source, target)
    assert target.read_bytes().count(b"$Nodes") == 1
    gmsh.clear()
    gmsh.open(str(target))
    tags, places, _ = gmsh.model.mesh.getNodes()
    assert len(tags) == len(nodes)
    there = dict(zip(tags.tolist(), places.reshape(-1, 3) @ FIELD, strict=True))
    views = gmsh.view.getTags()[-2:]
    assert [gmsh.view.option.getString(view, "Name") for view in views] == ["one", "two"]
    for view in views:
        _, own, values, _, _ = gmsh.view.getModelData(view, 0)
        assert np.allclose(np.ravel(values), [there[int(tag)] for tag in own])
    (tmp_path / "c.msh").write_bytes(source.read_bytes() + target.read_bytes())
    with pytest.raises(MeshFileError, match="of several different meshes, try a file for each"):
        read_file(tmp_path / "c.msh")


def test_what_only_gmsh_knows_is_named_where_it_is_lost(gmsh, tmp_path):
    store(gmsh, tmp_path / "a.msh", 4.1, 0)
    with pytest.warns(DataNotKeptWarning) as caught:
        write_file(tmp_path / "b.vtu", read_file(tmp_path / "a.msh"))
    said = str(caught[0].message)
    assert "the section MyOwn" in said
    assert "data of the corners of elements 'corners[0]'" in said
