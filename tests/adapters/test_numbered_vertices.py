"""Sets of vertices by number, where vertices came or went."""

from __future__ import annotations

import re

import meshio
import numpy as np
import pytest
from boxes import FACES, box, rim

from odt_plugins import remesh
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.api import optimize_file
from odt_plugins.errors import DataNotKeptWarning


def solid(n=4):
    """Vertices and cells of a box, and the triangles of its left side."""
    points, cells = box(3, n)
    sides = cells[:, FACES].reshape(-1, 3)
    return points, cells, sides[(points[sides][:, :, 0] == 0).all(axis=1)]


def rows(table):
    return "".join(" ".join(map(str, row)) + "\n" for row in table)


def mdpa(path):
    points, cells, left = solid()

    def part(name, kind, nodes, own):
        return (f"Begin SubModelPart {name}\nBegin SubModelPartNodes\n"
                f"{rows([[v + 1] for v in nodes])}End SubModelPartNodes\nBegin SubModelPart{kind}\n"
                f"{rows([[k + 1] for k in range(own)])}End SubModelPart{kind}\n"
                "End SubModelPart\n")

    path.write_text(
        "Begin Properties 1\nEnd Properties\nBegin Nodes\n"
        + rows([v + 1, *x] for v, x in enumerate(points.tolist()))
        + "End Nodes\nBegin Elements SmallDisplacementElement3D4N\n"
        + rows([k + 1, 1, *row] for k, row in enumerate((cells + 1).tolist()))
        + "End Elements\nBegin Conditions SurfaceLoadCondition3D3N\n"
        + rows([k + 1, 1, *row] for k, row in enumerate((left + 1).tolist()))
        + "End Conditions\n" + part("All", "Elements", range(len(points)), len(cells))
        + part("Left", "Conditions", np.unique(left).tolist(), len(left)))


def sections(path):
    """Rows of every section of Kratos, by the words behind the nested Begins."""
    out, stack = {}, []
    for line in path.read_text().splitlines():
        words = line.split()
        if words[:1] == ["Begin"]:
            stack.append(" ".join(words[1:]))
        elif words[:1] == ["End"]:
            stack.pop()
        elif words:
            out.setdefault("/".join(stack), []).append(words)
    return out


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("scale", [0.6, 1.5])
def test_parts_of_kratos_have_the_nodes_of_their_elements_and_conditions(scale, tmp_path):
    source, target = tmp_path / "a.mdpa", tmp_path / "b.mdpa"
    mdpa(source)
    write_file(target, remesh(read_file(source), scale=scale))
    told = sections(target)
    for part, kind, table in (
        ("All", "Elements", "Elements SmallDisplacementElement3D4N"),
        ("Left", "Conditions", "Conditions SurfaceLoadCondition3D3N"),
    ):
        nodes = {v for row in told[table] for v in row[2:]}
        own = [row[0] for row in told[f"SubModelPart {part}/SubModelPartNodes"]]
        assert sorted(own) == sorted(nodes)
        assert {row[0] for row in told[f"SubModelPart {part}/SubModelPart{kind}"]} == {
            row[0] for row in told[table]}


