"""Meshes in pieces on disk: as good as in blocks, glued without a gap, in less memory."""

from __future__ import annotations

import errno
import os
import resource
import socket
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
import tet_meshes
from hypothesis import given
from hypothesis import strategies as st
from pieces import glued, write_pieces
from policies import set_policy
from processes import full_disk
from scipy.spatial import Delaunay

import odt_plugins
from odt_plugins.api import optimize_file
from odt_plugins.cli import main as cli
from odt_plugins.compare.start import ball
from odt_plugins.distributed import optimize as blocks_module
from odt_plugins.distributed import pieces, placing
from odt_plugins.distributed.figures import measure_part, quantile, total, worse
from odt_plugins.distributed.partition import bricks
from odt_plugins.distributed.store import Piece, join, piece_files
from odt_plugins.errors import (
    DataNotKeptWarning,
    InvalidMeshError,
    InvalidOptionError,
    MeshFileError,
    UnsupportedMeshError,
)
from odt_plugins.mesh.simplex import simplex_mesh
from odt_plugins.options import FIGURES, Options
from odt_plugins.promise.volume import broken_promises


def test_pieces_are_about_as_good_as_one_piece_and_fit_together(tmp_path):
    start = ball(3000)
    marker = (start.points[start.cells].mean(axis=1)[:, 0] > 0.1).astype(np.int64) + 3
    index = write_pieces(tmp_path / "in", start.points, start.cells,
                         bricks(start.points, start.cells, 4), marker=marker)
    report = optimize_file(index, tmp_path / "out.pvtu")
    assert report.fallback is None
    n = len(start.points)
    points, cells, regions, _ = glued(tmp_path / "out.pvtu", n)
    mesh = simplex_mesh(start.points, start.cells, regions=marker)[0]
    assert not broken_promises(mesh, points, cells.astype(np.int32),
                               (regions - 3).astype(np.int32))
    one = odt_plugins.optimize((start.points, start.cells, marker))
    a, b = (tet_meshes.quality(*m[:2]) for m in (one, (points, cells)))
    assert abs(a.mean() - b.mean()) <= 0.003
    assert abs(np.quantile(a, 0.01) - np.quantile(b, 0.01)) <= 0.01
    assert report.after.mean_quality == pytest.approx(b.mean(), abs=1e-12)
    for figures, q in ((report.before, tet_meshes.quality(start.points, start.cells)),
                       (report.after, b)):
        assert figures.p1_quality == pytest.approx(np.quantile(q, 0.01), abs=1e-13)
    assert report.counts["vertices on interfaces"] < 0.3 * n
    whole = odt_plugins.quality((start.points, start.cells)).to_dict()
    assert report.before.to_dict() == pytest.approx(whole, rel=1e-12)
    assert "mean quality" in str(report)
    assert sorted(os.listdir(tmp_path)) == ["in", "in.pvtu", "out", "out.pvtu"]


def test_regions_are_found_in_all_pieces_together(tmp_path):
    start = ball(400)
    points, cells = start.points, start.cells
    x = points[cells].mean(axis=1)
    right, inner = (x[:, 0] > 0.1).astype(np.int64), (np.linalg.norm(x, axis=1) < 0.6).astype(int)
    label = bricks(points, cells, 2)
    index = write_pieces(tmp_path / "in", points, cells, label, right=right, inner=inner + 4,
                         seed=np.arange(len(cells)), part_id=np.zeros(len(cells), dtype=np.int64),
                         marker=label.astype(np.int64) * 0)
    truth = simplex_mesh(points, cells, regions=2 * right + inner)[0]
    cases = (({}, ("right", "inner")), ({"regions": "inner, right"}, ("inner", "right")),
             ({"regions": ["inner"]}, ("inner",)), ({"regions": None}, ()))
    for options, names in cases:
        out = tmp_path / "out.pvtu"
        report = optimize_file(index, out, **options)
        assert report.regions_from == names
        assert ("regions are those of" in str(report)) == bool(names)
        place = np.full((len(points), 3), np.nan)
        parts, found = [], []
        for path in piece_files(out)[0]:
            mesh = meshio.read(path)
            place[mesh.point_data["was"]] = mesh.points
            parts.append(mesh.point_data["was"][mesh.cells[0].data])
            found.append(2 * mesh.cell_data["right"][0] + mesh.cell_data["inner"][0] - 4)
        broken = broken_promises(truth, place, np.concatenate(parts).astype(np.int32),
                                 np.concatenate(found).astype(np.int32))
        assert bool(broken) == (len(names) < 2), (names, broken)
    with pytest.raises(InvalidOptionError, match="regions='nosuch' names no cell array"):
        optimize_file(index, out, regions="nosuch")


