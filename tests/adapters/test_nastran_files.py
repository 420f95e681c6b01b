"""Nastran's decks: what does not change stays byte for byte, loads stay on their faces."""

from __future__ import annotations

import re
import warnings

import meshio
import numpy as np
import pytest
from boxes import FACES, box, quadratic

from odt_plugins import remesh
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.api import optimize_file
from odt_plugins.errors import DataNotKeptWarning, MeshFileError


def card(style, name, words):
    """A card in one of the styles that Nastran knows."""
    if style == "free":
        lines = [words[k: k + 8] for k in range(0, len(words), 8)]
        return [",".join([name if k == 0 else "+", *line]) for k, line in enumerate(lines)]
    if style == "tabs":
        lines = [words[k: k + 8] for k in range(0, len(words), 8)]
        return ["\t".join([name if k == 0 else "+", *line]) for k, line in enumerate(lines)]
    if style == "large":
        lines = [words[k: k + 4] for k in range(0, len(words), 4)]
        return [(f"{name}*" if k == 0 else "*").ljust(8) + "".join(f"{w:>16}" for w in line)
                for k, line in enumerate(lines)]
    side = "<" if style == "left" else ">"
    lines = [words[k: k + 8] for k in range(0, len(words), 8)]
    return [(f"{name:<8}" if k == 0 else f"+{k:<7}") + "".join(f"{w:{side}8}" for w in line)
            + (f"+{k + 1:<7}" if k + 1 < len(lines) else "") for k, line in enumerate(lines)]


def number(v, style):
    if style == "tabs":
        return f"{v:.4f}"
    text = f"{v:.9f}" if style == "large" else f"{v:.5f}"
    return text.replace("0.", ".", 1) if v < 0.3 else f"{v * 10:.3f}-1"


def real(text):
    return float(re.sub(r"(?<=[\d.])[dDeE]?(?=[+-]\d+$)", "e", text.strip()).replace("D", "e") or 0)


def cards(path):
    """Fields of all cards, by these few lines, and the lines of the file of each."""
    text = path.read_bytes().decode().replace("\r", "")
    out = []
    for line in text.partition("BEGIN BULK\n")[2].split("\n"):
        body = line.split("$")[0].rstrip()
        if not body:
            continue
        if "," in body:
            words = body.split(",")
        else:
            body = body.expandtabs(8)
            ends = [0, 8, 24, 40, 56, 72] if "*" in body[:8] else range(0, 73, 8)
            words = [body[a:b] for a, b in zip(ends, [*ends][1:], strict=False)]
            words = [w for k, w in enumerate(words) if [*ends][k] < len(body)]
        words = [w.strip() for w in words]
        if words[0] in ("", "+", "*") or words[0][0] in "+*":
            width = 4 if "*" in words[0] else 8
            out[-1] += [""] * (-(len(out[-1]) - 1) % width) + words[1:]
        else:
            out.append([words[0].rstrip("*"), *words[1:]])
    return out


def told(path):
    found = cards(path)
    nodes = {int(c[1]): [real(x) for x in c[3:6]] for c in found if c[0] == "GRID"}
    cells = {int(c[1]): (c[0], int(c[2]), [int(w) for w in c[3:] if w]) for c in found
             if c[0] in ("CTETRA", "CTRIA3", "CQUAD4")}
    loads = []
    for c in found:
        if c[0] == "PLOAD4":
            nodes_ = cells[int(c[2])][2][:4]
            assert int(c[7]) in nodes_
            loads.append((tuple(sorted(set(nodes_) - {int(c[8])})), c[3]))
    rest = [c for c in found if c[0] not in ("GRID", "CTETRA", "CTRIA3", "PLOAD4")]
    return nodes, cells, sorted(loads), rest


