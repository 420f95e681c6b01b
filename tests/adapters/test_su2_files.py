"""SU2 files: names of markers and all else but places and exchanged cells stay."""

from __future__ import annotations

import re
import warnings

import contract
import meshio
import numpy as np
import pytest

from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.api import optimize_file
from odt_plugins.errors import DataNotKeptWarning, MeshFileError


def rim(cells):
    """Edges of one triangle."""
    edges = np.sort(np.concatenate([cells[:, [0, 1]], cells[:, [1, 2]], cells[:, [2, 0]]]), axis=1)
    found, count = np.unique(edges, axis=0, return_counts=True)
    return found[count == 1]


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("numbered", [True, False])
def test_all_but_places_and_cells_stays(numbered, end, tmp_path):
    points, cells, _ = contract.grid(2, 7)
    edges = rim(cells)
    left = np.isclose(points[edges][:, :, 0], points[:, 0].min()).all(axis=1)
    lines = ["% made by hand", "NDIME= 2", f"NELEM= {len(cells)}"]
    lines += [f"5\t{a} {b} {c}{f' {k}' if numbered else ''}"
              for k, (a, b, c) in enumerate(cells.tolist())]
    lines += [f"NPOIN= {len(points)}"]
    lines += [f"{x:.12f}  {y!r}{f' {k}' if numbered else ''}"
              for k, (x, y) in enumerate(points.tolist())]
    lines += ["NMARK= 3", "% walls"]
    for name, rows in (("inlet", edges[left]), ("7", edges[~left]), ("empty", edges[:0])):
        lines += [f"MARKER_TAG= {name}", f"MARKER_ELEMS= {len(rows)}"]
        lines += [f"3 {a} {b}" for a, b in rows.tolist()]
    source, target = tmp_path / "a.su2", tmp_path / "b.su2"
    source.write_text(end.join([*lines, ""]), newline="")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mesh = read_file(source)
        optimize_file(source, target)
    assert [len(part) for part in mesh.cell_sets["inlet"]] == [0, left.sum()]
    assert set(np.unique(mesh.cell_data["su2:tag"][1]).tolist()) == {1, 7}
    before, after = (path.read_bytes() for path in (source, target))
    place = before.index(b"NMARK")
    assert after.endswith(before[place:])
    assert after.startswith(before[:before.index(b"NELEM")])
    assert after.count(b"\r\n") == (after.count(b"\n") if end == "\r\n" else 0)
    out = read_file(target)
    assert contract.volumes(out.points, out.cells[0].data).sum() == pytest.approx(
        contract.volumes(mesh.points, mesh.cells[0].data).sum())
    assert not np.array_equal(out.points, mesh.points)
    rows = re.findall(rb"^5[ \t].*?(\d+)\r?$", after, re.MULTILINE)
    assert not numbered or [int(k) for k in rows] == list(range(len(out.cells[0].data)))
    kept = (out.points == mesh.points).all(axis=1)
    texts = [re.split(rb"\r?\n", data[data.index(b"NPOIN"):])[1: 1 + len(points)]
             for data in (before, after)]
    assert [a == b for a, b in zip(*texts, strict=True)] == kept.tolist()