def test_fields_are_interpolated_in_every_piece(tmp_path):
    start = ball(400)
    slope = np.array([1.0, -2.0, 0.5])
    index = write_pieces(tmp_path / "in", start.points, start.cells,
                         bricks(start.points, start.cells, 3))
    for path in piece_files(index)[0]:
        mesh = meshio.read(path)
        mesh.point_data |= {"T": mesh.points @ slope, "GlobalNodeId": mesh.point_data["was"] * 1.0}
        mesh.write(path)
    for fields in ("auto", "keep"):
        report = optimize_file(index, tmp_path / "out.pvtu", fields=fields)
        assert report.interpolated == (("T",) if fields == "auto" else ())
        assert ("fields interpolated" in str(report)) == (fields == "auto")
        moved = 0
        for path in piece_files(tmp_path / "out.pvtu")[0]:
            mesh = meshio.read(path)
            was = mesh.point_data["was"]
            moved += (mesh.points != start.points[was]).any(axis=1).sum()
            places = mesh.points if fields == "auto" else start.points[was]
            assert np.abs(mesh.point_data["T"] - places @ slope).max() < 1e-12
            assert np.array_equal(mesh.point_data["GlobalNodeId"], was)
        assert moved > 50


def test_the_command_takes_pieces(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    start = ball(1500)
    write_pieces(tmp_path / "in", start.points, start.cells,
                 bricks(start.points, start.cells, 2))
    assert cli.main(["optimize", "in.pvtu", "out.pvtu", "--plot", "x.png"]) == 2
    assert "one file each" in capsys.readouterr().err
    assert cli.main(["optimize", "in.pvtu", "out.pvtu", "--blocks", "2"]) == 2
    assert "got --blocks for a mesh in pieces" in capsys.readouterr().err
    for flag, value in (("fixed", "f"), ("selection", "s"), ("metric", "input"), ("density", "h")):
        assert cli.main(["optimize", "in.pvtu", "out.pvtu", f"--{flag}", value]) == 2
        said = capsys.readouterr().err
        assert f"got --{flag} " in said
        assert "for a mesh in pieces" in said
    assert cli.main(["optimize", "in.pvtu", "out.pvtu", "--insert"]) == 2
    assert "try --blocks, in memory" in capsys.readouterr().err
    assert cli.main(["optimize", "in.pvtu", "out.pvtu", "--finish"]) == 0
    said = capsys.readouterr()
    assert "pieces 3" in said.out
    assert said.err == ""
    points, cells, _, _ = glued(tmp_path / "out.pvtu", len(start.points))
    assert tet_meshes.quality(points, cells).mean() > 0.85


def test_pieces_choose_flips_as_the_whole_would(tmp_path, monkeypatch):
    start = ball(300)
    index = write_pieces(tmp_path / "in", start.points, start.cells,
                         bricks(start.points, start.cells, 2))
    flips: list[str] = []
    first_round = pieces.first_round

    def sees_options(item: Any, options: Options) -> Any:
        flips.append(options.smoothing.connectivity)
        return first_round(item, options)

    monkeypatch.setattr(pieces, "first_round", sees_options)
    m = len(start.cells)
    for moderate in (m, m - 1):
        set_policy(monkeypatch, blocks_module, exchange_cells=moderate)
        optimize_file(index, tmp_path / "out.pvtu", block_rounds=2)
    assert flips == ["auto", "auto", "flips", "flips"]


def test_a_directory_and_a_second_run_onto_the_same_place(tmp_path):
    start = ball(300)
    turned = start.cells[:, [0, 1, 3, 2]]
    write_pieces(tmp_path / "in", start.points, turned, bricks(start.points, turned, 3),
                 size=np.ones(len(turned)))
    bits = []
    for _ in range(3):
        report = optimize_file(tmp_path / "in", tmp_path / "out.pvtu", density="uniform")
        points, cells, _, _ = glued(tmp_path / "out.pvtu", len(start.points))
        assert tet_meshes.signed_volumes(points, cells).max() < 0
        assert len(os.listdir(tmp_path)) == 4
        bits.append((points, cells))
    assert all(np.array_equal(x, y) for other in bits[1:]
               for x, y in zip(bits[0], other, strict=True))
    for call in (report.worth, lambda: report.interpolation_error(lambda x: x[:, 0]),
                 lambda: report.transfer(start.points)):
        with pytest.raises(UnsupportedMeshError, match=r"in pieces, .* try reading"):
            call()


def test_progress_is_told_for_every_piece_of_every_stage(tmp_path, monkeypatch, capsys):
    start = ball(300)
    write_pieces(tmp_path / "in", start.points, start.cells,
                 bricks(start.points, start.cells, 4))
    seen: list[tuple[str, float]] = []
    told = optimize_file(tmp_path / "in.pvtu", tmp_path / "out.pvtu",
                           progress=lambda stage, share: seen.append((stage, share)))
    stages = list(dict.fromkeys(stage for stage, _ in seen))
    assert stages == ["reading", "round 1", "round 2: cutting", "round 2", "round 3: cutting",
                      "round 3", "writing"]
    shares = {stage: [share for s, share in seen if s == stage] for stage in stages}
    told_of_all = [share for _, share in seen]
    assert sorted(told_of_all) == told_of_all
    ends = np.arange(8) / 7
    for turn, stage in enumerate(stages):
        assert shares[stage][0] == pytest.approx(ends[turn]), stage
        assert shares[stage][-1] == pytest.approx(ends[turn + 1]), stage
    assert shares["round 1"] == pytest.approx(np.linspace(1, 2, 5) / 7)
    assert len(shares["writing"]) == told.counts["pieces"] + 1
    assert [stage for stage, _ in seen] == sorted((stage for stage, _ in seen), key=stages.index)

    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.chdir(tmp_path)
    assert cli.main(["optimize", "in.pvtu", "bar.pvtu"]) == 0
    assert "writing" in capsys.readouterr().err


LIMITED = """
import resource, sys
used = next(int(line.split()[1]) for line in open("/proc/self/status") if "VmData" in line)
from odt_plugins.api import optimize_file
from odt_plugins.compare.start import ball
from odt_plugins.api import optimize_file
from odt_plugins import optimize
small = ball(60)
optimize((small.points, small.cells))
used = next(int(line.split()[1]) for line in open("/proc/self/status") if "VmData" in line)
limit = used * 1024 + int(sys.argv[1])
resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
optimize_file(*sys.argv[2:])
"""


@pytest.mark.skipif(sys.platform != "linux", reason="a limit that Linux knows")
def test_a_process_with_too_little_memory_for_the_whole_is_enough_for_the_pieces(tmp_path):
    start = ball(6000)
    meshio.Mesh(start.points, [("tetra", start.cells)]).write(tmp_path / "whole.vtu")
    write_pieces(tmp_path / "in", start.points, start.cells,
                 bricks(start.points, start.cells, 8))

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([sys.executable, "-c", LIMITED, str(36_000_000), *words],
                              cwd=tmp_path, capture_output=True, text=True, check=False)

    whole = run("whole.vtu", "out.vtu")
    assert whole.returncode != 0
    assert any(word in whole.stderr for word in ("MemoryError", "allocate", "bad_alloc",
                                                  "out of memory"))
    pieces = run("in.pvtu", "out.pvtu")
    assert pieces.returncode == 0, pieces.stderr
    points, cells, _, _ = glued(tmp_path / "out.pvtu", len(start.points))
    q = tet_meshes.quality(points, cells)
    assert q.mean() > 0.9
    assert q.min() > 0.3


def in_parts(folder: Path, points: Any, cells: Any, count: int) -> Any:
    """Figures of a mesh whose every so-many-th cell is in the same part."""
    return total([(str(folder / f"{k}.npz"),
                   measure_part(points, cells[k::count], str(folder / f"{k}.npz")))
                  for k in range(count)])


def test_figures_of_the_whole_are_those_of_its_parts(tmp_path):
    start = ball(400)
    whole = in_parts(tmp_path, start.points, start.cells, 1)
    again = in_parts(tmp_path, start.points, start.cells, 3)
    q = tet_meshes.quality(start.points, start.cells)
    assert again.mean_quality == pytest.approx(q.mean(), abs=1e-14)
    assert again.min_quality == whole.min_quality
    assert again.p1_quality == whole.p1_quality == pytest.approx(np.quantile(q, 0.01), abs=1e-13)
    assert worse(whole, again, FIGURES) == []
    for name in ("mean_quality", "min_quality", "p1_quality", "min_angle", "volume"):
        spoiled = replace(whole, **{name: 0.9 * getattr(whole, name)})
        assert len(worse(whole, spoiled, FIGURES)) == 1
    assert worse(whole, replace(whole, max_angle=whole.max_angle + 1e-6), FIGURES)
    small = (tet_meshes.dihedral_angles(start.points, start.cells).min(axis=1) < 20.0).sum()
    assert again.below_20 == small
    assert worse(whole, replace(whole, below_20=whole.below_20 + 1), FIGURES)


def test_no_loss_of_the_quantile_is_too_small_to_be_seen(tmp_path):
    start = ball(400)
    before = in_parts(tmp_path, start.points, start.cells, 3)
    q = tet_meshes.quality(start.points, start.cells)
    apart = start.points[start.cells[np.argsort(q)]].reshape(-1, 3)
    cells = np.arange(len(apart)).reshape(-1, 4)
    rank = int(0.01 * (len(cells) - 1))
    for loss in (1e-4, 1e-6, 1e-9):
        # the two cells that decide become flatter
        points = apart.copy()
        for c in (rank, rank + 1):
            x = points[cells[c]]
            n = np.cross(x[1] - x[0], x[2] - x[0])
            n /= np.linalg.norm(n)
            points[cells[c, 3]] -= loss * ((x[3] - x[0]) @ n) * n
        now = replace(in_parts(tmp_path, points, cells, 3), volume=before.volume)
        p1 = np.quantile(tet_meshes.quality(points, cells), 0.01)
        assert 0 < before.p1_quality - p1 < 3 * loss
        assert now.p1_quality == pytest.approx(p1, abs=1e-13)
        found = worse(before, now, ("p1_quality",))
        assert found == [f"p1_quality went from {before.p1_quality:.6g} to {p1:.6g}"]


@pytest.mark.parametrize("seed", range(4))
def test_thin_meshes_in_pieces_lose_nothing_of_the_quantile(tmp_path, seed):
    points = np.random.default_rng(seed).random((100, 3)) * [1.0, 1.0, 1e-3]
    cells = Delaunay(points).simplices
    cells = tet_meshes.oriented(points, cells[np.abs(tet_meshes.quality(points, cells)) > 1e-9])
    index = write_pieces(tmp_path / "in", points, cells, bricks(points, cells, 3))
    optimize_file(index, tmp_path / "out.pvtu")
    now = tet_meshes.quality(*glued(tmp_path / "out.pvtu", len(points))[:2])
    before = np.quantile(tet_meshes.quality(points, cells), 0.01)
    assert np.quantile(now, 0.01) >= before * (1 - 1e-12)


@given(st.lists(st.lists(st.sampled_from([0.0, 5e-324, 0.25, np.nextafter(0.25, 1), 1.0]) |
                         st.floats(0, 1), min_size=1, max_size=9), min_size=1, max_size=5),
       st.sampled_from([0.0, 0.01, 0.3, 0.5, 1.0]))
def test_the_quantile_of_values_in_files_is_that_of_numpy(lists, share):
    with tempfile.TemporaryDirectory() as folder:
        names = [f"{folder}/{k}" for k in range(len(lists))]
        for name, values in zip(names, lists, strict=True):
            np.sort(values).tofile(name)
        every = np.concatenate(lists)
        assert quantile(names, len(every), share) == np.quantile(every, share)


def test_files_that_the_system_does_not_give_are_named(tmp_path, monkeypatch):
    start = ball(200)
    index = write_pieces(tmp_path / "in", start.points, start.cells,
                         bricks(start.points, start.cells, 2))
    lost, opened = piece_files(index)[0][1], Path.open

    def refusing(path: Path, *given: Any, **more: Any) -> Any:
        if str(path) == lost:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), lost)
        return opened(path, *given, **more)

    monkeypatch.setattr(Path, "open", refusing)
    for what, how in ((lost, {}), (index, {"target": tmp_path / "out.pvtu"})):
        with pytest.raises(MeshFileError) as caught:
            odt_plugins.optimize(what, **how)
        assert str(caught.value) == f"cannot read {lost}: Permission denied; expected a mesh file"