@pytest.mark.parametrize("scale", [0.6, 1.5])
def test_nodes_of_kratos_are_where_readers_that_go_by_the_order_expect_them(scale, tmp_path):
    """meshio ignores the numbers of nodes."""
    source, target = tmp_path / "a.mdpa", tmp_path / "b.mdpa"
    mdpa(source)
    text = source.read_text() + "Begin NodalData TEMPERATURE\n" + rows(
        [v + 1, 0, x] for v, (x, _, _) in enumerate(solid()[0].tolist())) + "End NodalData\n"
    text = text.replace("SmallDisplacementElement3D4N", "Tetrahedra3D4")
    source.write_text(text.replace("SurfaceLoadCondition3D3N", "Triangle3D3"))
    write_file(target, remesh(read_file(source), scale=scale))
    mesh, told = meshio.read(target), sections(target)
    x = mesh.points[mesh.cells_dict["tetra"]]
    size = np.einsum("ij,ij->i", np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), x[:, 3] - x[:, 0])
    assert abs(size.sum() / 6 - np.prod(np.ptp(mesh.points, axis=0))) < 1e-9
    left = np.unique(mesh.cells_dict["triangle"])
    assert np.allclose(mesh.points[left][:, 0], 0)
    part = [int(row[0]) - 1 for row in told["SubModelPart Left/SubModelPartNodes"]]
    assert sorted(part) == left.tolist()
    heat = np.array([[float(word) for word in row] for row in told["NodalData TEMPERATURE"]])
    assert heat[:, 0].tolist() == list(range(1, len(mesh.points) + 1))
    assert np.allclose(heat[:, 2], mesh.points[:, 0])


@pytest.mark.filterwarnings("error")
def test_node_sets_of_sides_take_no_nodes_that_come_inside(tmp_path):
    source, target = tmp_path / "a.inp", tmp_path / "b.inp"
    points, cells, left = solid()

    def lines(table):
        return "".join(", ".join(map(str, row)) + "\n" for row in table)

    sides = [np.flatnonzero(points[:, k] == x) + 1 for k in range(3) for x in (0, 1)]
    assert np.array_equal(sides[0] - 1, np.unique(left))
    source.write_text(
        "*NODE\n" + lines([v + 1, *x] for v, x in enumerate(points.tolist()))
        + "*ELEMENT, TYPE=C3D4, ELSET=ALL\n"
        + lines([k + 1, *row] for k, row in enumerate((cells + 1).tolist()))
        + "".join(f"*NSET, NSET=SIDE{k}\n" + lines([v] for v in side) for k, side in
                  enumerate(sides)) + "*NSET, NSET=ROW\n1, 2\n")
    report = optimize_file(source, target, insert=True)
    assert report.after.n_points > len(points)
    one, two = source.read_text(), target.read_text()
    assert one[one.index("*NSET"):] == two[two.index("*NSET"):]


@pytest.mark.filterwarnings("error")
def test_required_sections_of_medit_stay_where_vertices_came(tmp_path):
    source, target = tmp_path / "a.mesh", tmp_path / "b.mesh"
    points, cells, left = solid()
    tail = ("Corners\n2\n1 2\nRequiredVertices\n2\n3\n4\nRequiredTriangles\n2\n1\n4\n"
            "RequiredEdges\n1\n1\nRidges\n1\n1\nEnd\n")
    source.write_text(
        "MeshVersionFormatted 2\n# units: m\nDimension 3\nVertices\n" + f"{len(points)}\n"
        + rows([*x, v % 3] for v, x in enumerate(points.tolist()))
        + f"Edges\n1\n{left[0, 0] + 1} {left[0, 1] + 1} 7\nTriangles\n{len(left)}\n"
        + rows([*row, 4] for row in (left + 1).tolist()) + f"Tetrahedra\n{len(cells)}\n"
        + rows([*row, 1] for row in (cells + 1).tolist()) + tail)
    report = optimize_file(source, target, insert=True)
    assert report.after.n_points > len(points)
    text = target.read_text()
    assert text.endswith(tail)
    assert "# units: m\n" in text
    plain = tmp_path / "plain.mesh"
    plain.write_text(text[: text.index("Corners")] + "End\n")
    theirs = meshio.read(plain)
    corners = theirs.points[theirs.cells_dict["tetra"]]
    every = np.linalg.det(corners[:, 1:] - corners[:, :1])
    assert (every > 0).all()
    assert every.sum() == pytest.approx(6)
    assert np.array_equal(theirs.points[theirs.cells_dict["triangle"]], points[left])
    assert np.array_equal(theirs.points[:4], points[:4])
    assert np.array_equal(theirs.point_data["medit:ref"][: len(points)],
                          np.arange(len(points)) % 3)