def deck(path, style, end="\n", order=1):
    points, cells = box(3, 4)
    points = np.round(points, 5)
    steel = points[cells].mean(axis=1)[:, 0] < 0.5
    x, nodes = (points, cells) if order == 1 else quadratic(points, cells)
    x = np.round(x, 5)
    lines = ["SOL 101", "CEND", "TITLE = a, box", "SET 1 = 1 THRU 5, 7", "LOAD = 3", "BEGIN BULK",
             "PARAM,POST,-1", "$ nodes"]
    for i, v in enumerate(x.tolist()):
        words = [str(i + 1), "", *(number(c, style) for c in v)]
        lines += card(style, "GRID", words + (["", "123"] if style == "right" and i < 3 else []))
    lines += ["$ cells   with , a comma", ""]
    for i, row in enumerate((nodes + 1).tolist()):
        lines += card(style, "CTETRA", [str(i + 101), str(7 if steel[i] else 9), *map(str, row)])
    seen = {}
    for c, cell in enumerate(cells.tolist()):
        for face in FACES:
            key = tuple(sorted(cell[v] for v in face))
            seen.setdefault(key, []).append((c, next(v for v in cell if v not in key)))
    for key, found in seen.items():
        if len(found) == 1 and (points[list(key)][:, 2] == 1).all():
            c, away = found[0]
            lines += card("right", "PLOAD4", ["3", str(c + 101), "1.5", "", "", "", str(key[0] + 1),
                                              str(away + 1)])
    quad = [np.flatnonzero((abs(x - p) < 1e-9).all(axis=1))[0] + 1
            for p in ([0, 0, 0], [0.25, 0, 0], [0.25, 0.25, 0], [0, 0.25, 0])]
    middle = int(np.flatnonzero(((points > 0.3) & (points < 0.7)).all(axis=1))[0]) + 1
    lines += ["PSOLID  7       1       $ steel", "PSOLID  9       2",
              "MAT1    1       2.1+11          .3", "MAT1,2,1.+6,,.45", "SPC1    1       123     1"
              "       THRU    5", f"FORCE   3       {middle:<8}0       1.      1.      0.      0.",
              "CQUAD4  5       3       " + "".join(f"{v:<8}" for v in quad),
              "ENDDATA", "what follows is not read"]
    path.write_bytes((end.join(lines) + end).encode())
    return points, cells, middle


def around(data):
    """Lines that are of no card that may change."""
    out, own = [], False
    for line in data.splitlines(keepends=True):
        if not re.match(rb"[+*, \t]", line):
            own = line.startswith((b"GRID", b"CTETRA", b"PLOAD4"))
        if not own:
            out.append(line)
    return out


@pytest.mark.parametrize(("style", "end", "order"), [
    ("right", "\n", 1), ("left", "\r\n", 2), ("free", "\n", 2), ("large", "\r\n", 2),
    ("tabs", "\n", 1)])
def test_all_else_stays_and_loads_stay_on_their_faces(style, end, order, tmp_path):
    source, target = tmp_path / "a.bdf", tmp_path / "b.bdf"
    _, _, middle = deck(source, style, end, order)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_file(target, read_file(source))
    assert target.read_bytes() == source.read_bytes()
    with pytest.warns(DataNotKeptWarning, match="last digits of the coordinates"):
        report = optimize_file(source, target)
    assert report.after.mean_quality > report.before.mean_quality
    old, new = source.read_bytes(), target.read_bytes()
    assert around(old) == around(new)
    assert new.count(b"\r\n") == (new.count(b"\n") if end == "\r\n" else 0)
    (nodes, cells, loads, rest), (nodes2, cells2, loads2, rest2) = told(source), told(target)
    assert rest == rest2
    assert loads == loads2
    assert nodes2[middle] == nodes[middle]
    assert cells != cells2
    assert cells2[5] == cells[5]
    assert {v for _, _, row in cells2.values() for v in row} == set(nodes2)
    for label in (7, 9):
        volumes = []
        for x, found in ((nodes, cells), (nodes2, cells2)):
            tets = np.array([[x[v] for v in row[:4]] for name, pid, row in found.values()
                             if pid == label])
            volumes.append(np.linalg.det(tets[:, 1:] - tets[:, :1]) / 6)
            assert (volumes[-1] > 0).all()
        assert volumes[0].sum() == pytest.approx(volumes[1].sum())
    same = [line for line in new.splitlines() if line.startswith(b"GRID*")]
    if style != "large":
        assert 0 < len(same) < len(nodes2)
    assert all(len(line.rstrip(b"\r\n")) <= 80 for line in new.splitlines() if b"GRID*" in line)


@pytest.mark.parametrize(("style", "scale", "order"), [
    ("right", 0.7, 1), ("large", 1.6, 1), ("tabs", 1.6, 2)])
