"""Abaqus decks: what a run does not change stays byte for byte, and sets and faces follow."""

from __future__ import annotations

import re
import warnings

import meshio
import numpy as np
import pytest
from boxes import EDGES, FACES, box, quadratic

from odt_plugins import remesh
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.api import optimize_file
from odt_plugins.errors import DataNotKeptWarning, MeshFileError


def rows(table, end, comma=", "):
    return "".join(comma.join(map(str, row)) + end for row in table)


class Told:
    """A deck as it is read by these few lines."""

    def __init__(self, path):
        self.nodes, self.elements, self.faces, self.loads = {}, {}, {}, []
        self.sets = {"NSET": {}, "ELSET": {}}
        text = path.read_bytes().decode().replace("\r", "")
        text = re.sub(r"(?m)^\*\*.*\n", "", text)
        text = re.sub(r",[ \t]*\n[ \t]*(?=[^*\s])", ", ", text)
        for part in re.split(r"(?m)^(?=\*)", text):
            head, _, body = part.partition("\n")
            keys = [w.strip().upper() for w in head.split(",")]
            params = dict([*(k.split("=") for k in keys if "=" in k)])
            table = [[w.strip() for w in line.split(",") if w.strip()]
                     for line in body.split("\n") if line.strip()]
            if keys[0] == "*NODE":
                for row in table:
                    x = [float(w.replace("D", "e")) for w in row[1:]]
                    self.nodes[int(row[0])] = x
                ids = [int(row[0]) for row in table]
            elif keys[0] == "*ELEMENT":
                ids = [int(row[0]) for row in table]
                assert not set(ids) & set(self.elements)
                self.elements |= {int(row[0]): (params["TYPE"], [*map(int, row[1:])])
                                  for row in table}
            elif keys[0] in ("*NSET", "*ELSET"):
                ids = []
                for row in table:
                    if "GENERATE" in keys:
                        first, last, *step = map(int, row)
                        ids += range(first, last + 1, *step)
                    else:
                        for w in row:
                            ids += [int(w)] if w.isdigit() else self.sets[keys[0][1:]][w.upper()]
            elif keys[0] in ("*SURFACE", "*DLOAD"):
                own = self.faces.setdefault(params.get("NAME", keys[0]), [])
                for row in table:
                    found = re.fullmatch(r"[SP](\d)", [*row, ""][1])
                    if found:
                        ids = [int(row[0])] if row[0].isdigit() else self.sets["ELSET"][
                            row[0].upper()]
                        own += [(i, int(found[1]) - 1, *row[2:]) for i in ids]
            for word in ("NSET", "ELSET"):
                if word in params and keys[0] in ("*NODE", "*ELEMENT", "*" + word):
                    self.sets[word].setdefault(params[word], []).extend(ids)

    def directed(self, name):
        """Corners of the faces of a surface, in their sense from the smallest on."""
        out = []
        for i, face, *more in self.faces[name]:
            kind, nodes = self.elements[i]
            corner = [nodes[v] for v in (FACES if kind.startswith("C3D") else EDGES)[face]]
            k = corner.index(min(corner)) if kind.startswith("C3D") else 0
            out.append((*corner[k:], *corner[:k], *more))
        return sorted(out)

    def volumes(self, name=None):
        ids = self.elements if name is None else self.sets["ELSET"][name]
        tets = [e[:4] for kind, e in (self.elements[i] for i in ids) if kind.startswith("C3D")]
        x = np.array([[self.nodes[v] for v in tet] for tet in tets])
        return np.linalg.det(x[:, 1:] - x[:, :1]) / 6


def boundary(cells, keep):
    """Cell and number of the face of every boundary face that is kept, by its corners."""
    seen = {}
    for c, cell in enumerate(cells.tolist()):
        for f, face in enumerate(FACES):
            seen.setdefault(tuple(sorted(cell[v] for v in face)), []).append((c, f))
    return [v[0] for key, v in seen.items() if len(v) == 1 and keep(list(key))]