def test_what_does_not_go_with_pieces_is_refused(tmp_path):
    start = ball(100)
    index = write_pieces(tmp_path / "in", start.points, start.cells,
                         bricks(start.points, start.cells, 2))
    for options in ({"fixed": [1]}, {"regions": np.zeros(3, int)}, {"density": "inverse-volume"},
                {"density": np.ones(3)}, {"insert": True}):
        with pytest.raises(InvalidOptionError, match="expected"):
            optimize_file(index, tmp_path / "out.pvtu", **options)
    for wrong in ({"blocks": 2}, {"binary": True}, {"file_format": "gmsh22"}):
        with pytest.raises(InvalidOptionError, match=f"got {next(iter(wrong))}=.* in pieces"):
            optimize_file(index, tmp_path / "out.pvtu", **wrong)
    with pytest.raises(MeshFileError, match="try another directory"):
        optimize_file(index, tmp_path / "nowhere" / "out.pvtu")
    (tmp_path / "in" / "piece-1.vtu").unlink()
    with pytest.raises(MeshFileError, match=r"piece-1\.vtu is missing"):
        optimize_file(index, tmp_path / "out.pvtu")
    meshio.Mesh(start.points, [("triangle", start.cells[:, :3])]).write(
        tmp_path / "in" / "piece-0.vtu")
    with pytest.raises(UnsupportedMeshError, match="linear tetrahedra"):
        optimize_file(tmp_path / "in", tmp_path / "out.pvtu")
    assert sorted(os.listdir(tmp_path)) == ["in", "in.pvtu"]


