"""Sets and faces of Abaqus decks with several blocks and parts where elements come and go."""

from __future__ import annotations

import re
import warnings

import meshio
import numpy as np
import pytest
from boxes import FACES, box

from odt_plugins import remesh
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.errors import DataNotKeptWarning


def lines(rows):
    return "".join(", ".join(map(str, row)) + "\n" for row in rows)


def nodes_and_elements(points, cells, parts):
    """Lines of nodes and of elements, those of each part of the cells in a set of its own."""
    text = "*NODE\n" + lines([[i, *x] for i, x in enumerate(points.tolist(), 1)])
    for name, own in parts.items():
        text += f"*ELEMENT, TYPE=C3D4, ELSET={name}\n" + lines(
            [[i + 1, *(cells[i] + 1)] for i in own])
    return text


def faces(points, cells, k, value):
    return [(c, f) for c, cell in enumerate(cells) for f, face in enumerate(FACES)
            if (points[cell[face], k] == value).all()]


def written(source, target, scale):
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataNotKeptWarning)
        warnings.filterwarnings("ignore", message=".*last digits", category=DataNotKeptWarning)
        write_file(target, remesh(read_file(source), scale=scale, free=("periodic",)))
    return target.read_text()


def elements(text):
    """Places of the corners of the elements of a deck, or of a part of one, by their numbers."""
    nodes, found, of_set = {}, {}, False
    for row in (line.split(",") for line in text.splitlines()):
        of_set = row[0] in ("*ELSET", "*NSET") if row[0].startswith("*") else of_set
        if of_set:
            continue
        if len(row) == 4 and "." in row[1]:
            nodes[int(row[0])] = [float(word) for word in row[1:]]
        elif len(row) == 5 and row[0].isdigit():
            assert int(row[0]) not in found
            found[int(row[0])] = [int(word) for word in row[1:]]
    return {i: np.array([nodes[v] for v in row]) for i, row in found.items()}


def area(found, rows):
    """Sum of the normals of some faces, out of their elements."""
    x = np.array([found[int(i)][FACES[int(f) - 1]] for i, f in rows])
    return -np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]).sum(axis=0) / 2


def test_new_elements_have_numbers_of_their_own_whatever_block_has_the_largest(tmp_path):
    points, cells = box(3, 4, plane=0.5)
    left = points[cells].mean(axis=1)[:, 0] < 0.5
    source, target = tmp_path / "a.inp", tmp_path / "b.inp"
    parts = {"A": np.flatnonzero(~left), "B": np.flatnonzero(left)}
    order = np.concatenate([parts["B"], parts["A"]])
    source.write_text(nodes_and_elements(points, cells[order], {
        "A": np.arange(left.sum(), len(cells)), "B": np.arange(left.sum())}))
    found = elements(written(source, target, 0.6))
    assert len(found) > 1.5 * len(cells)
    size = np.linalg.det(np.array([*found.values()])[:, 1:] - np.array([*found.values()])[:, :1])
    assert size.sum() / 6 == pytest.approx(1)


@pytest.mark.parametrize("scale", [0.6, 1.6])
def test_faces_of_an_instance_are_named_from_outside(scale, tmp_path):
    points, cells = box(3, 4)
    low, high = (faces(points, cells, 2, value) for value in (0, 1))
    text = "*PART, NAME=P\n" + nodes_and_elements(points, cells, {"ALL": np.arange(len(cells))})
    for f in range(4):
        own = [c + 1 for c, g in high if g == f]
        text += f"*ELSET, ELSET=H{f + 1}\n" + lines([own]) if own else ""
    text += "*END PART\n*ASSEMBLY, NAME=A\n*INSTANCE, NAME=P-1, PART=P\n*END INSTANCE\n"
    text += "*SURFACE, NAME=LOW\n" + lines([(f"P-1.{c + 1}", f"S{f + 1}") for c, f in low])
    text += "*SURFACE, NAME=HIGH\n" + lines(
        [(f"P-1.H{f + 1}", f"S{f + 1}") for f in range(4) if any(g == f for _, g in high)])
    source, target = tmp_path / "a.inp", tmp_path / "b.inp"
    source.write_text(text + "*END ASSEMBLY\n")
    text = written(source, target, scale)
    found = elements(text)
    _, first, second = re.split(r"\*SURFACE, NAME=\w+\n", text)
    for part, normal in ((first, [0, 0, -1]), (second, [0, 0, 1])):
        rows = re.findall(r"(?m)^P-1\.(\d+), S(\d)", part)
        assert len(rows) not in (0, len(low))
        assert area(found, rows) == pytest.approx(normal, abs=1e-12)