def deck(path, kind="C3D4", end="\n", part=False):
    """A box of two materials with all that a deck has."""
    points, cells = box(3, 5 if kind == "C3D4" else 4, plane=0.5)
    points = np.where(abs(points - 0.5) < 1e-12, 0.5, points)
    steel = points[cells].mean(axis=1)[:, 0] < 0.5
    cells = np.concatenate([cells[steel], cells[~steel]])
    count = int(steel.sum())
    low = boundary(cells, lambda face: (points[face][:, 2] == 0).all())
    right = boundary(cells, lambda face: (points[face][:, 0] == 1).all())
    x, nodes = (points, cells) if kind == "C3D4" else quadratic(points, cells)
    n, m = len(x), len(cells)
    left = np.flatnonzero(x[:, 0] == 0) + 1

    def number(v):
        return repr(float(v)).replace("e-", "D-") if abs(v) < 0.2 else f" {float(v)!r}\t"

    element = [[i + 11, *row] for i, row in enumerate((nodes + 1).tolist())]
    if kind != "C3D4":
        element = [[*row[:7], f"{end}   {row[7]}", *row[8:]] for row in element]
    head = f"*Heading{end} ** not a comment{end}** Job: a, unit: m{end}"
    head += f"*Part, name=Block{end}" if part else ""
    text = head + f"*Node, nset=All{end}" + "".join(
        f"{i + 1:7d}, " + ", ".join(map(number, v)) + end for i, v in enumerate(x.tolist()))
    text += f"{n + 1}, 5., 5., 5.{end}"
    text += f"*Element, type={kind},{end} elset=Body{end}" + rows(element[:count], end)
    text += f"** the second half{end}*element, type={kind}, elset=Body{end}" + rows(
        element[count:], end, "," if kind == "C3D4" else ", ")
    text += f"*Element, type=MASS, elset=Point{end}5, {n + 1}{end}"
    text += f"*Element, type=SPRINGA, elset=Spring{end}6, {n // 2}, {n + 1}{end}"
    text += f"*Elset, elset=Steel, generate{end}11, {count + 10}, 1{end}"
    text += f"*ELSET,ELSET=Rubber{end}" + "".join(
        ", ".join(map(str, range(11 + k, min(k + 27, m + 11)))) + f",{end}"
        for k in range(count, m, 16))
    text += f"*Nset, nset=Left{end}" + rows([left[k: k + 16] for k in range(0, len(left), 16)], end)
    text += f"*Elset, elset=Both{end}Steel, Rubber{end}"
    for f in range(4):
        own = [c + 11 for c, g in low if f == g]
        if own:
            text += f"*Elset, elset=_Low_S{f + 1}, internal{end}" + rows(
                [own[k: k + 16] for k in range(0, len(own), 16)], end)
    text += f"*Surface, type=ELEMENT, name=Low{end}" + "".join(
        f"_Low_S{f + 1}, S{f + 1}{end}" for f in range(4) if any(f == g for _, g in low))
    text += f"*Surface, name=Right{end}" + rows([(c + 11, f"S{f + 1}") for c, f in right], end)
    text += f"*Solid Section, elset=Steel, material=\"St 37\"{end},{end}"
    text += f"*Solid Section, elset=Rubber, material=R{end}*MASS, ELSET=Point{end}1.5{end}"
    text += f"*End Part{end}*Assembly, name=A{end}*Instance, name=Block-1, part=Block{end}" + (
        f"1., 0., 0.{end}*End Instance{end}*End Assembly{end}") if part else ""
    text += f"*Material, name=\"St 37\"{end}*Elastic{end}2.1D11, .3{end}"
    text += f"*Step, name=Load{end}*Static{end}1., 1.{end}*Boundary{end}{left[0]}, 1, 3{end}"
    if not part:
        text += f"*Dload{end}" + rows([(c + 11, f"P{f + 1}", f"{k}.5") for k, (c, f) in
                                       enumerate(right[:5])], end)
    text += f"*Output, field{end}*Element Output, elset=Rubber{end}S, E{end}*End Step"
    path.write_bytes(text.encode())
    return len(points)


def around(data):
    """All but what may change: lines of data of nodes, elements, sets, surfaces and loads."""
    out, keep = [], True
    for line in data.splitlines(keepends=True):
        if line.startswith(b"*"):
            keep = not re.match(
                rb"(?i)\*(node|element|nset|elset|surface|dload)\s*(,|$|\r|\n)", line)
            out.append(line)
        elif keep or re.match(rb"\s+elset", line):
            out.append(line)
    return out


