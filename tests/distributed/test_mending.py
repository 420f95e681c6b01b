"""Meshes in pieces with inverted cells: untangled in their piece, or with those around it."""

import re

import contract
import meshio
import numpy as np
import pytest
from pieces import glued, write_pieces

from odt_plugins import TangledMeshError
from odt_plugins.api import optimize_file
from odt_plugins.cli import main as cli
from odt_plugins.distributed import mending
from odt_plugins.distributed.mending import mend


def tangled_pieces(folder, where, ids=False):
    """A grid in three slabs, in which vertices inside some of them, or between two, are elsewhere.

    Returns
    -------
    index, points before and in the files, cells
    """
    points, cells, _ = contract.grid(3, 6)
    layer = np.arange(len(points)) // 7**2
    label = layer[cells].min(axis=1) // 2
    rng = np.random.default_rng(1)
    wrong = points.copy()
    inner = ((points > 0) & (points < 1)).all(axis=1)
    moved = inner & (layer == {"inside": 1, "between": 2}[where])
    wrong[moved] += rng.normal(size=(moved.sum(), 3)) / 4
    assert (contract.volumes(wrong, cells) < 0).any()
    index = write_pieces(folder, wrong, cells, label, np.arange(len(points)) if ids else None,
                         size=np.arange(len(cells)))
    return index, points, wrong, cells


@pytest.mark.parametrize("ids", [False, True])
@pytest.mark.parametrize("where", ["inside", "between"])
def test_inverted_cells_are_untangled_where_they_are(where, ids, tmp_path, monkeypatch):
    together = []

    def sees(item, options):
        together.append(len(item[0]))
        return mend(item, options)

    monkeypatch.setattr(mending, "mend", sees)
    index, points, wrong, cells = tangled_pieces(tmp_path / "in", where, ids)
    told = []
    report = optimize_file(index, tmp_path / "out.pvtu", block_rounds=2,
                             progress=lambda stage, share: told.append((stage, share)))
    assert set(together) == ({1} if where == "inside" else {1, 2})
    out, rows, _, _ = glued(tmp_path / "out.pvtu", len(points))
    assert (contract.volumes(out, rows) > 0).all()
    assert contract.volumes(out, rows).sum() == pytest.approx(6.0)
    boundary = ((points == 0) | (points == 1)).any(axis=1)
    assert np.array_equal(out[boundary], points[boundary])
    assert len(rows) == report.after.n_cells
    inverted = int((contract.volumes(wrong, cells) <= 0).sum())
    assert report.counts["cells untangled"] == inverted
    assert f"cells untangled {inverted}" in str(report)
    assert report.before.n_cells == len(cells) - inverted
    assert report.before.min_quality > 0
    shares = [share for _, share in told]
    assert "untangling" in [stage for stage, _ in told]
    assert shares == sorted(shares)


def test_what_no_pieces_around_mend_is_told_with_its_place_and_leaves_nothing(tmp_path, capsys):
    index, *_ = tangled_pieces(tmp_path / "in", "inside")
    with pytest.raises(TangledMeshError, match="overlapping a neighbour"):
        optimize_file(index, tmp_path / "out.pvtu", repair="none")
    file = tmp_path / "in" / "piece-2.vtu"
    mesh = meshio.read(file)
    corners = [int(np.flatnonzero((mesh.points == x).all(axis=1))[0])
               for x in ([1, 0, 0], [1, 1, 1])]
    mesh.points[corners] = mesh.points[corners[::-1]]
    mesh.write(file)
    assert cli.main(["optimize", str(index), str(tmp_path / "out.pvtu"), "--quiet"]) == 1
    said = capsys.readouterr().err
    assert re.search(r"first: around \(.*\) in piece-2.vtu, in 1 piece ", said), said
    assert not (tmp_path / "out.pvtu").exists()


def test_interfaces_of_regions_stay_while_pieces_are_untangled(tmp_path):
    points, cells, _ = contract.grid(3, 6)
    label = np.arange(len(points))[cells].min(axis=1) // 7 % 7 // 2
    marker = (points[cells].mean(axis=1)[:, 0] > 0.5).astype(np.int32)
    wrong = points.copy()
    moved = ((points > 0) & (points < 1)).all(axis=1) & (points[:, 0] != 0.5)
    wrong[moved] = [0.1, 0.2, 0.3]
    index = write_pieces(tmp_path / "in", wrong, cells, label, np.arange(len(points)),
                         marker=marker)
    optimize_file(index, tmp_path / "out.pvtu", block_rounds=2)
    out, rows, regions, _ = glued(tmp_path / "out.pvtu", len(points))
    assert (contract.volumes(out, rows) > 0).all()
    between = points[:, 0] == 0.5
    assert np.array_equal(out[between], points[between])
    for name in (0, 1):
        assert contract.volumes(out, rows[regions == name]).sum() == pytest.approx(3.0)
