"""SU2, TetGen and Kratos: what a run does not change stays byte for byte."""

from __future__ import annotations

import re
import warnings

import meshio
import numpy as np
import pytest
from boxes import FACES, box, quadratic, rim

from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.api import optimize_file
from odt_plugins.errors import DataNotKeptWarning, MeshFileError


def volumes(points, cells):
    x = np.asarray(points)[np.asarray(cells)]
    return np.linalg.det(x[:, 1:] - x[:, :1])


def real(x):
    return f"{x:.12E}".replace("E-", "D-") if abs(x) < 0.3 else repr(float(x))


def su2(path, dim, end="\n", index=True, last=False):
    points, cells = box(dim, 5)
    kind = 5 if dim == 2 else 10
    edges = rim(cells)
    low = (points[edges][:, :, 0] == 0).all(axis=1)
    body = [f"NELEM= {len(cells)}   % cells", *(
        f"{kind}\t" + " ".join(map(str, row)) + f"  {i}" * index
        for i, row in enumerate(cells.tolist()))]
    nodes = [f"NPOIN= {len(points)} {len(points)}", *(
        "  ".join(map(real, x)) + f" {i}" * index for i, x in enumerate(points.tolist()))]
    lines = ["% a comment", f"NDIME= {dim}", "NCHUNK= 1", *(body + nodes if last else nodes + body),
             "", "NMARK= 3"]
    for name, own in (("inlet", edges[low]), ("wall", edges[~low])):
        lines += [f"MARKER_TAG= {name}", f"MARKER_ELEMS= {len(own)}",
                  *(f"{3 if dim == 2 else 5} " + " ".join(map(str, row)) for row in own.tolist())]
    lines += ["MARKER_TAG= SEND_RECEIVE", "MARKER_ELEMS= 1", "SEND_RECV= 1", "1 0 0",
              "NPERIODIC= 1", "PERIODIC_INDEX= 0", "0.0 0.0 0.0", "% the end"]
    path.write_bytes((end.join(lines) + end).encode())
    return points, cells


def su2_told(path):
    """The file as these few lines read it."""
    lines = [line.partition("%")[0].split() for line in path.read_text().split("\n")]
    lines = [line for line in lines if line]
    found, i, marker = {}, 0, ""
    while i < len(lines):
        key = lines[i][0].rstrip("=")
        if key == "MARKER_TAG":
            marker = lines[i][1]
        if key in ("NPOIN", "NELEM", "MARKER_ELEMS"):
            count = int(lines[i][1])
            skip = lines[i + 1][0].startswith("SEND")
            found[key + marker] = lines[i + 1 + skip: i + 1 + skip + count]
            i += count + skip
        i += 1
    return found


@pytest.mark.parametrize(("dim", "end", "index"), [
    (2, "\n", True), (3, "\r\n", True), (3, "\n", False)])
def test_su2_keeps_markers_and_all_that_is_not_known(dim, end, index, tmp_path):
    source, target = tmp_path / "a.su2", tmp_path / "b.su2"
    points, cells = su2(source, dim, end, index)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mesh = read_file(source)
        write_file(target, mesh)
        assert target.read_bytes() == source.read_bytes()
        report = optimize_file(source, target)
    assert set(mesh.cell_sets) == {"inlet", "wall", "SEND_RECEIVE"}
    assert report.after.mean_quality > report.before.mean_quality
    old, new = source.read_bytes(), target.read_bytes()
    assert old.partition(b"NMARK")[2] == new.partition(b"NMARK")[2]
    assert old.partition(b"NPOIN")[0] == new.partition(b"NPOIN")[0]
    one, two = su2_told(source), su2_told(target)
    assert one["MARKER_ELEMSinlet"] == two["MARKER_ELEMSinlet"]
    assert len(two["NELEM"]) == report.after.n_cells
    x = np.array([[float(w.replace("D", "e")) for w in row[:dim]] for row in two["NPOIN"]])
    t = np.array([[int(w) for w in row[1: dim + 2]] for row in two["NELEM"]])
    assert (volumes(x, t) > 0).all()
    assert volumes(x, t).sum() == pytest.approx(volumes(points, cells).sum())
    stays = np.flatnonzero(((points <= 0) | (points >= 1)).any(axis=1)).tolist()
    assert [two["NPOIN"][i] for i in stays] == [one["NPOIN"][i] for i in stays]
    if index:
        assert [int(row[-1]) for row in two["NELEM"]] == list(range(len(t)))


