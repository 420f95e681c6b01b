"""Meshes in pieces on disk: as good as in blocks, glued without a gap, in less memory."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
import tet_meshes

import odt_plugins
from odt_plugins import cli
from odt_plugins.compare.start import ball
from odt_plugins.distributed.figures import figures_of, total, worse
from odt_plugins.distributed.partition import bricks
from odt_plugins.distributed.pieces import optimize_pieces
from odt_plugins.errors import (
    DataNotKeptWarning,
    InvalidOptionError,
    MeshFileError,
    UnsupportedMeshError,
)
from odt_plugins.mesh import simplex_mesh
from odt_plugins.promise import broken_promises


def write_pieces(folder: Path, points: Any, cells: Any, label: Any, **data: Any) -> Path:
    """Write the cells of every label as a file, and the .pvtu file that names them."""
    folder.mkdir()
    names = []
    for k in np.unique(label):
        members = np.flatnonzero(label == k)
        used, number = np.unique(cells[members], return_inverse=True)
        names.append(f"piece-{k}.vtu")
        meshio.Mesh(points[used], [("tetra", number.reshape(-1, 4))],
                    point_data={"was": used},
                    cell_data={name: [values[members]] for name, values in data.items()},
                    ).write(folder / names[-1])
    pieces = "".join(f'<Piece Source="{folder.name}/{name}"/>' for name in names)
    index = folder.with_suffix(".pvtu")
    index.write_text('<VTKFile type="PUnstructuredGrid"><PUnstructuredGrid GhostLevel="0">'
                     f"{pieces}</PUnstructuredGrid></VTKFile>")
    return index


def glued(index: Path, n: int) -> tuple[Any, Any, Any, Any]:
    """The whole mesh again, by the point array that names the vertices of the input."""
    points = np.full((n, 3), np.nan)
    cells, regions, ids = [], [], np.full(n, -1)
    for piece in ElementTree.parse(index).getroot().iter("Piece"):
        mesh = meshio.read(index.parent / piece.get("Source"))
        was = mesh.point_data["was"]
        known = ~np.isnan(points[was, 0])
        assert np.array_equal(points[was[known]], mesh.points[known])
        assert np.array_equal(ids[was[known]], mesh.point_data["GlobalPointIds"][known])
        points[was], ids[was] = mesh.points, mesh.point_data["GlobalPointIds"]
        cells.append(was[mesh.cells[0].data])
        regions.append(mesh.cell_data["marker"][0])
    assert len(np.unique(ids)) == n
    return points, np.concatenate(cells), np.concatenate(regions), ids


def test_pieces_are_about_as_good_as_one_piece_and_fit_together(tmp_path):
    start = ball(5000)
    marker = (start.points[start.cells].mean(axis=1)[:, 0] > 0.1).astype(np.int64) + 3
    index = write_pieces(tmp_path / "in", start.points, start.cells,
                         bricks(start.points, start.cells, 4), marker=marker)
    report = optimize_pieces(index, tmp_path / "out.pvtu")
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
    p1 = np.quantile(b, 0.01, method="inverted_cdf")
    assert p1 - 2.5e-4 < report.after.p1_quality <= p1
    assert report.interface < 0.3 * n
    assert "mean_quality" in str(report)
    assert sorted(os.listdir(tmp_path)) == ["in", "in.pvtu", "out", "out.pvtu"]


def test_the_command_takes_pieces(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    start = ball(300)
    write_pieces(tmp_path / "in", start.points, start.cells,
                 bricks(start.points, start.cells, 2))
    assert cli.main(["optimize", "in.pvtu", "out.pvtu", "--plot", "x.png"]) == 2
    assert "one file each" in capsys.readouterr().err
    assert cli.main(["optimize", "in.pvtu", "out.pvtu", "--finish"]) == 0
    said = capsys.readouterr()
    assert "3 pieces" in said.out
    assert said.err == ""
    points, cells, _, _ = glued(tmp_path / "out.pvtu", len(start.points))
    assert tet_meshes.quality(points, cells).mean() > 0.85


def test_a_directory_and_a_second_run_onto_the_same_place(tmp_path):
    start = ball(600)
    turned = start.cells[:, [0, 1, 3, 2]]
    write_pieces(tmp_path / "in", start.points, turned, bricks(start.points, turned, 3),
                 size=np.ones(len(turned)))
    bits = []
    for _ in range(3):
        with pytest.warns(DataNotKeptWarning, match="not size"):
            optimize_pieces(tmp_path / "in", tmp_path / "out.pvtu", odt={"density": "uniform"})
        points, cells, _, _ = glued(tmp_path / "out.pvtu", len(start.points))
        assert tet_meshes.signed_volumes(points, cells).max() < 0
        assert len(os.listdir(tmp_path)) == 4
        bits.append((points, cells))
    assert all(np.array_equal(x, y) for other in bits[1:]
               for x, y in zip(bits[0], other, strict=True))


def test_progress_is_told_for_every_piece_of_every_stage(tmp_path, monkeypatch, capsys):
    start = ball(300)
    write_pieces(tmp_path / "in", start.points, start.cells,
                 bricks(start.points, start.cells, 4))
    seen: list[tuple[str, float]] = []
    told = optimize_pieces(tmp_path / "in.pvtu", tmp_path / "out.pvtu",
                           odt={"progress": lambda stage, share: seen.append((stage, share))})
    stages = list(dict.fromkeys(stage for stage, _ in seen))
    assert stages == ["reading", "round 1", "round 2: cutting", "round 2", "round 3: cutting",
                      "round 3", "writing"]
    shares = {stage: [share for s, share in seen if s == stage] for stage in stages}
    assert all(found[0] == 0.0 and found[-1] == 1.0 for found in shares.values())
    assert all(sorted(found) == found for found in shares.values())
    assert shares["reading"] == shares["round 1"] == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert len(shares["writing"]) == told.pieces + 1
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
from odt_plugins.distributed.pieces import optimize_pieces
from odt_plugins import optimize
small = ball(60)
optimize((small.points, small.cells))
used = next(int(line.split()[1]) for line in open("/proc/self/status") if "VmData" in line)
limit = used * 1024 + int(sys.argv[1])
resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
(optimize_file if sys.argv[2].endswith(".vtu") else optimize_pieces)(*sys.argv[2:])
"""