def test_loads_follow_where_elements_come_and_go(style, scale, order, tmp_path):
    source, target = tmp_path / "a.bdf", tmp_path / "b.bdf"
    deck(source, style, order=order)
    data = source.read_bytes()
    again = [line.replace("3", "4", 1).replace("1.5", "2.5", 1) for line in data.decode().split(
        "\n") if line.startswith("PLOAD4")]
    source.write_bytes(data.replace(b"ENDDATA", "\n".join([*again, "ENDDATA"]).encode()))
    with pytest.warns(DataNotKeptWarning) as caught:
        write_file(target, remesh(read_file(source), scale=scale, free=("periodic",)))
    assert [w for w in caught if "last digits" not in str(w.message)] == []
    assert around(target.read_bytes()) == around(source.read_bytes())
    nodes, _, loads, _ = told(target)
    for value in ("1.5", "2.5"):
        x = np.array([[nodes[v] for v in face] for face, of in loads if of == value])
        assert len(x) != len(again)
        assert abs(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])).sum() / 2 == pytest.approx(
            1, abs=1e-4)
        assert np.allclose(x[:, :, 2], 1, atol=1e-4)
    firsts = {(int(c[2]), int(c[7])) for c in cards(target) if c[0] == "PLOAD4"}
    cells = told(target)[1]
    assert all(v in cells[i][2] for i, v in firsts)


@pytest.mark.parametrize("by_card", [False, True])
def test_new_points_between_constrained_ones_are_constrained_or_do_not_come(by_card, tmp_path):
    points, cells = box(3, 4)
    lines = ["BEGIN BULK", *(f"GRID,{i + 1},,{v[0]:.6f},{v[1]:.6f},{v[2]:.6f}"
                             for i, v in enumerate(points.tolist()))]
    lines += ["CTETRA," + ",".join(map(str, [i + 1, 1, *row])) for i, row in
              enumerate((cells + 1).tolist())]
    foot = (np.flatnonzero(points[:, 2] == 0) + 1).tolist()
    lines += [f"SPC,1,{i},123,0." for i in foot] if by_card else [
        f"SPC1,1,123,{','.join(map(str, foot[k: k + 6]))}" for k in range(0, len(foot), 6)]
    source, target = tmp_path / "a.bdf", tmp_path / "b.bdf"
    source.write_text("\n".join([*lines, "ENDDATA", ""]))
    with pytest.warns(DataNotKeptWarning, match="last digits"):
        write_file(target, remesh(read_file(source), scale=0.6, free=("periodic",)))
    found = cards(target)
    nodes = {int(c[1]): [real(x) for x in c[3:6]] for c in found if c[0] == "GRID"}
    assert len(nodes) > 1.5 * len(points)
    held = {int(c[2]) for c in found if c[0] == "SPC"} | {
        int(w) for c in found if c[0] == "SPC1" for w in c[3:] if w}
    assert held == {i for i, x in nodes.items() if abs(x[2]) < 1e-12}
    assert held >= set(foot)