def test_su2_that_meshio_would_misread_gets_plain_ends_of_lines(tmp_path):
    source, target = tmp_path / "a.su2", tmp_path / "b.su2"
    points, _ = su2(source, 3, "\r\n", last=True)
    text = source.read_bytes().replace(b"D-", b"E-")
    text = re.sub(rb"MARKER_TAG= SEND[\s\S]*", b"", text).replace(b"NMARK= 3", b"NMARK= 2")
    source.write_bytes(text.replace(b"   % cells", b"").replace(b" 216 216", b" 216"))
    with pytest.warns(DataNotKeptWarning, match="ends of lines"):
        optimize_file(source, target)
    assert b"\r" not in target.read_bytes()
    theirs = meshio.read(target)
    assert np.array_equal(theirs.points, read_file(target).points)
    stays = ((points <= 0) | (points >= 1)).any(axis=1)
    assert np.allclose(theirs.points[stays], points[stays], rtol=0, atol=1e-11)


@pytest.mark.parametrize(("dim", "first", "end"), [(3, 1, "\n"), (3, 0, "\r\n"), (2, 1, "\n")])
def test_tetgen_keeps_attributes_and_the_files_beside(dim, first, end, tmp_path):
    points, cells = box(dim, 5)
    label = 1.0 + (points[cells].mean(axis=1)[:, 0] > 0.5)
    lines = ["# points", f"{len(points)}  {dim} 1 1"]
    lines += [f"  {i + first}\t" + " ".join(map(real, x)) + f"  0.{i} {i % 2}"
              for i, x in enumerate(points.tolist())]
    (tmp_path / "a.node").write_bytes((end.join([*lines, "# the end"]) + end).encode())
    lines = [f"{len(cells)} {dim + 1} 1", *(
        f"{i + first}  " + "  ".join(str(v + first) for v in row) + f"  {label[i]}"
        for i, row in enumerate(cells.tolist()))]
    (tmp_path / "a.ele").write_bytes((end.join([*lines, "# by hand"]) + end).encode())
    every = np.unique(np.sort(cells[:, FACES], axis=2).reshape(-1, 3), axis=0) if dim == 3 else []
    outer = {tuple(row) for row in np.sort(rim(cells), axis=1).tolist()}
    if dim == 3:
        rows = [f"{i + first} " + " ".join(str(v + first) for v in row)
                + f" {7 if tuple(row) in outer else 0}" for i, row in enumerate(every.tolist())]
        (tmp_path / "a.face").write_bytes((end.join([f"{len(rows)} 1", *rows]) + end).encode())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_file(tmp_path / "b.ele", read_file(tmp_path / "a.node"))
    for suffix in ("node", "ele", "face")[: dim]:
        assert (tmp_path / f"b.{suffix}").read_bytes() == (tmp_path / f"a.{suffix}").read_bytes()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataNotKeptWarning)
        report = optimize_file(tmp_path / "a.ele", tmp_path / "b.ele")
    assert report.after.mean_quality > report.before.mean_quality
    old, new = ((tmp_path / f"{name}.node").read_bytes().split(b"\n") for name in "ab")
    assert [line.split()[-1:] for line in old] == [line.split()[-1:] for line in new]
    same = [a for a, b in zip(old, new, strict=True) if a.split()[:-2] == b.split()[:-2]]
    assert len(same) < len(old)
    assert set(same) <= set(new)
    assert not [w for w in caught if "attr1" in str(w.message)]
    assert sum(a != b for a, b in zip(old, new, strict=True)) <= (
        (points > 0) & (points < 1)).all(axis=1).sum()
    text = (tmp_path / "b.ele").read_text()
    table = [line.partition("#")[0].split() for line in text.split("\n")]
    head, *rows = [row for row in table if row]
    assert head == [str(len(rows)), str(dim + 1), "1"]
    assert [int(row[0]) for row in rows] == list(range(first, first + len(rows)))
    x = np.array([[float(w.replace(b"D", b"e")) for w in line.split()[1: dim + 1]]
                  for line in new if line.split() and not line.startswith(b"#")][1:])
    t = np.array([[int(w) for w in row[1: dim + 2]] for row in rows]) - first
    assert (volumes(x, t) > 0).all()
    for value in (1.0, 2.0):
        mine = np.array([float(row[-1]) for row in rows]) == value
        assert volumes(x, t[mine]).sum() == pytest.approx(
            volumes(points, cells[label == value]).sum())
    if dim == 3:
        text = (tmp_path / "b.face").read_text()
        head, *rows = [line.split() for line in text.split("\n") if line]
        assert int(head[0]) == len(rows)
        marked = {tuple(sorted(int(w) - first for w in row[1:4])) for row in rows if row[4] == "7"}
        assert marked == outer
        there = {tuple(face) for face in np.sort(t[:, FACES], axis=2).reshape(-1, 3).tolist()}
        assert all(tuple(sorted(int(w) - first for w in row[1:4])) in there for row in rows)


