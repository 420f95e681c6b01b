"""Fluent's meshes: cells are put together from faces, zones are labels."""

from __future__ import annotations

import contract
import meshio
import numpy as np
import pytest

from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.api import optimize_file
from odt_plugins.errors import DataNotKeptWarning, MeshFileError


def fluent(path, dim, *, binary=False, mixed=False):
    """Two zones of cells, faces inside, and a wall, as Fluent has them: cells come by faces."""
    points, cells, labels = contract.grid(dim, 3)
    order = np.argsort(labels, kind="stable")
    cells, labels = cells[order], labels[order]
    found = {}
    for i, cell in enumerate(cells.tolist(), 1):
        for k in range(dim + 1):
            face = cell[:k] + cell[k + 1:]
            found.setdefault(tuple(sorted(face)), (face, []))[1].append(i)
    inner = [[*face, *own] for face, own in found.values() if len(own) == 2]
    outer = [[*face, *own, 0] for face, own in found.values() if len(own) == 1]
    n, m, first = len(points), len(cells), int((labels == labels[0]).sum())
    parts = [f'(0 "made (10 (1 1")\n(2 {dim})\n(10 (0 1 {n:x} 0 {dim}))\n(12 (0 1 {m:x} 0))\n'
             f"(12 (2 1 {first:x} 1 0)(\n{'1 ' * first}))\n(12 (a {first + 1:x} {m:x} 1 2))\n"
             f"(13 (0 1 {len(found):x} 0))\n".encode()]

    def section(number, head, table, kind):
        if binary:
            parts.append(f"(30{number} ({head})(".encode() + table.astype(kind).tobytes()
                         + f"\n)End of Binary Section 30{number})\n".encode())
            return
        rows = [" ".join(repr(v) if kind == "<f8" else f"{v:x}" for v in row)
                for row in table.tolist()]
        parts.append(f"({number} ({head})(\n".encode() + "\n".join(rows).encode() + b"))\n")

    section(10, f"1 1 {n:x} 1 {dim}", points, "<f8")
    at = 1
    for zone, kind, rows in ((3, 2, inner), (4, 3, outer)):
        table = np.array(rows)
        table[:, :dim] += 1
        table = np.column_stack([np.full(len(table), dim), table]) if mixed else table
        section(13, f"{zone:x} {at:x} {at + len(table) - 1:x} {kind} {0 if mixed else dim}",
                table, "<i8")
        at += len(table)
    names = ("(45 (2 fluid water)())\n(45 (10 solid steel)())\n(45 (3 interior in)())\n"
             "(45 (4 wall skin)())\n")
    path.write_bytes(b"".join(parts) + names.encode())
    return points, cells, labels


FORMS = [{}, {"binary": True}, {"mixed": True}]


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("form", FORMS)
def test_cells_are_those_beside_the_faces(dim, form, tmp_path):
    points, cells, labels = fluent(tmp_path / "a.msh", dim, **form)
    mesh = read_file(tmp_path / "a.msh")
    kind = "triangle" if dim == 2 else "tetra"
    assert np.array_equal(mesh.points, points)
    both = [np.sort(block.data, axis=1) for block in mesh.cells if block.type == kind]
    first = np.sum(labels == labels[0])
    assert [len(rows) for rows in both] == [first, len(cells) - first]
    assert np.array_equal(np.concatenate(both), np.sort(cells, axis=1))
    assert (contract.volumes(mesh.points, mesh.cells_dict[kind]) > 0).all()
    assert set(mesh.cell_sets) == {"water", "steel", "skin"}
    assert [set(tag.tolist()) for tag in mesh.cell_data["ansys:zone"]] == [{2}, {10}, {4}]


def test_zones_are_groups_of_gmsh(tmp_path):
    fluent(tmp_path / "a.msh", 3)
    with pytest.warns(DataNotKeptWarning, match="types of zones of Fluent"):
        optimize_file(tmp_path / "a.msh", tmp_path / "b.msh")
    before, after = read_file(tmp_path / "a.msh"), read_file(tmp_path / "b.msh")
    assert set(after.cell_sets) >= {"water", "steel", "skin"}
    for name in ("water", "steel"):
        size = [sum(contract.volumes(mesh.points, block.data[rows]).sum() for block, rows in zip(
            mesh.cells, mesh.cell_sets[name], strict=True) if block.type == "tetra")
            for mesh in (before, after)]
        assert size[0] == pytest.approx(size[1])


def test_files_of_meshio_are_said_to_change_their_form(tmp_path):
    points, cells, _ = contract.grid(3, 2)
    meshio.write(tmp_path / "a.msh", meshio.Mesh(points, [("tetra", cells)]), file_format="ansys")
    with pytest.warns(DataNotKeptWarning, match="written as those of Gmsh"):
        write_file(tmp_path / "b.msh", read_file(tmp_path / "a.msh"))


@pytest.mark.parametrize(("old", "new", "said"), [
    (b" 1 3)(", b" 1 2)(", "section 10 of zone 1 has 192 numbers, expected 128"),
    (b" 3 3)(", b" 3 4)(", "section 13 of zone 4 has 540 numbers, expected 648"),
    (b"))\n(45 (2", b"(45 (2", "section 13 of zone 4 has [0-9]+ numbers|it ends too early"),
    (b"(12 (a", b"(12 (0", "its zones of cells do not hold the cells of its faces"),
])
def test_what_does_not_fit_is_refused(old, new, said, tmp_path):
    fluent(tmp_path / "a.msh", 3)
    data = (tmp_path / "a.msh").read_bytes()
    assert old in data
    (tmp_path / "a.msh").write_bytes(data.replace(old, new))
    with pytest.raises(MeshFileError, match=said):
        read_file(tmp_path / "a.msh")


def test_cut_files_are_refused(tmp_path):
    fluent(tmp_path / "a.msh", 3, binary=True)
    data = (tmp_path / "a.msh").read_bytes()
    for share in (0.3, 0.6, 0.9):
        (tmp_path / "b.msh").write_bytes(data[: int(len(data) * share)])
        with pytest.raises(MeshFileError):
            read_file(tmp_path / "b.msh")
