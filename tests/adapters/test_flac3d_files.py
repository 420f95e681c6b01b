"""FLAC3D's grids: groups of zones and faces stay, as meshio sees them too."""

from __future__ import annotations

import warnings

import contract
import meshio
import numpy as np
import pytest
from format_table import mesh_of_everything

from odt_plugins import remesh
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.api import optimize_file
from odt_plugins.errors import DataNotKeptWarning, MeshFileError


def grid(path):
    """Two rocks in groups of zones, the top in one of faces, in numbers that start anywhere."""
    points, cells, labels = contract.grid(3, 3)
    rim = np.array(sorted(contract.facets(cells, np.zeros(len(cells), dtype=int))))
    high = points[:, 2].max()
    top = (points[rim][:, :, 2] == high).all(axis=1)
    lines = ["* GRIDPOINTS", *(f"G {i + 11} {x} {y} {z}" for i, (x, y, z) in enumerate(
        points.tolist())), "* ZONES"]
    lines += [f"Z T4 {i + 5} " + " ".join(map(str, row)) for i, row in enumerate(
        (cells + 11).tolist())]
    lines.append("* ZONE GROUPS")
    for label, slot in ((7, "Default"), (-2, "Geology")):
        lines.append(f'ZGROUP "rock {label}" SLOT {slot}')
        lines += [str(i + 5) for i in np.flatnonzero(labels == label)]
    lines.append("* FACES")
    lines += [f"F T3 {i + 3} " + " ".join(map(str, row)) for i, row in enumerate(
        (rim + 11).tolist())]
    lines += ["* FACE GROUPS", 'FGROUP "top" SLOT Default']
    lines += [str(i + 3) for i in np.flatnonzero(top)]
    path.write_text("\n".join(lines) + "\n")
    return points, high


NAMES = {"rock 7", "zone:rock -2:Geology", "top"}


def volumes(mesh):
    """Sums of the volumes of the tetrahedra in each set, or of the areas of triangles."""
    points, out = np.asarray(mesh.points), {}
    for name, members in mesh.cell_sets.items():
        size = 0.0
        for block, rows in zip(mesh.cells, members, strict=True):
            x = points[block.data[rows]]
            if block.type == "tetra":
                size += np.linalg.det(x[:, 1:] - x[:, :1]).sum() / 6
            else:
                normals = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
                size += np.linalg.norm(normals, axis=1).sum() / 2
        out[name] = size
    return out


@pytest.mark.parametrize("binary", [None, True])
def test_groups_are_of_the_same_cells_afterwards(binary, tmp_path):
    _, high = grid(tmp_path / "a.f3grid")
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataNotKeptWarning)
        optimize_file(tmp_path / "a.f3grid", tmp_path / "b.f3grid", binary=binary)
    before, after = (read_file(tmp_path / f"{name}.f3grid") for name in "ab")
    assert set(before.cell_sets) == set(after.cell_sets) == NAMES
    first, then = volumes(before), volumes(after)
    assert first["top"] == pytest.approx(high**2)
    assert first["rock 7"] + first["zone:rock -2:Geology"] == pytest.approx(high**3)
    assert then == pytest.approx(first)
    kinds = [block.type for block in after.cells]
    triangles = after.cells[kinds.index("triangle")].data
    assert (after.points[triangles[after.cell_sets["top"][kinds.index("triangle")]]][
        :, :, 2] == high).all()
    raw = meshio.read(tmp_path / "b.f3grid")
    assert set(raw.cell_sets) == {"zone:rock 7:Default", "zone:rock -2:Geology",
                                  "face:top:Default"}
    tetra = next(block.data for block in raw.cells if block.type == "tetra")
    assert (np.linalg.det(raw.points[tetra[:, 1:]] - raw.points[tetra[:, :1]]) > 0).all()


def test_groups_are_labels_that_are_resized(tmp_path):
    grid(tmp_path / "a.f3grid")
    before = read_file(tmp_path / "a.f3grid")
    write_file(tmp_path / "b.f3grid", remesh(before, scale=0.7, free="periodic"))
    after = read_file(tmp_path / "b.f3grid")
    assert len(after.points) > len(before.points)
    assert volumes(after) == pytest.approx(volumes(before), rel=3e-3)


@pytest.mark.parametrize("binary", [None, True])
def test_groups_of_other_formats_are_groups(binary, tmp_path):
    mesh = mesh_of_everything()
    with pytest.warns(DataNotKeptWarning) as said:
        write_file(tmp_path / "a.f3grid", mesh, binary=binary)
    assert not any("names of the groups" in str(w.message) for w in said)
    back = read_file(tmp_path / "a.f3grid")
    assert set(back.cell_sets) == {"steel", "rubber", "inside", "outside"}
    assert sum(map(len, back.cell_sets["steel"])) == sum(map(len, mesh.cell_sets["steel"]))
    assert np.array_equal(back.points, mesh.points)


@pytest.mark.parametrize("binary", [None, True])
def test_slots_in_quotes_and_groups_without_a_slot_are_read(binary, tmp_path):
    grid(tmp_path / "a.f3grid")
    text = (tmp_path / "a.f3grid").read_text()
    for old, new in (("SLOT Geology", 'SLOT "Old rocks"'), ('"rock 7" SLOT Default', "Rock7"),
                     ('"top" SLOT Default', '"top" SLOT "Default"')):
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "b.f3grid").write_text(text)
    optimize_file(tmp_path / "b.f3grid", tmp_path / "c.f3grid", binary=binary)
    optimize_file(tmp_path / "c.f3grid", tmp_path / "d.f3grid", binary=False)
    was = volumes(read_file(tmp_path / "a.f3grid"))
    wanted = {"Rock7": was["rock 7"], "top": was["top"],
              "zone:rock -2:Old rocks": was["zone:rock -2:Geology"]}
    for name in "bcd":
        assert volumes(read_file(tmp_path / f"{name}.f3grid")) == pytest.approx(wanted)
    assert 'ZGROUP "rock -2" SLOT "Old rocks"' in (tmp_path / "d.f3grid").read_text()


@pytest.mark.parametrize(("at", "said"), [(8, "it ends too early"),
                                          (None, "it has a cell of 4294967295 nodes")])
def test_binary_files_that_state_more_than_they_hold_are_refused(at, said, tmp_path):
    path = tmp_path / "a.f3grid"
    with pytest.warns(DataNotKeptWarning):
        write_file(path, mesh_of_everything(), binary=True)
    data = bytearray(path.read_bytes())
    at = at or 12 + 28 * len(mesh_of_everything().points) + 8
    data[at: at + 4] = b"\xff" * 4
    path.write_bytes(data)
    with pytest.raises(MeshFileError, match=said):
        read_file(path)