@pytest.mark.parametrize(("kind", "end", "part"), [
    ("C3D4", "\n", False), ("C3D4", "\r\n", True), ("C3D10M", "\r\n", False)])
def test_all_else_stays_and_sets_and_faces_follow(kind, end, part, tmp_path):
    source, target = tmp_path / "a.inp", tmp_path / "b.inp"
    corners = deck(source, kind, end, part)
    with pytest.warns(DataNotKeptWarning, match="MASS, SPRINGA stay as they are") as caught:
        write_file(target, read_file(source))
    assert not [w for w in caught if "keep" in str(w.message)]
    assert target.read_bytes() == source.read_bytes()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataNotKeptWarning)
        report = optimize_file(source, target)
    assert report.after.mean_quality > report.before.mean_quality
    assert around(target.read_bytes()) == around(source.read_bytes())
    before, after = Told(source), Told(target)
    assert set(after.elements) != set(before.elements)
    assert {e[0] for e in after.elements.values()} == {kind.upper(), "MASS", "SPRINGA"}
    assert after.elements[6] == before.elements[6]
    spring = before.elements[6][1][0]
    assert after.nodes[spring] == before.nodes[spring]
    assert (after.volumes() > 0).all()
    for name in ("STEEL", "RUBBER"):
        assert after.volumes(name).sum() == pytest.approx(before.volumes(name).sum())
    steel, rubber = (set(after.sets["ELSET"][name]) for name in ("STEEL", "RUBBER"))
    assert not steel & rubber
    assert sorted(steel | rubber) == sorted(after.sets["ELSET"]["BODY"])
    assert after.sets["NSET"]["LEFT"] == before.sets["NSET"]["LEFT"]
    assert sorted(after.sets["NSET"]["ALL"]) == sorted(after.nodes)
    for name in before.faces:
        assert after.directed(name) == before.directed(name)
    text = target.read_bytes()
    assert text.count(b"\r\n") == (text.count(b"\n") if end == "\r\n" else 0)
    used = {v for _, e in after.elements.values() for v in e}
    assert used == set(after.nodes)
    with pytest.warns(DataNotKeptWarning, match="MASS, SPRINGA stay"):
        mine = read_file(target)
    assert len(mine.cells_dict["tetra" if kind == "C3D4" else "tetra10"]) == report.after.n_cells
    if kind != "C3D4":
        for word, e in after.elements.values():
            for k, (a, b) in enumerate(EDGES if word == "C3D10M" else ()):
                if max(e[a], e[b]) <= corners and e[4 + k] not in before.nodes:
                    mid = (np.array(after.nodes[e[a]]) + after.nodes[e[b]]) / 2
                    assert np.allclose(after.nodes[e[4 + k]], mid)


@pytest.mark.parametrize(("kind", "scale", "end", "part"), [
    ("C3D4", 0.6, "\n", True), ("C3D4", 1.6, "\r\n", False), ("C3D10M", 0.6, "\n", True)])
def test_faces_of_surfaces_and_loads_follow_where_elements_come_and_go(
    kind, scale, end, part, tmp_path
):
    source, target = tmp_path / "a.inp", tmp_path / "b.inp"
    deck(source, kind, end, part)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataNotKeptWarning)
        mesh = read_file(source)
    out = remesh(mesh, scale=scale, free=("periodic",))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*last digits")
        write_file(target, out)
    assert around(target.read_bytes()) == around(source.read_bytes())
    before, after = Told(source), Told(target)
    assert abs(len(after.elements) - len(before.elements)) > 50
    assert (after.volumes() > 0).all()
    for name in before.faces:
        old, new = before.directed(name), after.directed(name)
        if name == "*DLOAD":
            assert sorted(row[3] for row in old) == sorted(row[3] for row in new)
            continue
        x = np.array([[after.nodes[v] for v in row[:3]] for row in new])
        area = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]).sum(axis=0) / 2
        assert area == pytest.approx([0, 0, 1] if name == "LOW" else [-1, 0, 0], abs=1e-9)
        assert len(new) > len(old) or scale > 1
    told = re.findall(r"(?m)^(\S+), S(\d)", target.read_text().partition("name=Right")[0])
    assert all(word == f"_Low_S{face}" or f"_Low_S{face}," not in source.read_text()
               for word, face in told)