@pytest.mark.parametrize("scale", [0.6, 1.7])
def test_loads_on_shells_follow_and_meet_where_they_met(scale, tmp_path):
    points, cells = box(2, 8, plane=0.5)
    left = points[cells].mean(axis=1)[:, 0] < 0.5
    cells = np.concatenate([cells[left], cells[~left]])
    m, half = len(cells), int(left.sum())
    lines = ["BEGIN BULK", *(f"GRID,{i + 1},,{v[0]:.6f},{v[1]:.6f},0." for i, v in
                             enumerate(points.tolist()))]
    lines += [f"CTRIA3,{i + 1},1,{a},{b},{c}" for i, (a, b, c) in enumerate((cells + 1).tolist())]
    lines += [f"PLOAD2  3       2.5     1       THRU    {half}",
              f"PLOAD4,4,{half + 1},1.5,,,,THRU,{m}"]
    lines += [f"PLOAD2,5,7.5,{','.join(map(str, range(k, min(k + 6, half + 1))))}"
              for k in range(1, half + 1, 6)]
    lines += [f"BSURF   9       1       THRU    {half}", f"SET3,11,ELEM,1,THRU,{half},BY,1",
              "PSHELL,1,1,.1", "ENDDATA", ""]
    source, target = tmp_path / "a.bdf", tmp_path / "b.bdf"
    source.write_text("\n".join(lines))
    mesh = read_file(source)
    assert {"PLOAD2_3_2.5", "PLOAD4_4_1.5", "PLOAD2_5_7.5", "BSURF_9", "SET3_11"} == set(
        mesh.cell_sets)
    with pytest.warns(DataNotKeptWarning) as caught:
        write_file(target, remesh(mesh, scale=scale))
    assert [w for w in caught if "last digits" not in str(w.message)] == []
    nodes = {int(c[1]): [real(x) for x in c[3:6]] for c in cards(target) if c[0] == "GRID"}
    shells = {int(c[1]): [int(w) for w in c[3:6]] for c in cards(target) if c[0] == "CTRIA3"}
    assert len(shells) != m
    own = {}
    for c in cards(target):
        if c[0] in ("PLOAD2", "PLOAD4", "BSURF", "SET3"):
            words = c[2:3] if c[0] == "PLOAD4" else [w for w in c[2:] if w.isdigit()]
            own.setdefault((c[0], c[1]), []).extend(map(int, words))
            assert c[0] != "PLOAD4" or "THRU" not in c
    for (name, _), ids in own.items():
        x = np.array([[nodes[v] for v in shells[i]] for i in ids])
        assert len(set(ids)) == len(ids)
        assert np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1).sum() / 2 == (
            pytest.approx(0.5, abs=1e-4))
        assert ((x[:, :, 0] - 0.5) * (1 if name == "PLOAD4" else -1) > -1e-4).all()
    assert len(own) == 5


@pytest.mark.parametrize("style", ["right", "large"])
def test_other_readers_see_the_same_mesh(style, tmp_path):
    gmsh = pytest.importorskip("gmsh")
    source, target = tmp_path / "a.bdf", tmp_path / "b.bdf"
    deck(source, style)
    with pytest.warns(DataNotKeptWarning):
        optimize_file(source, target)
    nodes, cells, _, _ = told(target)
    mine = read_file(target)
    assert np.array_equal(mine.points, np.array(list(nodes.values())))
    text = target.read_text().split("ENDDATA")[0]
    text = re.sub(r"(?m)^(PLOAD4|FORCE|SPC1|CQUAD4|PSOLID|MAT1|PARAM).*\n", "", text) + "ENDDATA\n"
    target.write_text(text)
    if style == "right":
        theirs = meshio.nastran.read(target)
        assert np.allclose(theirs.points, mine.points, rtol=0, atol=1e-15)
        assert np.array_equal(theirs.cells_dict["tetra"], mine.cells_dict["tetra"])
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add("deck")
        gmsh.open(str(target))
        tags, _ = gmsh.model.mesh.getElementsByType(4)
        _, coords, _ = gmsh.model.mesh.getNodes()
    finally:
        gmsh.finalize()
    assert sorted(tags.tolist()) == sorted(i for i, c in cells.items() if c[0] == "CTETRA")
    assert np.allclose(np.sort(coords), np.sort(np.ravel(list(nodes.values()))), atol=1e-9)


def test_cells_of_second_order_as_meshio_names_them_are_read(tmp_path):
    source, target = tmp_path / "a.bdf", tmp_path / "b.bdf"
    points, cells = quadratic(*box(3, 3))
    sides = np.unique(cells[:, [0, 1, 2, 4, 5, 6]], axis=0)
    meshio.write(source, meshio.Mesh(points, [("triangle6", sides), ("tetra10", cells)]))
    assert b"CTETRA_" in source.read_bytes()
    assert np.array_equal(read_file(source).cells_dict["tetra10"], cells)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataNotKeptWarning)
        optimize_file(source, target)
    assert "tetra10" in meshio.nastran.read(target).cells_dict