@pytest.mark.parametrize("scale", [1.4, 1.7, 2.0])
def test_a_set_of_faces_that_went_goes_with_its_line(scale, tmp_path):
    points, cells = box(3, 4)
    low = faces(points, cells, 2, 0)
    text = nodes_and_elements(points, cells, {"ALL": np.arange(len(cells))})
    names = []
    for k, (c, f) in enumerate(low):
        names.append((f"F{k}", f"S{f + 1}"))
        text += f"*ELSET, INTERNAL,\n ELSET=F{k}\n{c + 1},\n"
    text += "*SURFACE, NAME=LOW\n" + lines(names)
    source, target = tmp_path / "a.inp", tmp_path / "b.inp"
    source.write_text(text)
    text = written(source, target, scale)
    found = elements(text)
    sets = {name: re.findall(r"\d+", rows) for name, rows in re.findall(
        r"ELSET=(F\d+)\n((?:[\d, ]+\n)*)", text)}
    told = re.findall(r"(?m)^(F?\d+), S(\d)", text.partition("*SURFACE")[2])
    assert {word for word, _ in told if word.startswith("F")} == {*sets}
    assert len(sets) < len(low)
    rows = [(i, f) for word, f in told for i in sets.get(word, [word])]
    assert area(found, rows) == pytest.approx([0, 0, -1], abs=1e-12)


def test_sets_that_are_called_by_a_number_have_all_their_members(tmp_path):
    """Of a set called 2 element 2 alone was read; solvers want such a name in quotes."""
    points, cells = box(3, 2)
    left = points[cells].mean(axis=1)[:, 0] < 0.5
    sets = {"2": [np.flatnonzero(left)], "1st": [np.flatnonzero(~left)]}
    mesh = meshio.Mesh(points, [("tetra", cells)], cell_sets=sets)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_file(tmp_path / "a.inp", mesh)
    text = (tmp_path / "a.inp").read_text()
    assert 'ELSET="2"' in text
    assert 'ELSET="1st"' in text
    for name in ('"2"', "2"):
        (tmp_path / "b.inp").write_text(text.replace('"2"', name))
        back = read_file(tmp_path / "b.inp")
        assert sum(map(len, back.cell_sets["2"])) == left.sum()


def test_a_set_that_is_called_as_an_element_with_a_load_stays(tmp_path):
    points, cells = box(3, 2)
    (c, f), *_ = faces(points, cells, 0, 0)
    (tmp_path / "a.inp").write_text(
        nodes_and_elements(points, cells, {"ALL": range(len(cells))})
        + f'*ELSET, ELSET="{c + 1}"\n{c + 1}, {c + 2}\n*DLOAD\n{c + 1}, P{f + 1}, 1.0\n')
    back = read_file(tmp_path / "a.inp")
    assert sum(map(len, back.cell_sets[str(c + 1)])) == 2


def test_sets_that_differ_in_capitals_alone_have_two_names(tmp_path):
    """Abaqus takes such names for one: the first set had the members of the second, too."""
    points, cells = box(3, 2)
    left = points[cells].mean(axis=1)[:, 0] < 0.5
    mesh = meshio.Mesh(points, [("tetra", cells)], point_sets={"A": [0], "a": [1]}, cell_sets={
        "BODY": [np.flatnonzero(left)], "body": [np.flatnonzero(~left)]})
    with pytest.warns(match="point sets 'a', cell sets 'body'"):
        write_file(tmp_path / "a.inp", mesh)
    back = read_file(tmp_path / "a.inp")
    sizes = {name: sum(map(len, members)) for name, members in back.cell_sets.items()}
    assert sizes == {"BODY": left.sum(), "body_2": (~left).sum()}
    assert {name: list(nodes) for name, nodes in back.point_sets.items()} == {"A": [0], "a_2": [1]}


def test_names_that_abaqus_does_not_read_are_others(tmp_path):
    points, cells = box(3, 2)
    titles = {'say "hi"': "say _hi_", "two\nlines": "two_lines", 90 * "a": 80 * "a",
              90 * "a" + "2": 78 * "a" + "_2", "plain name": "plain name"}
    mesh = meshio.Mesh(points, [("tetra", cells)],
                       cell_sets={name: [np.arange(k + 1)] for k, name in enumerate(titles)},
                       point_sets={name: np.arange(k + 1) for k, name in enumerate(titles)})
    with pytest.warns(DataNotKeptWarning, match="point sets 'aaa.*cell sets 'aaa"):
        write_file(tmp_path / "a.inp", mesh)
    text = (tmp_path / "a.inp").read_text()
    assert text.count('"') == 8
    back = read_file(tmp_path / "a.inp")
    assert {name: len(rows[0]) for name, rows in back.cell_sets.items()} == {
        title: k + 1 for k, title in enumerate(titles.values())}
    assert {name: len(rows) for name, rows in back.point_sets.items()} == {
        title: k + 1 for k, title in enumerate(titles.values())}