def test_new_nodes_join_the_sets_of_the_sections_they_belong_to(tmp_path):
    points, cells = box(3, 4, plane=0.5)
    near, far = points[:, 0] <= 0.5, points[:, 0] > 0.5
    ids = np.arange(len(points)) + 1
    text = "".join(f"*NODE, NSET={name}\n" + rows(
        [[i, *x] for i, x in zip(ids[own].tolist(), points[own].tolist(), strict=True)], "\n")
        for name, own in (("NEAR", near), ("FAR", far)))
    text += "*ELEMENT, TYPE=C3D4, ELSET=E\n" + rows(
        [[i + 1, *row] for i, row in enumerate((cells + 1).tolist())], "\n")
    source, target = tmp_path / "a.inp", tmp_path / "b.inp"
    source.write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataNotKeptWarning)
        warnings.filterwarnings("ignore", message=".*last digits", category=DataNotKeptWarning)
        write_file(target, remesh(read_file(source), scale=0.6, free=("periodic",)))
    told = Told(target)
    assert len(told.nodes) > 1.5 * len(points)
    new = {i: place[0] for i, place in told.nodes.items() if i > len(points)}
    inside = {name: new.keys() & {*told.sets["NSET"][name]} for name in ("NEAR", "FAR")}
    assert all(new[i] < 0.5 + 1e-9 for i in inside["NEAR"])
    assert all(new[i] > 0.75 - 1e-9 for i in inside["FAR"])
    assert len(inside["NEAR"]) > 10 < len(inside["FAR"])
    assert min(new[i] for i in new.keys() - inside["NEAR"] - inside["FAR"]) > 0.5 - 1e-9


def test_loads_of_several_values_meet_where_they_met(tmp_path):
    points, cells = box(3, 4, plane=0.5)
    low = boundary(cells, lambda face: (points[face][:, 2] == 0).all())
    text = "*NODE\n" + rows([[i + 1, *x] for i, x in enumerate(points.tolist())], "\n")
    text += "*ELEMENT, TYPE=C3D4, ELSET=E\n" + rows(
        [[i + 1, *row] for i, row in enumerate((cells + 1).tolist())], "\n") + "*STEP\n*STATIC\n"
    sides = [points[[cells[c][v] for v in FACES[f]]][:, 0].mean() < 0.5 for c, f in low]
    text += "*DLOAD\n" + rows([(c + 1, f"P{f + 1}", 3 if left else 4) for (c, f), left in
                               zip(low, sides, strict=True)], "\n") + "*END STEP\n"
    source, target = tmp_path / "a.inp", tmp_path / "b.inp"
    source.write_text(text)
    with pytest.warns(DataNotKeptWarning, match="last digits"):
        write_file(target, remesh(read_file(source), scale=0.7, free=("periodic",)))
    told = Told(target)
    right = {"3": [], "4": []}
    for *corners, value in told.directed("*DLOAD"):
        right[value].append([told.nodes[v] for v in corners])
    for value, x in ((k, np.array(v)) for k, v in right.items()):
        assert len(x) > len(low) / 2
        assert abs(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])).sum() / 2 == pytest.approx(0.5)
        assert (x[:, :, 0] < 0.5 + 1e-9 if value == "3" else x[:, :, 0] > 0.5 - 1e-9).all()