def test_points_in_a_system_of_their_own_stay_where_it_puts_them(tmp_path):
    points, cells = box(3, 4)
    inner = int(np.flatnonzero(((points > 0.3) & (points < 0.7)).all(axis=1))[0])
    lines = ["BEGIN BULK", "CORD2C,4,,0.5,0.,0.,.5,0.,1.", "+,1.5,0.,0."]
    for i, v in enumerate(points.tolist()):
        if i == inner:
            r = np.hypot(v[0] - 0.5, v[1])
            v = [r, np.degrees(np.arctan2(v[1], v[0] - 0.5)), v[2]]
        lines += [f"GRID*   {i + 1:>16}{4 if i == inner else 0:>16}{v[0]:16.12f}{v[1]:16.12f}",
                  f"*       {v[2]:16.12f}"]
    lines += ["CTETRA," + ",".join(map(str, [i + 1, 1, *row])) for i, row in
              enumerate((cells + 1).tolist())]
    source, target = tmp_path / "a.nas", tmp_path / "b.nas"
    source.write_text("\n".join([*lines, "ENDDATA", ""]))
    assert np.allclose(read_file(source).points, points, atol=1e-10)
    with pytest.warns(DataNotKeptWarning, match="last digits"):
        optimize_file(source, target)
    kept = next(i for i, line in enumerate(lines) if line.startswith(f"GRID*   {inner + 1:>16}"))
    assert target.read_text().split("\n")[kept: kept + 2] == lines[kept: kept + 2]
    assert target.read_text() != source.read_text()


def test_shells_keep_their_angles_and_quadrilaterals_beside_stay(tmp_path):
    points, cells = box(2, 6)
    lines = ["BEGIN BULK"]
    lines += [f"GRID    {i + 1:<8}        {v[0]:<8.5f}{v[1]:<8.5f}{0:<8.1f}" for i, v in
              enumerate(points.tolist())]
    lines += ["CTRIA3  " + "".join(f"{w:<8}" for w in [i + 1, 1, *row]) + "30." for i, row in
              enumerate((cells + 1).tolist())]
    source, target = tmp_path / "a.dat", tmp_path / "b.dat"
    source.write_text("\n".join([*lines, "PSHELL,1,1,.1", "ENDDATA", ""]))
    with pytest.warns(DataNotKeptWarning, match="last digits"):
        report = optimize_file(source, target)
    assert report.after.mean_quality > report.before.mean_quality
    found = [line for line in target.read_text().split("\n") if line.startswith("CTRIA3")]
    assert len(found) == len(cells)
    assert all(line[48:] == "30." for line in found)
    assert found != [line for line in lines if line.startswith("CTRIA3")]


@pytest.mark.parametrize(("text", "said"), [
    ("BEGIN BULK\nGRID,1,,0.,0.,0.\n", "ends before ENDDATA"),
    ("BEGIN BULK\nGRID,1,,0.,0.,0.\nCTRIA3,1,1,1,2,3\nENDDATA\n", "refers to 2"),
    ("BEGIN BULK\nGRID,1,5,0.,0.,0.\nGRID,2,,0.,0.,0.\nENDDATA\n", "coordinate system 5"),
])
def test_what_is_missing_is_told(text, said, tmp_path):
    (tmp_path / "a.bdf").write_text(text)
    with pytest.raises(MeshFileError, match=said):
        read_file(tmp_path / "a.bdf")