@pytest.mark.parametrize("numbered", [True, False])
def test_markers_stay_where_vertices_are_inserted(numbered, tmp_path):
    points, cells, _ = contract.grid(3, 3)
    inner = ((points > points.min(0)) & (points < points.max(0))).all(axis=1)
    points[inner] += np.random.default_rng(1).uniform(-0.1, 0.1, (inner.sum(), 3)) * points.max()
    faces = np.sort(np.concatenate([np.delete(cells, i, axis=1) for i in range(4)]), axis=1)
    faces, count = np.unique(faces, axis=0, return_counts=True)
    faces = faces[count == 1]
    left = (points[faces][:, :, 0] == points[:, 0].min()).all(axis=1)

    def rows(kind, table):
        return [f"{kind} {' '.join(map(str, row))}{f' {k}' if numbered else ''}"
                for k, row in enumerate(table.tolist())]

    source, target = tmp_path / "a.su2", tmp_path / "b.su2"
    source.write_text("\n".join([
        "NDIME= 3", f"NELEM= {len(cells)}", *rows(10, cells), "% here", f"NPOIN= {len(points)}",
        *(row[1:].lstrip() for row in rows("", points)), "NMARK= 2", "MARKER_TAG= inlet",
        f"MARKER_ELEMS= {left.sum()}", *rows(5, faces[left]), "MARKER_TAG= wall",
        f"MARKER_ELEMS= {(~left).sum()}", *rows(5, faces[~left]), ""]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        optimize_file(source, target, insert=True)
    text, back = target.read_text(), meshio.read(target)
    assert text[text.index("NMARK"):] == source.read_text()[source.read_text().index("NMARK"):]
    assert "% here" in text
    assert len(back.points) > len(points)
    assert np.array_equal(back.points[: len(points)][~inner], points[~inner])
    assert contract.volumes(back.points, back.cells[0].data).sum() == pytest.approx(
        contract.volumes(points, cells).sum())
    places = text[text.index("NPOIN"): text.index("NMARK")].split("\n")[1:-1]
    assert not numbered or [int(line.split()[3]) for line in places] == list(range(len(places)))


@pytest.mark.parametrize("labelled", [True, False])
def test_groups_and_sets_of_other_formats_are_markers(labelled, tmp_path):
    """They were called by their numbers, which the configuration of a solver does not know."""
    points, cells, _ = contract.grid(3, 2)
    skin = np.array(sorted(contract.facets(cells, np.zeros(len(cells), dtype=int))))
    inlet = (points[skin][:, :, 0] == points[:, 0].min()).all(axis=1)
    mesh = meshio.Mesh(points, [("tetra", cells), ("triangle", skin)])
    none = np.zeros(0, dtype=int)
    if labelled:
        mesh.cell_data["gmsh:physical"] = [np.full(len(cells), 1), np.where(inlet, 8, 9)]
        mesh.field_data = {"inlet": np.array([8, 2]), "no % slip": np.array([9, 2])}
    else:
        mesh.cell_sets = {"inlet": [none, np.flatnonzero(inlet)],
                          "no % slip": [none, np.flatnonzero(~inlet)]}
    with pytest.warns(DataNotKeptWarning, match="'no % slip'"):
        write_file(tmp_path / "a.su2", mesh)
    assert f"MARKER_TAG= inlet\nMARKER_ELEMS= {inlet.sum()}\n" in (
        tmp_path / "a.su2").read_text(encoding="utf-8")
    back = read_file(tmp_path / "a.su2")
    assert set(back.cell_sets) == {"inlet", "no_slip"}
    (rows,) = (block.data[part] for block, part in zip(
        back.cells, back.cell_sets["inlet"], strict=True) if len(part))
    assert {*map(tuple, np.sort(rows, axis=1).tolist())} == {
        *map(tuple, np.sort(skin[inlet], axis=1).tolist())}


def test_files_of_several_zones_are_told_what_to_try(tmp_path):
    (tmp_path / "a.su2").write_text("NZONE= 2\nIZONE= 1\nNDIME= 2\n")
    with pytest.raises(MeshFileError) as caught:
        read_file(tmp_path / "a.su2")
    assert str(caught.value) == (f"cannot read {tmp_path / 'a.su2'} as su2: it has 2 zones, "
                                 "expected one, try a file for each zone")


def test_what_a_file_says_besides_its_mesh_is_named_where_it_is_lost(tmp_path):
    points, cells, _ = contract.grid(2, 3)
    lines = ["NDIME= 2", f"NELEM= {len(cells)}", *("5 " + " ".join(map(str, row)) for row in cells),
             f"NPOIN= {len(points)}", *(f"{x} {y}" for x, y in points.tolist()),
             "NMARK= 1", "MARKER_TAG= wall", "MARKER_ELEMS= 1",
             "3 {} {}".format(*rim(cells)[0]), "SEND_RECV= 1", "NPERIODIC= 1",
             "PERIODIC_INDEX= 0", *["0 0 0"] * 3]
    (tmp_path / "a.su2").write_text("\n".join([*lines, ""]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        optimize_file(tmp_path / "a.su2", tmp_path / "b.su2")
    assert (tmp_path / "b.su2").read_text().endswith("\n".join(["", *lines[-6:], ""]))
    with pytest.warns(DataNotKeptWarning,
                      match="what is said by NPERIODIC, PERIODIC_INDEX, SEND_RECV"):
        optimize_file(tmp_path / "a.su2", tmp_path / "b.vtu")