@pytest.mark.parametrize("kind", ["CPS3", "CPE3", "CAX3", "S3", "S3R", "STRI3", "M3D3", "DC2D3"])
def test_types_in_the_plane_and_of_shells_stay(kind, tmp_path):
    points, cells = box(2, 6, plane=0.5)
    points = points if kind[0] in "CD" else np.c_[points, 0 * points[:, 0]]
    edges = [(c, f) for c, cell in enumerate(cells) for f in range(3)
             if (points[cell[[f, (f + 1) % 3]]][:, 1] == 0).all()]
    letter = "S" if kind[0] in "CD" else "E"
    text = "*NODE\n" + rows([[i + 1, *x] for i, x in enumerate(points.tolist())], "\n")
    text += f"*ELEMENT, TYPE={kind}\n" + rows(
        [[i + 1, *row] for i, row in enumerate((cells + 1).tolist())], "\n")
    text += "*SURFACE, NAME=FOOT\n" + rows([(c + 1, f"{letter}{f + 1}") for c, f in edges], "\n")
    source, target = tmp_path / "a.inp", tmp_path / "b.inp"
    source.write_text(text)
    report = optimize_file(source, target)
    assert report.after.mean_quality > report.before.mean_quality
    assert around(target.read_bytes()) == around(source.read_bytes())
    one, two = (re.findall(rf"(\d+), {letter}(\d)", path.read_text().partition("*SURFACE")[2])
                for path in (source, target))
    told = [Told(path) for path in (source, target)]
    found = [sorted(tuple(t.elements[int(i)][1][(int(f) - 1 + k) % 3] for k in range(2))
                    for i, f in pairs) for t, pairs in zip(told, (one, two), strict=True)]
    assert found[0] == found[1]
    assert read_file(target).cells_dict["line"].shape == (len(edges), 2)


def test_numbers_fit_into_the_twenty_letters_that_solvers_read(tmp_path):
    points, cells = box(3, 4, plane=0.5)
    points = points * 3e-5 - 1.7e-5
    source, target = tmp_path / "a.inp", tmp_path / "b.inp"
    source.write_text("*NODE\n" + rows([[i + 1, *x] for i, x in enumerate(points.tolist())], "\n")
                      + "*ELEMENT, TYPE=C3D4\n" + rows(
                          [[i + 1, *row] for i, row in enumerate((cells + 1).tolist())], "\n"))
    with pytest.warns(DataNotKeptWarning, match="last digits of the coordinates"):
        optimize_file(source, target)
    old, new = (path.read_text().split("*ELEMENT")[0].split("\n") for path in (source, target))
    fresh = [word.strip() for a, b in zip(old, new, strict=True) if a != b for word in b.split(",")]
    assert fresh
    assert max(map(len, fresh)) <= 20


def test_parts_have_numbers_of_their_own(tmp_path):
    points, cells = box(3, 4, plane=0.5)
    body = "*NODE\n" + rows([[i + 1, *x] for i, x in enumerate(points.tolist())], "\n")
    body += "*ELEMENT, TYPE=C3D4, ELSET=E\n" + rows(
        [[i + 1, *row] for i, row in enumerate((cells + 1).tolist())], "\n")
    text = "".join(f"*PART, NAME={name}\n{body}*END PART\n" for name in "AB")
    text += "*ASSEMBLY, NAME=X\n" + "".join(
        f"*INSTANCE, NAME=I{name}, PART={name}\n{k}., 0., 0.\n*END INSTANCE\n"
        for k, name in enumerate("AB"))
    text += f"*ELSET, ELSET=ENDS, INSTANCE=IB\n1, {len(cells)}\n*END ASSEMBLY\n"
    source, target = tmp_path / "a.inp", tmp_path / "b.inp"
    source.write_text(text)
    mesh = read_file(source)
    assert len(mesh.points) == 2 * len(points)
    assert {"A.E", "B.E", "ENDS"} == set(mesh.cell_sets)
    assert [len(rows) for rows in mesh.cell_sets["ENDS"]] == [0, 2]
    optimize_file(source, target)
    assert around(target.read_bytes()) == around(source.read_bytes())
    parts = re.findall(r"(?s)\*PART.*?\*END PART\n", target.read_text())
    for k, part in enumerate(parts):
        (tmp_path / f"{k}.inp").write_text(part)
        told = Told(tmp_path / f"{k}.inp")
        assert (told.volumes() > 0).all()
        assert told.volumes().sum() == pytest.approx(1)