def test_what_a_card_names_stays(tmp_path):
    points, cells = box(3, 6)
    inner = (np.flatnonzero(((points > 0) & (points < 1)).all(axis=1)) + 1).tolist()
    patterns = [
        "TEMP,1,@,20.,@,30.,@,4.", "SLOAD,1,@,5.,@,6.", "DAREA,1,@,3,1.,@,3,1.", "ASET,@,123,@,3",
        "OMIT,@,123,@,3,@,1", "SUPORT,@,123", "SUPORT1,1,@,123,@,3", "QSET1,123,@,@,@",
        "CSET1,123,@,THRU,@", "MPC,1,@,9,1.,@,9,-1.,,\n+,,@,9,2.", "RBE2,1,@,9,@,@,@",
        "CONM2,9001,@,0,1.", "PLOTEL,9002,@,@", "CBUSH,9003,1,@,@", "CELAS2,9004,1.5,@,9,@,9",
        "CMASS2,9005,1.5,@,9", "CBAR,9006,1,1,2,@", "FORCE1,1,@,1.,@,@", "SPCD,1,@,9,1.,@,9,1.",
        "RFORCE,1,@,,1.,0.,0.,1.", "DMIG,K,@,9,,@,9,1.", "CWHAT,9007,1,@,@", "RBAR,9008,@,@",
        "SET1,4,@,@", "CORD1R,8,@,@,@", "EIGR,1,MGIV,0.,1.,,2,,,\n+,POINT,@,9",
        "TIC,1,@,9,1.", "MOMENT,1,@,0,1.,0.,0.,1.", "BSET,@,9", "NOLIN1,1,@,9,1.,@,9,3"]
    free, named, extra = iter(inner[::2]), [], []
    for pattern in patterns:
        parts = pattern.split("@")
        own = [next(free) for _ in parts[1:]]
        extra.append(parts[0] + "".join(f"{i}{part}" for i, part in zip(own, parts[1:],
                                                                        strict=True)))
        named += range(own[0], own[1] + 1) if "THRU" in pattern else own
    lines = ["BEGIN BULK", *(f"GRID,{i + 1},,{v[0]:.6f},{v[1]:.6f},{v[2]:.6f}"
                             for i, v in enumerate(points.tolist()))]
    lines += ["CTETRA," + ",".join(map(str, [i + 1, 1, *row])) for i, row in
              enumerate((cells + 1).tolist())]
    source, target = tmp_path / "a.bdf", tmp_path / "b.bdf"
    source.write_text("\n".join([*lines, *extra, "ENDDATA", ""]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataNotKeptWarning)
        mesh = read_file(source)
        report = optimize_file(source, target)
    assert (mesh.held + 1).tolist() == sorted(named)
    assert f"{len(named)} vertices named by its file stay where they" in " ".join(report.notes)
    old, new = told(source)[0], told(target)[0]
    assert {i for i in named if old[i] != new.get(i)} == set()
    assert sum(old[i] != new.get(i) for i in inner) > len(inner) // 4


@pytest.mark.parametrize("x", [
    -0.123456789012345, -1e-200, -1.2345678901234e-10, -1e300 / 3, 5e-324, 123456789.0123456])
def test_any_number_has_room_in_a_field(x, tmp_path):
    points = np.array([[x, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    mesh = meshio.Mesh(points, [("tetra", [[0, 1, 2, 3]]), ("triangle", [[0, 1, 2]])],
                       cell_data={"nastran:ref": [[123456789], [3]]})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataNotKeptWarning)
        write_file(tmp_path / "a.bdf", mesh)
    assert meshio.read(tmp_path / "a.bdf").points[0, 0] == pytest.approx(x, rel=1e-8)
    seen = cards(tmp_path / "a.bdf")
    assert real(seen[0][3]) == pytest.approx(x, rel=1e-8)
    assert max(map(len, (tmp_path / "a.bdf").read_text().splitlines())) <= 72
    assert seen[4:6] == [["CTETRA", "1", "123456789", "1", "2", "3", "4"],
                         ["CTRIA3", "2", "3", "1", "2", "3"]]


@pytest.mark.parametrize("line", ["INCLUDE 'parts/mesh.bdf'", "include \"parts\\mesh.bdf\"",
                                  "INCLUDE 'parts/\n         mesh.bdf'  $ from CAD"])
def test_what_a_deck_includes_stands_in_its_place(line, tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "mesh.bdf").write_text("".join(
        f"GRID,{i},,{x},{y},{z}\n" for i, (x, y, z) in enumerate(
            [(0, 0, 0.0), (1, 0, 0.0), (0, 1, 0.0), (0, 0, 1.0), (0.3, 0.3, 0.25)], 1))
        + "".join(f"CTETRA,{i},1,{row}\n" for i, row in enumerate(
            ["1,2,3,5", "1,2,5,4", "1,5,3,4", "5,2,3,4"], 1)).rstrip())
    source, target = tmp_path / "a.bdf", tmp_path / "b.bdf"
    more = "PSOLID,1,1\nMAT1,1,2.1E5,,0.3\nENDDATA\n"
    source.write_text(f"SOL 101\nCEND\nBEGIN BULK\n{line}\n{more}")
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataNotKeptWarning)
        optimize_file(source, target)
    back = read_file(target)
    assert back.points.shape == (5, 3)
    assert len(back.cells_dict["tetra"]) == 4
    assert more in target.read_text()
    (tmp_path / "parts" / "mesh.bdf").unlink()
    with pytest.raises(MeshFileError, match=r"it includes parts.mesh\.bdf, which is not there"):
        read_file(source)