@pytest.mark.parametrize(("name", "text", "said"), [
    ("a.su2", "NZONE= 2\nNDIME= 2\n", "2 zones"),
    ("a.su2", "NDIME= 2\nNPOIN= 3\n0 0\n0 1\n1 0\nNELEM= 1\n5 0 1 3\n", "refers to 3"),
    ("a.su2", "NDIME= 2\nNPOIN= 3\n0 0\n0 1\n1 0\nNELEM= 1\n77 0 1 3\n", "cells of type 77"),
    ("a.node", "3 3 0 0\n1 0 0 0\n2 0 0 0\n4 0 0 0\n", "not numbered one after another"),
])
def test_what_is_not_whole_is_refused(name, text, said, tmp_path):
    (tmp_path / "a.ele").write_text("1 4 0\n1 1 2 3 3\n")
    (tmp_path / name).write_text(text)
    with pytest.raises(MeshFileError, match=said):
        read_file(tmp_path / name)




@pytest.mark.parametrize(("text", "said"), [
    ("hello\n", "it has no section; expected a file that is one of mdpa"),
    ("Begin Nodes\n1 0 0 0\n", "it ends within Nodes; expected a complete file")])
def test_what_is_no_mdpa_or_half_of_one_is_told(text, said, tmp_path):
    (tmp_path / "a.mdpa").write_text(text)
    with pytest.raises(MeshFileError, match=said):
        read_file(tmp_path / "a.mdpa")


def mdpa(path, order, end="\n"):
    points, cells = box(3, 5 if order == 1 else 4)
    steel = points[cells].mean(axis=1)[:, 0] < 0.5
    x, nodes = (points, cells) if order == 1 else quadratic(points, cells)
    outer = rim(cells)
    low = (points[outer][:, :, 2] == 0).all(axis=1)
    bottom = np.flatnonzero(x[:, 2] == 0)
    lines = ["Begin ModelPartData", "//  VARIABLE_NAME value", "End ModelPartData", "",
             "Begin Properties 1", "  DENSITY 7850.0", "End Properties", "Begin Properties 2",
             "End Properties", "", "Begin Nodes"]
    lines += [f"\t{2 * i + 1}  " + "  ".join(map(real, v)) for i, v in enumerate(x.tolist())]
    name = f"SmallDisplacementElement3D{nodes.shape[1]}N"
    lines += ["End Nodes", "", f"Begin Elements {name}// group"]
    lines += [f"  {i + 5}  {1 if steel[i] else 2}  " + " ".join(str(2 * v + 1) for v in row)
              for i, row in enumerate(nodes.tolist())]
    lines += ["End Elements", "Begin Conditions SurfaceLoadCondition3D3N"]
    lines += [f" {i + 1} 0 " + " ".join(str(2 * v + 1) for v in row)
              for i, row in enumerate(outer[low].tolist())]
    lines += ["End Conditions", "Begin NodalData TEMPERATURE // id fixed value"]
    lines += [f"{2 * i + 1} 0 {v[0] + 2 * v[1]!r}" for i, v in enumerate(x.tolist())]
    lines += ["End NodalData", "Begin NodalData DISPLACEMENT_X"]
    lines += [f"{2 * i + 1} 1 0.0" for i in bottom.tolist()]
    lines += ["End NodalData", "Begin ElementalData ORIGIN_ID"]
    lines += [f"{i + 5} {10 if steel[i] else 20}" for i in range(len(cells))]
    lines += ["End ElementalData", "Begin SubModelPart Steel"]
    for name, own in (("Nodes", 2 * np.unique(nodes[steel]) + 1),
                      ("Elements", np.flatnonzero(steel) + 5)):
        lines += [f"  Begin SubModelPart{name}", *(f"    {i}" for i in own.tolist()),
                  f"  End SubModelPart{name}"]
    lines += ["  Begin SubModelPart Foot", "    Begin SubModelPartConditions", "      1", "      2",
              "    End SubModelPartConditions", "  End SubModelPart", "End SubModelPart", "// end"]
    path.write_bytes((end.join(lines) + end).encode())
    return points, cells, steel