def test_surfaces_of_an_assembly_name_elements_of_its_instances(tmp_path):
    points, cells = box(3, 5, plane=0.5)
    body = "*NODE\n" + rows([[i + 1, *x] for i, x in enumerate(points.tolist())], "\n")
    body += "*ELEMENT, TYPE=C3D4, ELSET=E\n" + rows(
        [[i + 1, *row] for i, row in enumerate((cells + 1).tolist())], "\n")
    text = "".join(f"*PART, NAME={name}\n{body}*END PART\n" for name in "AB")
    text += "*ASSEMBLY, NAME=X\n" + "".join(
        f"*INSTANCE, NAME=I{name}, PART={name}\n*END INSTANCE\n" for name in "AB")
    faces = {home: boundary(cells, lambda face, k=k: (points[face][:, k] == 1).all())
             for k, home in enumerate("AB")}
    lines = []
    for face in range(4):
        own = {home: [c + 1 for c, f in found if f == face] for home, found in faces.items()}
        text += "".join(f"*ELSET, ELSET=_S{face + 1}, INTERNAL, INSTANCE=I{home}\n" + rows(
            [[c] for c in ids], "\n") for home, ids in own.items() if ids)
        lines += [f"_S{face + 1}, S{face + 1}\n"] if any(own.values()) else []
    text += "*SURFACE, NAME=S, TYPE=ELEMENT\n" + "".join(lines) + "*END ASSEMBLY\n"
    source, target = tmp_path / "a.inp", tmp_path / "b.inp"
    source.write_text(text)
    optimize_file(source, target)
    told = {}
    for path in (source, target):
        first, parts, ids = path.read_text(), {}, {}
        for home in "AB":
            (tmp_path / "part").write_text(re.search(
                rf"(?s)\*PART, NAME={home}\n(.*?)\*END PART", first)[1])
            parts[home] = Told(tmp_path / "part")
        for name, home, lines in re.findall(
                r"\*ELSET, ELSET=(\w+), INTERNAL, INSTANCE=I(\w)\n([\d, \n]*)", first):
            ids.setdefault(name, []).extend((home, int(w)) for w in re.findall(r"\d+", lines))
        surface = re.search(r"(?s)\*SURFACE.*?\n(.*?)\*END", first)[1]
        told[path] = sorted(
            (home, *sorted(parts[home].elements[i][1][v] for v in FACES[int(face) - 1]))
            for name, face in re.findall(r"(\S+), S(\d)", surface)
            for home, i in ids.get(name) or [(name[1], int(name.partition(".")[2]))])
    assert target.read_text().count("*ELEMENT") == 2
    assert "IA." in target.read_text()
    assert told[source] == told[target]
    assert len(told[source]) == sum(map(len, faces.values()))


@pytest.mark.parametrize(("text", "said"), [
    ("*NODE\n1, 0., 0.\n*NGEN\n1, 5, 1\n", "it has \\*NGEN"),
    ("*NODE, SYSTEM=C\n1, 0., 0.\n", "it has \\*NODE"),
    ("4 1 0 0 0\n1 0. 0. 0.\n", "a.inp as abaqus: it has no keyword.*, try the suffix .avs for"),
    ("*INCLUDE, INPUT=other.inp\n", "other.inp, which is not there; expected that file, too"),
    ("*NODE\n1, 0., 0.\n*ELEMENT, TYPE=CPS3\n1, 1, 1\n", "ends within element 1"),
])
def test_what_is_not_written_out_is_refused(text, said, tmp_path):
    (tmp_path / "a.inp").write_text(text)
    with pytest.raises(MeshFileError, match=said):
        read_file(tmp_path / "a.inp")


def test_what_is_in_the_place_of_an_include_has_the_ends_of_lines_of_the_deck(tmp_path):
    points, cells = box(3, 4, plane=0.5)
    (tmp_path / "nodes.inc").write_bytes(b"*NODE\r\n" + rows(
        [[i + 1, *x] for i, x in enumerate(points.tolist())], "\r\n")[:-2].encode())
    (tmp_path / "a.inp").write_bytes(
        b"*INCLUDE, INPUT=nodes.inc\r\n*ELEMENT, TYPE=C3D4, ELSET=E\r\n" + rows(
            [[i + 1, *row] for i, row in enumerate((cells + 1).tolist())], "\r\n").encode())
    optimize_file(tmp_path / "a.inp", tmp_path / "b.inp")
    data = (tmp_path / "b.inp").read_bytes()
    assert data.count(b"\n") == data.count(b"\r\n") > len(points)