def medit(path):
    """Words behind every section of a file of MEDIT."""
    found = re.split(r"([A-Z]\w+)\s", path.read_text())[1:]
    return {name: np.array(body.split(), float) for name, body in
            zip(found[::2], found[1::2], strict=True)}


@pytest.mark.parametrize("scale", [0.5, 1.7])
def test_corners_ridges_and_what_is_required_in_medit_follow_where_vertices_came_and_went(
        scale, tmp_path):
    source, target = tmp_path / "a.mesh", tmp_path / "b.mesh"
    points, cells = box(3, 6)
    sides = rim(cells)
    on = (points == 0) | (points == 1)
    edges = np.unique(np.sort(sides[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2), axis=0)
    ridge = (on[edges].all(axis=1) & (points[edges[:, 0]] == points[edges[:, 1]])).sum(axis=1) == 2
    line = ((points[edges] == [0.5, 0.5, 1])[:, :, 1:]).all(axis=(1, 2))
    lines = np.concatenate([edges[line], edges[ridge]])
    corners = np.flatnonzero(on.all(axis=1))
    held = np.flatnonzero((points[sides][:, :, 2] == 0).all(axis=1))[20:23]
    tops = np.unique(sides[(points[sides][:, :, 2] == 1).all(axis=1)])
    source.write_text(
        f"MeshVersionFormatted 2\nDimension 3\nRidges\n{ridge.sum()}\n"
        + rows([line.sum() + k + 1] for k in range(ridge.sum())) + f"Vertices\n{len(points)}\n"
        + rows([*x, 0] for x in points.tolist()) + f"Edges\n{len(lines)}\n"
        + rows([*row, 5 if k < line.sum() else 6] for k, row in enumerate((lines + 1).tolist()))
        + f"Triangles\n{len(sides)}\n" + rows([*row, 4] for row in (sides + 1).tolist())
        + f"Tetrahedra\n{len(cells)}\n" + rows([*row, 1] for row in (cells + 1).tolist())
        + "Corners\n8\n" + rows((corners + 1)[:, None]) + "RequiredTriangles\n3\n"
        + rows((held + 1)[:, None]) + "RequiredTetrahedra\n2\n9\n400\nRequiredEdges\n1\n2\n"
        + f"Normals\n1\n0 0 1\nNormalAtVertices\n{len(tops)}\n"
        + rows([v + 1, 1] for v in tops) + "End\n")
    with pytest.warns(DataNotKeptWarning, match="the sections NormalAtVertices, Normals;"):
        write_file(target, remesh(read_file(source), scale=scale, free=("periodic",)))
    out = medit(target)
    assert not {"Normals", "NormalAtVertices"} & set(out)
    x = out["Vertices"][1:].reshape(-1, 4)[:, :3]
    assert len(x) != len(points)

    def places(name, width, which):
        table = out[name][1:].reshape(-1, width)[:, :-1].astype(int) - 1
        return x[table if which is None else table[out[which][1:].astype(int) - 1]]

    ends = places("Edges", 3, "Ridges")
    assert np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).sum() == pytest.approx(12)
    assert (((ends == 0) | (ends == 1)).all(axis=1).sum(axis=1) == 2).all()
    assert out["Edges"][0] - out["Ridges"][0] == (out["Edges"][1:].reshape(-1, 3)[:, 2] == 5).sum()
    assert {*map(tuple, places("Triangles", 4, "RequiredTriangles").reshape(3, 9))} == {
        *map(tuple, points[sides[held]].reshape(3, 9))}
    assert {*map(tuple, places("Tetrahedra", 5, "RequiredTetrahedra").reshape(2, 12))} == {
        *map(tuple, points[cells[[8, 399]]].reshape(2, 12))}
    assert np.array_equal(places("Edges", 3, "RequiredEdges")[0], points[lines[1]])
    assert {*map(tuple, x[out["Corners"][1:].astype(int) - 1])} == {*map(tuple, points[corners])}