def mdpa_told(path):
    found, stack = {}, []
    for line in path.read_text().split("\n"):
        words = line.partition("//")[0].split()
        if words[:1] == ["Begin"]:
            stack.append(" ".join(words[1:]))
        elif words[:1] == ["End"]:
            stack.pop()
        elif words:
            found.setdefault("/".join(stack), []).append(words)
    return found


@pytest.mark.parametrize(("order", "end"), [(1, "\n"), (2, "\r\n")])
def test_kratos_keeps_properties_conditions_parts_and_data(order, end, tmp_path):
    source, target = tmp_path / "a.mdpa", tmp_path / "b.mdpa"
    points, cells, steel = mdpa(source, order, end)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mesh = read_file(source)
        write_file(target, mesh)
    assert target.read_bytes() == source.read_bytes()
    main = "tetra" if order == 1 else "tetra10"
    assert [block.type for block in mesh.cells] == [main, "triangle"]
    assert set(mesh.cell_sets) == {"Steel", "Steel.Foot"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataNotKeptWarning)
        report = optimize_file(source, target)
    assert report.after.mean_quality > report.before.mean_quality
    one, two = mdpa_told(source), mdpa_told(target)
    old, new = source.read_bytes(), target.read_bytes()
    assert old.partition(b"Begin Nodes")[0] == new.partition(b"Begin Nodes")[0]
    body = [part[part.index(b"Begin Conditions"): part.index(b"End Conditions")]
            for part in (old, new)]
    assert body[0] == body[1]
    assert [key for key in one] == [key for key in two]
    key = next(key for key in one if key.startswith("Elements"))
    assert one[key] != two[key]
    x = {row[0]: [float(w.replace("D", "e")) for w in row[1:4]] for row in two["Nodes"]}
    assert len({row[0] for row in two[key]}) == len(two[key]) == report.after.n_cells
    data = dict(two["ElementalData ORIGIN_ID"])
    part = {row[0] for row in two["SubModelPart Steel/SubModelPartElements"]}
    assert set(data) == {row[0] for row in two[key]}
    for own, ref, mark in ((steel, "1", "10"), (~steel, "2", "20")):
        rows = [row for row in two[key] if row[1] == ref]
        assert {data[row[0]] for row in rows} == {mark}
        assert all((row[0] in part) == (ref == "1") for row in rows)
        corners = np.array([[x[v] for v in row[2:6]] for row in rows])
        every = np.linalg.det(corners[:, 1:] - corners[:, :1])
        assert (every > 0).all()
        assert every.sum() == pytest.approx(volumes(points, cells[own]).sum())
    used = {v for row in two[key] for v in row[2:]}
    assert used == set(x)
    assert {row[0] for row in two["SubModelPart Steel/SubModelPartNodes"]} == {
        v for row in two[key] if row[1] == "1" for v in row[2:]}
    for name in ("NodalData DISPLACEMENT_X",
                 "SubModelPart Steel/SubModelPart Foot/SubModelPartConditions"):
        assert one[name] == two[name]
    for v, _, value in two["NodalData TEMPERATURE"]:
        assert float(value) == pytest.approx(x[v][0] + 2 * x[v][1])
    assert {row[0] for row in two["NodalData TEMPERATURE"]} == set(x)


@pytest.mark.filterwarnings("error")
def test_markers_of_points_that_stay_are_not_called_lost(tmp_path):
    points, cells = box(3, 3)
    marks = ((points == 0) | (points == 1)).any(axis=1).astype(int).tolist()
    node = "".join(f"{k} {x!r} {y!r} {z!r} {marks[k]}\n" for k, (x, y, z) in
                   enumerate(points.tolist()))
    (tmp_path / "a.node").write_text(f"{len(points)} 3 0 1\n{node}")
    (tmp_path / "a.ele").write_text(f"{len(cells)} 4 0\n" + "".join(
        f"{k} {' '.join(map(str, row))}\n" for k, row in enumerate(cells.tolist())))
    optimize_file(tmp_path / "a.node", tmp_path / "b.node")
    lines = (tmp_path / "b.node").read_text().splitlines()[1: 1 + len(points)]
    assert [int(line.split()[4]) for line in lines] == marks