@pytest.mark.skipif(sys.platform != "linux", reason="a limit that Linux knows")
def test_a_process_with_too_little_memory_for_the_whole_is_enough_for_the_pieces(tmp_path):
    start = ball(20_000)
    meshio.Mesh(start.points, [("tetra", start.cells)]).write(tmp_path / "whole.vtu")
    write_pieces(tmp_path / "in", start.points, start.cells,
                 bricks(start.points, start.cells, 8))

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([sys.executable, "-c", LIMITED, str(40_000_000), *words],
                              cwd=tmp_path, capture_output=True, text=True, check=False)

    whole = run("whole.vtu", "out.vtu")
    assert whole.returncode != 0
    assert any(word in whole.stderr for word in ("MemoryError", "allocate", "bad_alloc"))
    pieces = run("in.pvtu", "out.pvtu")
    assert pieces.returncode == 0, pieces.stderr
    points, cells, _, _ = glued(tmp_path / "out.pvtu", len(start.points))
    q = tet_meshes.quality(points, cells)
    assert q.mean() > 0.9
    assert q.min() > 0.3


def test_figures_of_the_whole_are_those_of_its_parts():
    start = ball(400)
    whole = figures_of(start.points, start.cells)
    parts = [figures_of(start.points, start.cells[k::3]) for k in range(3)]
    again = total(parts)
    q = tet_meshes.quality(start.points, start.cells)
    assert again.mean_quality == pytest.approx(q.mean(), abs=1e-14)
    assert again.min_quality == whole.min_quality
    assert again.p1_quality == pytest.approx(np.sort(q)[int(np.ceil(0.01 * len(q))) - 1],
                                             abs=3e-4)
    keep = ("min_quality", "p1_quality", "mean_quality", "min_angle", "max_angle")
    assert worse(whole, again, keep) == []
    for name in ("quality", "min_quality", "min_angle", "volume"):
        spoiled = whole._replace(**{name: 0.9 * getattr(whole, name)})
        assert len(worse(whole, spoiled, keep)) == 1
    assert worse(whole, whole._replace(max_angle=whole.max_angle + 1e-6), keep)


def test_what_does_not_go_with_pieces_is_refused(tmp_path):
    start = ball(100)
    index = write_pieces(tmp_path / "in", start.points, start.cells,
                         bricks(start.points, start.cells, 2))
    for odt in ({"fixed": [1]}, {"regions": np.zeros(3, int)}, {"density": "inverse-volume"},
                {"density": np.ones(3)}, {"insert": True}):
        with pytest.raises(InvalidOptionError, match="expected"):
            optimize_pieces(index, tmp_path / "out.pvtu", odt=odt)
    with pytest.raises(MeshFileError, match=r"ending in \.pvtu"):
        optimize_pieces(index, tmp_path / "out.vtu")
    with pytest.raises(MeshFileError, match="try another directory"):
        optimize_pieces(index, tmp_path / "nowhere" / "out.pvtu")
    (tmp_path / "in" / "piece-1.vtu").unlink()
    with pytest.raises(MeshFileError, match=r"piece-1\.vtu is missing"):
        optimize_pieces(index, tmp_path / "out.pvtu")
    index.write_text(index.read_text().replace('GhostLevel="0"', 'GhostLevel="1"'))
    with pytest.raises(MeshFileError, match="ghost cells"):
        optimize_pieces(index, tmp_path / "out.pvtu")
    meshio.Mesh(start.points, [("triangle", start.cells[:, :3])]).write(
        tmp_path / "in" / "piece-0.vtu")
    with pytest.raises(UnsupportedMeshError, match="linear tetrahedra"):
        optimize_pieces(tmp_path / "in", tmp_path / "out.pvtu")
    assert sorted(os.listdir(tmp_path)) == ["in", "in.pvtu"]


@pytest.mark.skipif(sys.platform == "win32", reason="limits of POSIX")
def test_a_full_disk_leaves_the_old_result(tmp_path):
    start = ball(1500)
    index = write_pieces(tmp_path / "in", start.points, start.cells,
                         bricks(start.points, start.cells, 2))
    (tmp_path / "out.pvtu").write_text("old")
    code = ("import sys; from odt_plugins.distributed.pieces import optimize_pieces; "
            "optimize_pieces(*sys.argv[1:])")
    done = subprocess.run(
        [sys.executable, "-c", code, str(index), str(tmp_path / "out.pvtu")],
        capture_output=True, text=True, check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000)))
    assert "MeshFileError: cannot write" in done.stderr
    assert (tmp_path / "out.pvtu").read_text() == "old"
    assert sorted(os.listdir(tmp_path)) == ["in", "in.pvtu", "out.pvtu"]