def test_folders_of_others_stay_and_those_of_killed_runs_go(tmp_path):
    start = ball(150)
    label = bricks(start.points, start.cells, 2)
    write_pieces(tmp_path / "out", start.points, start.cells, label)
    (tmp_path / "out" / "notes.txt").write_text("mine")
    (tmp_path / "out-2").mkdir()
    with subprocess.Popen([sys.executable, "-c", ""]) as gone:
        gone.wait()
    (tmp_path / f".out-{socket.gethostname()}-{gone.pid}-x").mkdir()
    (tmp_path / ".out-elsewhere-1-x").mkdir()
    before = {path: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    for name in ("out-3", "out-4", "out-3"):
        optimize_file(tmp_path / "out", tmp_path / "out.pvtu")
        glued(tmp_path / "out.pvtu", len(start.points))
        assert sorted(os.listdir(tmp_path)) == [".out-elsewhere-1-x", "out", "out-2", name,
                                                "out.pvtu"]
    assert {path: path.read_bytes() for path in (tmp_path / "out").iterdir()} == before
    optimize_file(tmp_path / "out.pvtu", tmp_path / "out.pvtu")
    assert os.path.isdir(tmp_path / "out-4")
    assert not os.path.isdir(tmp_path / "out-3")


def test_an_index_that_cannot_be_written_leaves_the_old_result(tmp_path, monkeypatch):
    start = ball(100)
    index = write_pieces(tmp_path / "in", start.points, start.cells,
                         bricks(start.points, start.cells, 2))
    optimize_file(index, tmp_path / "out.pvtu")
    old = sorted(tmp_path.rglob("*"))

    def refuse(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(placing, "write_index", refuse)
    with pytest.raises(MeshFileError, match="No space left"):
        optimize_file(index, tmp_path / "out.pvtu")
    assert sorted(tmp_path.rglob("*")) == old
    glued(tmp_path / "out.pvtu", len(start.points))


def test_numbers_that_come_with_the_pieces_tell_which_vertices_are_one(tmp_path):
    start = ball(900)
    x = start.points[start.cells].mean(axis=1)
    ids = 7 * np.random.default_rng(1).permutation(2 * len(start.points))
    left = start.cells[x[:, 0] < 0.0]
    # two bodies that touch: every vertex of one is another vertex than those of the other
    points = np.vstack([start.points, start.points])
    cells = np.vstack([left + len(start.points), start.cells[x[:, 0] >= 0.0]])
    label = (points[cells].mean(axis=1)[:, 1] > 0.0).astype(int)
    used, number = np.unique(cells, return_inverse=True)
    points, cells, ids = points[used], number.reshape(-1, 4), ids[used]
    write_pieces(tmp_path / "in", points, cells, label)
    with pytest.raises(InvalidMeshError, match=r"where one of them has several.*GlobalPointIds"):
        optimize_file(tmp_path / "in", tmp_path / "out.pvtu")
    write_pieces(tmp_path / "told", points, cells, label, ids)
    report = optimize_file(tmp_path / "told", tmp_path / "out.pvtu")
    after, result, _, found = glued(tmp_path / "out.pvtu", len(points))
    mesh = simplex_mesh(points, cells)[0]
    assert not broken_promises(mesh, after, result.astype(np.int32),
                               np.zeros(len(result), np.int32))
    assert np.array_equal(found, ids)
    assert report.after.mean_quality > report.before.mean_quality + 0.1
    shared = np.intersect1d(*(cells[label == k] for k in (0, 1)))
    assert report.counts["vertices on interfaces"] == len(shared)
    assert (after[shared] != points[shared]).any()


@pytest.mark.parametrize(("spoil", "match"), [
    (lambda ids, shared: np.where(ids == shared[0], shared[1], ids), "for several vertices each"),
    (lambda ids, shared: np.where(ids == shared[0], shared[1],
                                  np.where(ids == shared[1], shared[0], ids)),
     "in GlobalPointIds at several places"),
])
def test_numbers_that_cannot_be_are_refused(tmp_path, spoil, match):
    start = ball(150)
    label = bricks(start.points, start.cells, 2)
    index = write_pieces(tmp_path / "in", start.points, start.cells, label,
                         np.arange(len(start.points)))
    path = tmp_path / "in" / "piece-1.vtu"
    mesh = meshio.read(path)
    shared = np.intersect1d(*(start.cells[label == k] for k in (0, 1)))
    mesh.point_data["GlobalPointIds"] = spoil(mesh.point_data["GlobalPointIds"], shared)
    mesh.write(path)
    with pytest.raises(InvalidMeshError, match=match):
        optimize_file(index, tmp_path / "out.pvtu")
    assert sorted(os.listdir(tmp_path)) == ["in", "in.pvtu"]


def test_vertices_of_one_number_at_several_places_are_never_joined():
    start = ball(60)
    n = len(start.points)
    piece = Piece(start.points, start.cells, np.zeros(len(start.cells), np.int64), np.arange(n),
                  np.ones(n), np.ones(n, bool))
    assert len(join([piece, piece])[0].points) == n
    with pytest.raises(InvalidMeshError, match="at several places, as number 3"):
        join([piece, replace(piece, points=piece.points + 1e-9 * (np.arange(n) == 3)[:, None])])


def with_ghosts(folder: Path, start: Any, label: Any, marker: Any) -> None:
    """Write pieces that each hold the cells around their vertices as well."""
    folder.mkdir()
    for k in np.unique(label):
        own = label == k
        members = np.flatnonzero(np.isin(start.cells, start.cells[own]).any(axis=1))
        used, number = np.unique(start.cells[members], return_inverse=True)
        ghosts = np.where(own[members], 0, 1).astype(np.uint8)
        meshio.Mesh(start.points[used], [("tetra", number.reshape(-1, 4))],
                    point_data={"was": used, "vtkGhostType": np.zeros(len(used), np.uint8)},
                    cell_data={"vtkGhostType": [ghosts], "marker": [marker[members]]},
                    ).write(folder / f"piece-{k}.vtu")


def test_ghost_cells_and_empty_pieces_are_left_out(tmp_path, recwarn):
    start = ball(300)
    marker = (start.points[start.cells].mean(axis=1)[:, 0] > 0.1).astype(np.int64)
    label = bricks(start.points, start.cells, 3)
    write_pieces(tmp_path / "plain", start.points, start.cells, label, marker=marker)
    with_ghosts(tmp_path / "ghosts", start, label, marker)
    (tmp_path / "ghosts" / "piece-00.vtu").write_text(
        '<VTKFile type="UnstructuredGrid"><UnstructuredGrid><Piece NumberOfPoints="0" '
        'NumberOfCells="0"></Piece></UnstructuredGrid></VTKFile>')
    results = []
    for name in ("plain", "ghosts"):
        optimize_file(tmp_path / name, tmp_path / "out.pvtu")
        results.append(glued(tmp_path / "out.pvtu", len(start.points)))
        mesh = meshio.read(next((tmp_path / "out").glob("*.vtu")) if name == "plain" else
                           next((tmp_path / "out-2").glob("*.vtu")))
        assert set(mesh.point_data) == {"was", "GlobalPointIds"}
    assert all(np.array_equal(a, b) for a, b in zip(*results, strict=True))
    assert not recwarn
    index = (tmp_path / "ghosts.pvtu")
    index.write_text((tmp_path / "plain.pvtu").read_text().replace('Level="0"', 'Level="1"')
                     .replace("plain/", "ghosts/"))
    optimize_file(index, tmp_path / "out.pvtu")
    assert np.array_equal(glued(tmp_path / "out.pvtu", len(start.points))[0], results[0][0])
    index.write_text(index.read_text().replace("ghosts/", "plain/"))
    with pytest.raises(InvalidMeshError, match="the cell array vtkGhostType"):
        optimize_file(index, tmp_path / "out.pvtu")


def test_pieces_that_overlap_and_pieces_without_cells_are_refused(tmp_path):
    start = ball(150)
    label = bricks(start.points, start.cells, 2)
    write_pieces(tmp_path / "in", start.points, start.cells, label)
    one = meshio.read(tmp_path / "in" / "piece-1.vtu")
    both = np.flatnonzero((label == 1) | (np.arange(len(label)) < 40))
    used, number = np.unique(start.cells[both], return_inverse=True)
    meshio.Mesh(start.points[used], [("tetra", number.reshape(-1, 4))],
                point_data={"was": used}).write(tmp_path / "in" / "piece-1.vtu")
    assert len(one.cells[0]) < len(both)
    with pytest.raises(InvalidMeshError, match="pieces overlap at"):
        optimize_file(tmp_path / "in", tmp_path / "out.pvtu")
    for k in (0, 1):
        (tmp_path / "in" / f"piece-{k}.vtu").write_text(
            '<VTKFile type="UnstructuredGrid"><UnstructuredGrid><Piece NumberOfPoints="0" '
            'NumberOfCells="0"></Piece></UnstructuredGrid></VTKFile>')
    with pytest.raises(InvalidMeshError, match="the pieces have no cells"):
        optimize_file(tmp_path / "in", tmp_path / "out.pvtu")
    assert sorted(os.listdir(tmp_path)) == ["in", "in.pvtu"]


def test_arrays_that_some_pieces_lack_are_named(tmp_path):
    start = ball(150)
    index = write_pieces(tmp_path / "in", start.points, start.cells,
                         bricks(start.points, start.cells, 2))
    mesh = meshio.read(tmp_path / "in" / "piece-0.vtu")
    mesh.point_data["extra"] = np.zeros((len(mesh.points), 3))
    mesh.cell_data["layer"] = [np.zeros(len(mesh.cells[0].data))]
    mesh.write(tmp_path / "in" / "piece-0.vtu")
    with pytest.warns(DataNotKeptWarning, match="alike do not come through: extra, layer"):
        optimize_file(index, tmp_path / "out.pvtu")
    glued(tmp_path / "out.pvtu", len(start.points))


def test_texts_come_through_and_field_data_are_named(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    start = ball(400)
    centres = start.points[start.cells].mean(axis=1)
    (tmp_path / "in").mkdir()
    names = set()
    parts = bricks(start.points, start.cells, 2)
    for part in np.unique(parts):
        cells = start.cells[parts == part]
        used, rows = np.unique(cells, return_inverse=True)
        grid = pyvista.UnstructuredGrid(
            {pyvista.CellType.TETRA: rows.reshape(cells.shape)}, start.points[used])
        grid.cell_data["name"] = np.where(centres[parts == part, 0] > 0.1, f"part {part}" * 2, "b")
        names |= set(map(str, grid.cell_data["name"]))
        grid.point_data["text"] = np.array([f"{v}" for v in used])
        grid.field_data["TimeValue"] = [1.5]
        grid.save(tmp_path / "in" / f"{part}.vtu")
    with pytest.warns(DataNotKeptWarning, match="field data of pieces do not come .*: TimeValue$"):
        optimize_file(tmp_path / "in", tmp_path / "out.pvtu")
    whole = pyvista.read(tmp_path / "out.pvtu")
    assert set(map(str, whole.cell_data["name"])) == names
    assert set(map(str, whole.point_data["text"])) == set(map(str, np.unique(start.cells)))


def test_cell_arrays_come_through_as_they_do_in_one_piece(tmp_path, recwarn):
    start = ball(1500)
    centres = start.points[start.cells].mean(axis=1)
    marker = (centres[:, 0] > 0.1).astype(np.int64)
    index = write_pieces(tmp_path / "in", start.points, start.cells,
                         bricks(start.points, start.cells, 3), marker=marker,
                         row=np.arange(len(start.cells)), place=centres.astype(np.float32))
    optimize_file(index, tmp_path / "out.pvtu")
    assert not recwarn.list
    old = {tuple(sorted(cell)): row for row, cell in enumerate(start.cells.tolist())}
    found = kept = 0
    size = np.ptp(start.points[start.cells], axis=1).max()
    for piece in ElementTree.parse(tmp_path / "out.pvtu").getroot().iter("Piece"):
        mesh = meshio.read(tmp_path / piece.get("Source"))
        row, place = mesh.cell_data["row"][0], mesh.cell_data["place"][0]
        assert row.dtype == np.int64
        assert np.array_equal(place, centres.astype(np.float32)[row])
        assert np.array_equal(marker[row], mesh.cell_data["marker"][0])
        corners = mesh.points[mesh.cells[0].data]
        assert np.abs(corners.mean(axis=1) - centres[row]).max() < 2.0 * size
        for cell, source in zip(mesh.point_data["was"][mesh.cells[0].data].tolist(), row.tolist(),
                                strict=True):
            same = old.get(tuple(sorted(cell)))
            found += same is not None
            kept += same == source
    assert kept > 0.9 * found > 0
    declared = ElementTree.parse(tmp_path / "out.pvtu").getroot().find(".//PCellData")
    assert sorted(array.get("Name") for array in declared) == ["marker", "place", "row"]


@pytest.mark.parametrize("data", [{}, {"place": 1}])
def test_pieces_without_labels_get_none(data, tmp_path):
    start = ball(300)
    index = write_pieces(tmp_path / "in", start.points, start.cells,
                         bricks(start.points, start.cells, 2),
                         **{name: np.full(len(start.cells), 0.5) for name in data})
    optimize_file(index, tmp_path / "out.pvtu")
    root = ElementTree.parse(tmp_path / "out.pvtu").getroot()
    assert [array.get("Name") for array in root.iterfind(".//PCellData/*")] == [*data]
    for piece in root.iter("Piece"):
        assert set(meshio.read(tmp_path / piece.get("Source")).cell_data) == set(data)


def test_cells_of_mixed_orientation_are_turned(tmp_path):
    start = ball(150)
    cells = start.cells.copy()
    cells[::5] = cells[::5, [1, 0, 2, 3]]
    index = write_pieces(tmp_path / "in", start.points, cells,
                         bricks(start.points, start.cells, 2))
    report = optimize_file(index, tmp_path / "out.pvtu")
    assert f"cells turned {len(cells[::5])}" in str(report)
    points, result, _, _ = glued(tmp_path / "out.pvtu", len(start.points))
    assert tet_meshes.signed_volumes(points, result).min() > 0.0


@pytest.mark.parametrize("turned", [0, 1])
def test_a_piece_that_is_turned_as_a_whole_counts(turned, tmp_path):
    start = ball(150)
    label = bricks(start.points, start.cells, 2)
    cells = np.where((label == turned)[:, None], start.cells[:, [1, 0, 2, 3]], start.cells)
    index = write_pieces(tmp_path / "in", start.points, cells, label)
    assert optimize_file(index, tmp_path / "out.pvtu").before.turned == (label == turned).sum()
    points, result, _, _ = glued(tmp_path / "out.pvtu", len(start.points))
    assert tet_meshes.signed_volumes(points, result).min() > 0.0


def test_an_input_that_nothing_betters_comes_back_with_its_vertices_numbered(
    tmp_path, monkeypatch
):
    start = ball(200)
    index = write_pieces(tmp_path / "in", start.points, start.cells,
                         bricks(start.points, start.cells, 2))
    monkeypatch.setattr(pieces, "worse", lambda *_: ["too bad"])
    report = optimize_file(index, tmp_path / "out.pvtu")
    assert report.fallback == "a later round was given up (too bad)"
    points, cells, _, _ = glued(tmp_path / "out.pvtu", len(start.points))
    assert np.array_equal(points, start.points)
    assert sorted(map(tuple, np.sort(cells))) == sorted(map(tuple, np.sort(start.cells)))


@pytest.mark.skipif(sys.platform == "win32", reason="limits of POSIX")
def test_a_full_disk_leaves_the_old_result(tmp_path):
    start = ball(1500)
    index = write_pieces(tmp_path / "in", start.points, start.cells,
                         bricks(start.points, start.cells, 2))
    (tmp_path / "out.pvtu").write_text("old")
    code = ("import sys; from odt_plugins.api import optimize_file; "
            "optimize_file(*sys.argv[1:])")
    done = subprocess.run(
        [sys.executable, "-c", code, str(index), str(tmp_path / "out.pvtu")],
        capture_output=True, text=True, check=False, env=full_disk(),
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000)))
    assert "MeshFileError: cannot write" in done.stderr
    assert (tmp_path / "out.pvtu").read_text() == "old"
    assert sorted(os.listdir(tmp_path)) == ["in", "in.pvtu", "out.pvtu"]


def test_a_source_that_is_missing_is_told_in_words(tmp_path):
    with pytest.raises(MeshFileError, match=r"in\.pvtu: No such file or directory; expected a"):
        optimize_file(tmp_path / "in.pvtu", tmp_path / "out.pvtu")


def test_a_broken_piece_is_named(tmp_path):
    start = ball(300)
    points = start.points.copy()
    points[start.cells[0, 0]] = np.nan
    index = write_pieces(tmp_path / "in", points, start.cells,
                         bricks(start.points, start.cells, 2))
    with pytest.raises(InvalidMeshError, match=r"^.*piece.*\.vtu: got 1 point .*finite numbers"):
        optimize_file(index, tmp_path / "out.pvtu")
    broken = piece_files(index)[0][0]
    meshio.Mesh(start.points[:8], [("hexahedron", np.arange(8)[None])]).write(broken)
    with pytest.raises(UnsupportedMeshError, match=rf"^{broken}: got a mesh with cells of hexa"):
        optimize_file(index, tmp_path / "out.pvtu")