def test_what_a_deck_includes_is_in_its_place_afterwards(tmp_path):
    points, cells = box(3, 4, plane=0.5)
    (tmp_path / "parts").mkdir()
    nodes, mesh = tmp_path / "parts" / "nodes.inc", tmp_path / "parts" / "mesh.inp"
    nodes.write_text(rows([[i + 1, *x] for i, x in enumerate(points.tolist())], "\n")[:-1])
    mesh.write_text("*NODE, INPUT=nodes.inc, NSET=ALL\n*ELEMENT, TYPE=C3D4, ELSET=E\n" + rows(
        [[i + 1, *row] for i, row in enumerate((cells + 1).tolist())], "\n"))
    (tmp_path / "ask.inp").write_text("*NODE PRINT\nU")
    source, target = tmp_path / "a.inp", tmp_path / "out" / "b.inp"
    target.parent.mkdir()
    ask = "*STEP\n*STATIC\n*INCLUDE, INPUT=ask.inp\n*END STEP\n"
    source.write_text("*INCLUDE, INPUT=parts/mesh.inp\n*MATERIAL, NAME=M\n*ELASTIC\n1., .3\n" + ask
                      + ask)
    before = source.read_bytes(), mesh.read_bytes(), nodes.read_bytes()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        optimize_file(source, target)
    assert before == (source.read_bytes(), mesh.read_bytes(), nodes.read_bytes())
    text = target.read_text()
    assert text.count("\nU\n*END STEP") == 2
    assert "*ELASTIC\n1., .3\n" in text
    back = read_file(target)
    assert not np.array_equal(back.points, points)
    assert len(back.points) == len(points)
    assert len(back.point_sets["ALL"]) == len(points)
    assert len(meshio.read(target).points) == len(points)


def test_a_deck_that_includes_no_more_than_materials_stays(tmp_path):
    points, cells = box(3, 4, plane=0.5)
    (tmp_path / "steel.inc").write_text("*MATERIAL, NAME=STEEL\n*ELASTIC\n1., .3\n")
    source, target = tmp_path / "a.inp", tmp_path / "b.inp"
    source.write_text(
        "*NODE\n" + rows([[i + 1, *x] for i, x in enumerate(points.tolist())], "\n")
        + "*ELEMENT, TYPE=C3D4, ELSET=E\n" + rows(
            [[i + 1, *row] for i, row in enumerate((cells + 1).tolist())], "\n")
        + "*INCLUDE, INPUT=steel.inc\n*SOLID SECTION, ELSET=E, MATERIAL=STEEL\n")
    optimize_file(source, target)
    assert "*ELASTIC\n1., .3\n*SOLID SECTION, ELSET=E, MATERIAL=STEEL" in target.read_text()


def test_other_readers_see_the_same_mesh(tmp_path):
    source, target = tmp_path / "a.inp", tmp_path / "b.inp"
    deck(source)
    text = source.read_text()
    text = text.replace("C3D4,\n elset", "C3D4, elset").replace("D-", "e-")
    text = re.sub(r"\*Element, type=(MASS|SPRINGA).*\n.*\n", "", text)
    text = re.sub(r"\*Elset, elset=(Steel|Both).*\n.*\n", "", text)
    text = re.sub(r"(?m)^\s*\d+, 5\., 5\., 5\.\n", "", text)
    source.write_text(text)
    optimize_file(source, target)
    one, two = (meshio.abaqus.read(path) for path in (source, target))
    assert [c.type for c in one.cells] == [c.type for c in two.cells]
    told, mine = Told(target), read_file(target)
    assert sum(len(c.data) for c in two.cells) == len(told.elements)
    assert np.array_equal(two.points, mine.points)
    assert np.array_equal(np.concatenate([c.data for c in two.cells]), mine.cells_dict["tetra"])
    assert sorted(one.cell_sets) == sorted(two.cell_sets)


@pytest.mark.parametrize(("dim", "order", "word"), [
    (3, 1, "C3D4"), (3, 2, "C3D10"), (2, 1, "CPS3"), (0, 1, "S3")])
def test_decks_written_anew_have_elements_that_solvers_compute_with(dim, order, word, tmp_path):
    points, cells = box(dim or 2, 3)
    points = points if dim else np.c_[points, points[:, 0]]
    x, nodes = (points, cells) if order == 1 else quadratic(points, cells)
    kind = {3: "triangle", 4: "tetra", 10: "tetra10"}[nodes.shape[1]]
    mesh = meshio.Mesh(x, [(kind, nodes)], cell_sets={"half": [np.arange(9)]},
                       point_sets={"rim": np.arange(5)})
    write_file(tmp_path / "a.inp", mesh)
    told, theirs = Told(tmp_path / "a.inp"), meshio.abaqus.read(tmp_path / "a.inp")
    assert {e[0] for e in told.elements.values()} == {word}
    assert np.array_equal(theirs.points, x)
    assert np.array_equal(theirs.cells[0].data, nodes)
    assert told.sets["ELSET"]["HALF"] == list(range(1, 10))
    assert told.sets["NSET"]["RIM"] == list(range(1, 6))
    mesh.cell_sets = {"upper, left": [np.arange(len(cells)) < 7]}
    write_file(tmp_path / "b.inp", mesh)
    assert read_file(tmp_path / "b.inp").cell_sets["upper, left"][0].tolist() == list(range(7))


def test_nodes_that_are_named_stay(tmp_path):
    points, cells = box(3, 6)
    inner = (np.flatnonzero(((points > 0) & (points < 1)).all(axis=1)) + 1).tolist()
    patterns = [
        "*TEMPERATURE\n@, 20.\n@, 30.", "*INITIAL CONDITIONS, TYPE=TEMPERATURE\n@, 2.\n@, 3.",
        "*RIGID BODY, ELSET=E, REF NODE=@, ROT NODE=@", "*COUPLING, REF NODE=@\n*KINEMATIC",
        "*CLOAD\n@, 1, 5.\n I-1.@, 2, 1.", "*BOUNDARY\n@, 1, 3", "*EQUATION\n2\n@, 1, 1., @, 1, 2.",
        "*MPC\nBEAM, @, @", "*FIELD, VARIABLE=1\n@, 2.", "*SURFACE, TYPE=NODE, NAME=N\n@, 1.\n@",
        "*KINEMATIC COUPLING, REF NODE=@\n@, 1, 3", "*NODAL THICKNESS\n@, .5", "*CFLUX\n@, 11, 2.",
        "*PRE-TENSION SECTION, SURFACE=S, NODE=@", "*NORMAL\n5, @, 0., 0., 1.",
        "*ORIENTATION, NAME=O, DEFINITION=NODES\n@, @, @", "*MONITOR, NODE=@, DOF=1",
        "*IMPERFECTION\n@, .1, .1, .1"]
    free, named, extra = iter(inner[::2]), [], []
    for pattern in patterns:
        parts = pattern.split("@")
        own = [next(free) for _ in parts[1:]]
        extra.append(parts[0] + "".join(f"{i}{part}" for i, part in zip(own, parts[1:],
                                                                        strict=True)))
        named += own
    source, target = tmp_path / "a.inp", tmp_path / "b.inp"
    body = "*NODE\n" + rows([[i + 1, *x] for i, x in enumerate(points.tolist())], "\n")
    body += "*ELEMENT, TYPE=C3D4, ELSET=E\n" + rows(
        [[i + 1, *row] for i, row in enumerate((cells + 1).tolist())], "\n")
    text = "\n".join([*extra, "*INITIAL CONDITIONS, TYPE=STRESS", f"{inner[1]}, 1., 2."]) + "\n"
    source.write_text(body + text.replace("I-1.", ""))
    assert sorted((read_file(source).held + 1).tolist()) == sorted(named)
    report = optimize_file(source, target)
    assert f"{len(named)} vertices named by its file stay where they are" in " ".join(report.notes)
    old, new = Told(source).nodes, Told(target).nodes
    assert {i for i in named if old[i] != new.get(i)} == set()
    assert sum(old[i] != new.get(i) for i in inner) > len(inner) // 4
    parts = re.sub(r"(?m)(?<![\d.-])(?=\d+, (1, 5|1, 3|20|30))", "I-1.", "\n".join(extra[:6]))
    source.write_text(f"*PART, NAME=P\n{body}*END PART\n*ASSEMBLY, NAME=A\n*INSTANCE, NAME=I-1, "
                      f"PART=P\n*END INSTANCE\n*END ASSEMBLY\n{parts}")
    assert len(read_file(source).held) == 5
