"""Batches: poisoned, crashing, endless and greedy inputs among good ones, stopped and resumed."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import meshio
import numpy as np
import pytest
import tet_meshes
import trimesh
from processes import alive, children, full_disk, wait_until

from odt_plugins.adapters.files import read_file
from odt_plugins.cli import main as cli
from odt_plugins.compare.start import ball
from odt_plugins.distributed import batch, cluster
from odt_plugins.distributed.batch import HIDDEN, Job, find_inputs, job_key, make_jobs, run_batch
from odt_plugins.distributed.job import COMPILING, MOST, RESULT, beyond_limit, compiling, outside
from odt_plugins.distributed.scratch import GONE, clear, make_scratch
from odt_plugins.errors import InvalidOptionError, MeshFileError, MissingDependencyError
from odt_plugins.figures import QualitySummary
from odt_plugins.options import COMPILING as SAID

pytestmark = [
    pytest.mark.timeout(120),
    pytest.mark.skipif(sys.platform != "linux", reason="processes, signals and limits of POSIX"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]
pytest.importorskip("pyarrow")
pytest.importorskip("jinja2")

READERS = """
import ctypes, os, tempfile, time
import meshio

def crash(path):
    tempfile.mkstemp()
    ctypes.string_at(0)

def wait(path):
    time.sleep(float(open(path).read()))
    return meshio.read(path.replace(".slow", ".vtu"))

def devour(path):
    return bytearray(1 << 33)

def throw(path):
    raise RuntimeError("pthread_create: Resource temporarily unavailable")

def abort(path):
    os.write(2, b"terminate called after throwing 'std::bad_alloc'\\n  what(): std::bad_alloc\\n")
    os.abort()

for suffix, reader in ((".throw", throw), (".abort", abort),
                       (".crash", crash), (".slow", wait), (".fat", devour)):
    meshio.register_format(suffix[1:], [suffix], reader, {})
"""
"""Formats whose readers do what toolkits do on a bad day, in the process of an input."""


@pytest.fixture(autouse=True)
def readers(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path_factory.mktemp("readers")
    (folder / "sitecustomize.py").write_text(READERS)
    path = os.pathsep.join([str(folder), str(Path(__file__).parents[2]),
                            os.environ.get("PYTHONPATH", "")])
    monkeypatch.setenv("PYTHONPATH", path)


def write_ball(path: Path, n: int) -> Path:
    start = ball(n)
    meshio.Mesh(start.points, [("tetra", start.cells)]).write(path)
    return path


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with a folder of models."""
    (tmp_path / "models" / "inner").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def files(folder: Path) -> list[str]:
    """Everything below a folder but for reports and what a batch keeps for itself."""
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*")
                  if p.is_file() and HIDDEN not in p.parts and p.suffix != ".json")


def test_whatever_an_input_does_is_a_row(place, capsys, monkeypatch):
    import pyarrow.parquet as pq

    models = place / "models"
    write_ball(models / "good.vtu", 150)
    write_ball(models / "inner" / "good.msh", 200)
    (models / "poisoned.vtu").write_text("<VTKFile>nonsense")
    meshio.Mesh(np.zeros((4, 3)), [("tetra", [[0, 1, 2, 3]])]).write(models / "flat.vtu")
    (models / "bad.crash").write_text("")
    (models / "greedy.fat").write_text("")
    (place / "temporary").mkdir()
    monkeypatch.setenv("TMPDIR", str(place / "temporary"))
    words = ["batch", "models/**/*.*", "--out", "out", "--suffix", ".vtu",
             "--memory-limit", "3", "--keep", "min_quality,mean_quality"]
    assert cli.main(words) == 1
    said = capsys.readouterr()
    assert said.out.startswith("2 ok, 1 crashed, 2 failed, 1 memory\n")
    with open("out/summary.csv", newline="") as file:
        rows = {Path(row["source"]).name: row for row in csv.DictReader(file)}
    assert {name: row["status"] for name, row in rows.items()} == {
        "good.vtu": "ok", "good.msh": "ok", "poisoned.vtu": "failed", "flat.vtu": "failed",
        "bad.crash": "crashed", "greedy.fat": "memory"}
    assert "SIGSEGV" in rows["bad.crash"]["message"]
    assert "1 inverted or flat cell" in rows["flat.vtu"]["message"]
    assert "expected a complete file" in rows["poisoned.vtu"]["message"]
    assert rows["greedy.fat"]["message"] == "more than 3 GB needed"
    assert files(place / "out") == ["good.vtu", "inner/good.vtu", "summary.csv", "summary.html",
                                    "summary.parquet"]
    for name in ("good.vtu", "inner/good.vtu"):
        mesh = meshio.read(place / "out" / name)
        after = tet_meshes.quality(mesh.points, mesh.cells[0].data)
        row = rows["good.msh" if "inner" in name else name]
        assert after.mean() == pytest.approx(float(row["after_mean_quality"]), abs=1e-9)
        assert after.mean() > float(row["before_mean_quality"]) + 0.1
        report = json.loads((place / "out" / f"{name}.json").read_text(encoding="utf-8"))
        assert report["after"]["mean_quality"] == float(row["after_mean_quality"])
        assert report["options"]["keep"] == ["min_quality", "mean_quality"]
    table = pq.read_table("out/summary.parquet")
    assert table["status"].to_pylist() == [
        rows[Path(source).name]["status"] for source in table["source"].to_pylist()]
    assert table["after_mean_quality"].null_count == 4
    page = (place / "out" / "summary.html").read_text(encoding="utf-8")
    assert page.index("bad.crash") < page.index("good.vtu")
    assert "2 ok, 1 crashed" in page
    command = "--suffix .vtu --memory-limit 3.0 --keep min_quality,mean_quality</code>"
    assert "<code>odt-plugins batch" in page
    assert command in page
    assert [p.name for p in (place / "out" / HIDDEN).iterdir()] == ["rows"]
    assert not list((place / "temporary").iterdir())
    assert {row["optimize_seconds"] == "" for row in rows.values() if row["status"] == "ok"} == {
        False}
    for name, value in (("mean q", "mean_quality"), ("min q", "min_quality")):
        means = [np.mean([float(rows[row][f"{when}_{value}"]) for row in ("good.vtu", "good.msh")])
                 for when in ("before", "after")]
        line = f"mean of {name}"
        assert f"  {line:<26}{means[0]:.3f} to {means[1]:.3f}\n" in said.out
        assert f"<dt>{line}</dt><dd>{means[0]:.3f} to {means[1]:.3f}</dd>" in page
    assert cli.main([*words, "--resume"]) == 1
    said = capsys.readouterr()
    assert said.out.startswith("2 ok (2 of them before), 1 crashed (1 of them before), "
                               "2 failed (2 of them before), 1 memory (1 of them before)\n")
    assert "--resume --retry tries it again" in said.out
    assert "inputs a minute" not in said.out
    assert cli.main([*words, "--retry"]) == 2
    assert "--retry goes with --resume" in capsys.readouterr().err


def test_small_inputs_share_a_process_and_one_that_ends_it_leaves_the_others_their_own(
    place, monkeypatch
):
    started: list[int] = []
    start = batch._start

    def counted(folder: Path, tasks: list[Any]) -> Any:
        started.append(len(tasks))
        return start(folder, tasks)

    monkeypatch.setattr(batch, "_start", counted)
    paths = [str(write_ball(place / "models" / f"{n}.vtu", n)) for n in (60, 70, 80, 90)]
    jobs = make_jobs(paths, place / "together", {"finish": False}, suffix=".vtu")
    assert [row["status"] for row in run_batch(jobs)] == ["ok"] * 4
    assert started == [4]
    started.clear()
    (place / "models" / "75.crash").write_text("")
    (place / "models" / "76.txt").write_text("")
    paths += [str(place / "models" / name) for name in ("75.crash", "76.txt")]
    jobs = make_jobs(paths, place / "apart", {"finish": False}, suffix=".vtu")
    rows = {Path(row["source"]).name: row for row in run_batch(jobs)}
    assert {name: row["status"] for name, row in rows.items()} == {
        "60.vtu": "ok", "70.vtu": "ok", "75.crash": "crashed", "76.txt": "failed", "80.vtu": "ok",
        "90.vtu": "ok"}
    assert "SIGSEGV" in rows["75.crash"]["message"]
    assert started == [6, 1, 1, 1, 1]
    for n in (60, 70, 80, 90):
        one, other = (meshio.read(place / out / f"{n}.vtu") for out in ("together", "apart"))
        assert one.points.tobytes() == other.points.tobytes()
    assert [p.name for p in (place / "apart" / HIDDEN).iterdir()] == ["rows"]


def test_small_inputs_share_a_process_on_workers_too(place, monkeypatch):
    started: list[int] = []
    start = batch._start
    monkeypatch.setattr(batch, "_start",
                        lambda folder, tasks: started.append(len(tasks)) or start(folder, tasks))
    monkeypatch.setattr(cluster, "check_workers", lambda client: 1)
    monkeypatch.setattr(cluster, "as_they_finish", lambda client, function, items: enumerate(
        OSError("gone") if 7 in item else function(item) for item in items))
    paths = [str(write_ball(place / "models" / f"{n}.vtu", n)) for n in range(60, 68)]
    jobs = make_jobs(paths, place / "out", {"finish": False, "smoothing": {"rounds": 1}})
    rows = run_batch(jobs, client=SimpleNamespace(cluster=None))
    assert [row["status"] for row in rows] == ["ok"] * 6 + ["lost"] * 2
    assert [row["source"] for row in rows] == paths
    assert started == [2, 2, 2]


def test_an_input_without_end_costs_those_that_share_its_process_nothing(place):
    paths = [str(write_ball(place / "models" / f"{n}.vtu", n)) for n in (60, 90)]
    (place / "models" / "70.slow").write_text("1000")
    jobs = make_jobs([*paths, "models/70.slow"], place / "out", {"finish": False}, suffix=".vtu",
                     timeout=8.0)
    rows = run_batch(jobs)
    assert [row["status"] for row in rows] == ["ok", "timeout", "ok"], rows[1]["message"]


def test_what_is_large_limited_or_for_tetwild_has_a_process_of_its_own(place, monkeypatch):
    paths = [str(write_ball(place / "models" / f"{n}.vtu", n)) for n in (60, 70, 80)]

    def groups(**settings: Any) -> list[list[int]]:
        return batch.share_out(make_jobs(paths, place / "out", {}, **settings))

    assert groups() == [[0, 1, 2]]
    assert groups(memory_limit=10**9) == [[0], [1], [2]]
    assert groups(tetrahedralize=True) == [[0], [1], [2]]
    monkeypatch.setattr(batch, "TOGETHER", 2)
    assert groups() == [[0, 1], [2]]
    monkeypatch.setattr(batch, "SMALL", os.stat(paths[1]).st_size)
    (place / "models" / "80.vtu").write_bytes(b" " * (batch.SMALL + 1))
    assert groups() == [[0, 1], [2]]


def test_a_batch_is_a_gate(place, capsys):
    for n in (60, 200):
        write_ball(place / "models" / f"{n}.vtu", n)
    words = ["batch", "models/*.vtu", "--out", "out", "--quiet"]
    assert cli.main([*words, "--min-quality", "0.01", "--max-angle", "179.9"]) == 0
    assert not capsys.readouterr().err
    with open("out/summary.csv", newline="") as file:
        least = {row["result"]: float(row["after_min_angle"]) for row in csv.DictReader(file)}
    limit = sum(least.values()) / 2
    worse = min(least, key=lambda name: least[name])
    assert cli.main([*words, "--resume", "--min-angle", str(limit)]) == 3
    lines = capsys.readouterr().err.splitlines()
    assert lines == [f"odt-plugins: {worse} has min_angle {least[worse]:.4g}, expected at least "
                     f"{limit:g}"]


@pytest.mark.parametrize("suffix", ["throw", "abort"])
def test_memory_that_a_limit_refuses_a_library_is_told_as_such(place, suffix):
    (place / "models" / f"a.{suffix}").write_text("")
    ends = []
    for limit in (None, 3 * 10**9):
        (row,) = run_batch(make_jobs([f"models/a.{suffix}"], place / "out", {}, suffix=".vtu",
                                     memory_limit=limit))
        ends.append((row["status"], row["message"]))
    assert ends[0][0] == ("failed" if suffix == "throw" else "crashed")
    assert ends[1] == ("memory", "more than 3 GB needed")


@pytest.mark.parametrize("said", [
    "ImportError: libopenblas.so: failed to map segment from shared object",
    "OpenBLAS error: Memory allocation still failed after 10 retries, giving up."])
def test_memory_that_a_limit_refuses_while_libraries_are_loaded_is_told_as_such(said):
    assert beyond_limit(said, 10**8)
    assert not beyond_limit(said, None)


def test_an_input_without_end_is_given_up(place):
    (place / "models" / "endless.slow").write_text("1000")
    clock = time.monotonic()
    (row,) = run_batch(make_jobs(["models/endless.slow"], place / "out", {}, suffix=".vtu",
                                 timeout=2.0))
    assert 2.0 <= time.monotonic() - clock < 60.0
    assert (row["status"], row["message"]) == ("timeout", "no result within 2 s")
    assert files(place / "out") == []


COMPILES = """
import sys, time
from pathlib import Path
from odt_plugins.distributed.job import note_compiling
from odt_plugins.progress import compiling_heard, compiling_told

with compiling_heard(note_compiling(Path(sys.argv[1]))):
    for seconds in (0.0, 1.0):
        with compiling_told():
            time.sleep(seconds)
"""


def test_a_row_tells_the_regions_and_the_fields_of_a_mesh(place):
    points, cells = tet_meshes.ball(150, 3)
    half = (points[cells].mean(axis=1)[:, 0] > 0.0).astype(int)
    mesh = meshio.Mesh(points, [("tetra", cells)], point_data={"T": points[:, 0]},
                       cell_data={"half": [half], "Material": [half * 2]})
    mesh.write(place / "models" / "two.vtu")
    told = []
    for words in ((), ("--regions", "none", "--fields", "keep")):
        assert cli.main(["batch", "models/two.vtu", "--out", f"out{len(told)}", *words]) == 0
        with open(f"out{len(told)}/summary.csv", newline="") as file:
            told += [(row["regions_from"], row["interpolated"]) for row in csv.DictReader(file)]
    assert told == [("half, Material", "T"), ("", "")]


def test_compiling_kernels_does_not_count_for_the_time_limit(place, monkeypatch):
    subprocess.run([sys.executable, "-c", COMPILES, str(place)], check=True)
    lines = (place / COMPILING).read_text().split()
    assert len(lines) == 4
    assert 1.0 <= compiling(place) < 2.0
    (place / COMPILING).write_text(f"{time.monotonic() - 5.0}\n")
    assert 5.0 <= compiling(place) < 10.0
    (place / COMPILING).write_text(f"{time.monotonic() - 1e6}\n")
    assert compiling(place) == MOST

    def run(timeout: float) -> None:
        with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(1)"],
                              text=True) as process:
            try:
                batch._wait(process, time.monotonic(), timeout, place)
                assert process.returncode == 0
            finally:
                process.kill()

    (place / COMPILING).write_text("0.0\n60.0\n")
    run(0.1)
    (place / COMPILING).write_text("0.0\n0.2\n")
    with pytest.raises(subprocess.TimeoutExpired):
        run(0.1)


def test_what_a_result_loses_is_told_by_its_name_and_no_place_that_is_gone(place):
    angles = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    rows = [f"{np.cos(t)} {np.sin(t)} {z}" for z in (0.0, 0.4, 0.8) for t in angles]
    faces = [f"3 {a} {b} {c}" for ring in (0, 12) for k in range(12)
             for a, b, c in ((ring + k, ring + (k + 1) % 12, ring + 12 + k),
                             (ring + (k + 1) % 12, ring + 12 + (k + 1) % 12, ring + 12 + k))]
    head = ["ply", "format ascii 1.0", f"element vertex {len(rows)}", "property double x",
            "property double y", "property double z", f"element face {len(faces)}",
            "property list uchar int vertex_indices", "element seam 1", "property int vertex",
            "end_header"]
    Path("models/tube.ply").write_text("\n".join([*head, *rows, *faces, "3", ""]))
    (row,) = run_batch(make_jobs(["models/tube.ply"], place / "out", {}, sizes={"scale": 0.5}))
    assert row["status"] == "ok"
    assert "tube.ply" in row["message"]
    assert "the element 'seam'" in row["message"]
    assert HIDDEN not in row["message"]
    assert str(place) not in row["message"]


def test_a_bar_is_told_once_that_kernels_are_compiled(place, monkeypatch):
    told: list[str] = []
    paths = [str(write_ball(place / "models" / f"{n}.vtu", n)) for n in (60, 70)]

    def process(job: Job, folder: Path) -> dict[str, Any]:
        (folder / COMPILING).write_text("1.0\n")
        wait_until(lambda: SAID in told)
        return copied(job, folder)

    monkeypatch.setattr(batch, "TOGETHER", 1)
    monkeypatch.setattr(batch, "_process", process)
    run_batch(make_jobs(paths, place / "out", {}), progress=lambda stage, share: told.append(stage))
    assert told == ["0 of 2", SAID, "1 of 2", "2 of 2"]
    told.clear()
    monkeypatch.setattr(batch, "_process", copied)
    run_batch(make_jobs(paths, place / "out", {}), progress=lambda stage, share: told.append(stage))
    assert told == ["0 of 2", "1 of 2", "2 of 2"]


FIGURES = {f"{when}_{name}": 1 for when in ("before", "after")
           for name in QualitySummary.__dataclass_fields__}


def copied(job: Job, folder: Path) -> dict[str, Any]:
    """A process that does nothing but copy, beside an empty report."""
    target = folder / RESULT / Path(job.name).name
    shutil.copyfile(job.source, target)
    target.with_name(target.name + ".json").write_text("{}")
    return {"status": "ok", "seconds": 0.0}


def test_what_is_done_is_left_as_long_as_input_options_and_result_are_the_same(
    place, monkeypatch
):
    monkeypatch.setattr(batch, "TOGETHER", 1)
    monkeypatch.setattr(batch, "_process", copied)
    a, b = (write_ball(place / "models" / f"{n}.vtu", n) for n in (100, 120))
    settings: dict[str, Any] = {"resume": True}

    def run(**options: Any) -> list[bool]:
        jobs = make_jobs([str(a), str(b)], place / "out", {"finish": False, **options}, **settings)
        rows = run_batch(jobs)
        assert [row["status"] for row in rows] == ["ok", "ok"]
        return [row["resumed"] for row in rows]

    assert run() == [False, False]
    assert run() == [True, True]
    write_ball(a, 110)
    assert run() == [False, True]
    (place / "out" / "120.vtu").unlink()
    assert run(threads=2) == [True, False]
    assert run(smoothing={"rounds": 3}) == [False, False]
    (place / "out" / "100.vtu.json").unlink()
    assert run(smoothing={"rounds": 3}) == [False, True]
    settings["resume"] = False
    assert run(smoothing={"rounds": 3}) == [False, False]


def test_failures_are_left_until_something_changes_or_they_are_to_be_tried_again(
    place, monkeypatch
):
    ends: dict[str, Any] = {}
    monkeypatch.setattr(batch, "_process", lambda job, folder: ends.copy())
    path = str(write_ball(place / "models" / "a.vtu", 60))

    def resumed(retry: bool = False, options: Any = None, **limits: Any) -> bool:
        (row,) = run_batch(make_jobs([path], place / "out", options or {}, resume=True,
                                     retry=retry, **limits))
        assert row["status"] == ends["status"]
        return bool(row["resumed"])

    for status in ("failed", "crashed", "timeout", "memory"):
        ends.update(status=status, message=f"it {status}")
        assert not resumed(retry=True)
        assert resumed()
        assert not resumed(timeout=5.0)
        assert resumed(timeout=5.0)
        assert not resumed(timeout=5.0, memory_limit=10**9)
        assert not resumed(options={"smoothing": {"rounds": 1}})
        assert not resumed(retry=True)
    write_ball(Path(path), 70)
    assert not resumed()
    assert resumed()
    ends["outside"] = True
    assert not resumed(retry=True)
    assert not resumed()
    assert not rows_of(place / "out")


def test_a_result_of_before_is_told_beside_a_failure(place, monkeypatch):
    jobs = make_jobs([str(write_ball(place / "models" / "a.vtu", 60))], place / "out", {})
    monkeypatch.setattr(batch, "_process", copied)
    run_batch(jobs)
    monkeypatch.setattr(batch, "_process", lambda job, folder: {"status": "failed",
                                                                "message": "no"})
    (row,) = run_batch(jobs)
    assert row["message"] == "no; a.vtu is there from an earlier run"
    assert files(place / "out") == ["a.vtu"]


def test_what_the_system_refused_is_no_fault_of_the_input(place):
    full = MeshFileError("cannot write it")
    full.__cause__ = OSError(28, "No space left on device")
    assert outside(full)
    assert outside(MissingDependencyError("needs h5py"))
    (place / "models" / "broken.vtu").write_text("<VTKFile>nonsense")
    for function, given in ((read_file, "models/broken.vtu"), (read_file, "models/a.xyzzy"),
                            (np.linalg.inv, np.zeros((2, 2)))):
        with pytest.raises((MeshFileError, np.linalg.LinAlgError)) as caught:
            function(given)
        assert not outside(caught.value)


def test_keys_name_what_decides_the_result(place):
    path = str(write_ball(place / "models" / "a.vtu", 100))
    jobs = [Job(path, "o", "a.vtu", {}), Job(path, "o", "a.vtu", {"method": "cpt"}),
            Job(path, "o", "a.msh", {}), Job(path, "o", "a.vtu", {}, tetrahedralize=True),
            Job(path, "o", "a.vtu", {}, edge_length=0.1)]
    assert len({job_key(job) for job in jobs}) == len(jobs)
    assert job_key(jobs[0]) == job_key(Job(path, "p", "a.vtu", {}, timeout=1.0, resume=True))


def test_names_of_files_that_are_no_text_are_rows_as_well(place):
    name = os.fsdecode(b"caf\xe9.vtu")
    write_ball(place / "models" / name, 60)
    assert cli.main(["batch", f"models/{name}", "--out", "out", "--quiet", "--no-finish"]) in (0, 1)
    with (place / "out" / "summary.csv").open(encoding="utf-8", newline="") as file:
        (row,) = csv.DictReader(file)
    assert row["result"] == "caf\\udce9.vtu"
    assert (place / "out" / "summary.html").is_file()


@pytest.mark.parametrize("through", ["nowhere", "link"])
def test_results_and_their_summary_lie_in_one_folder(place, through):
    write_ball(place / "models" / "a.vtu", 60)
    (place / "models" / "folder").mkdir()
    (place / "link").symlink_to(place / "models" / "folder")
    assert cli.main(["batch", "models/a.vtu", "--out", f"{through}/../out", "--no-finish"]) == 0
    out = place / ("out" if through == "nowhere" else "models/out")
    assert {"a.vtu", "summary.csv"} <= set(files(out))


@pytest.mark.parametrize("flag", [
    "--timeout=nan", "--memory-limit=nan", "--memory-limit=inf", "--memory-limit=1e12"])
def test_limits_of_batches_are_numbers(place, capsys, flag):
    write_ball(place / "models" / "a.vtu", 60)
    assert cli.main(["batch", "models/a.vtu", "--out", "out", flag]) == 2
    assert f"Invalid value for '{flag.partition('=')[0]}': " in capsys.readouterr().err
    assert not (place / "out").exists()


@pytest.mark.parametrize(("name", "text", "other"), [
    ("a.inp", "*INCLUDE, INPUT=nodes.inc\n*ELEMENT, TYPE=C3D4\n1, 1, 2, 3, 4\n", "nodes.inc"),
    ("a.bdf", "BEGIN BULK\nINCLUDE 'nodes.inc'\nCTETRA,1,1,1,2,3,4\nENDDATA\n", "nodes.inc"),
    ("a.xdmf", '<DataItem Format="HDF">b.h5:/data0</DataItem>', "b.h5"),
    ("a.mesh", "MeshVersionFormatted 2", "a.sol"),
])
def test_keys_name_the_files_that_are_read_with_one(place, name, text, other):
    (place / name).write_text(text)
    job = Job(str(place / name), "o", name, {})
    reference = Job(str(place / name), "o", name, {"reference": str(place / name)})
    keys = set()
    for bytes_beside in (b"1", b"2"):
        (place / other).write_bytes(bytes_beside)
        keys |= {job_key(job), job_key(reference)}
    assert len(keys) == 4


def test_results_never_share_a_place(place):
    for name in ("a.vtu", "a.msh", "inner/a.vtu"):
        write_ball(place / "models" / name, 60)
    paths = find_inputs(["models/a.*", "models/inner/a.vtu"])
    names = [job.name for job in make_jobs(paths, place, {}, suffix=".vtk")]
    assert sorted(names) == ["a-vtu.vtk", "a.vtk", "inner/a.vtk"]
    write_ball(place / "models" / "a-vtu.msh", 60)
    paths = find_inputs(["models/a*", "models/inner/*"])
    assert len({job.name for job in make_jobs(paths, place, {}, suffix=".vtk")}) == len(paths) == 4
    with pytest.raises(InvalidOptionError, match=r"a\.vtu would take the place of an input"):
        make_jobs(["models/a.vtu"], place / "models", {})
    assert make_jobs(["models/a.vtu"], place / "models", {}, suffix=".vtk")
    with pytest.raises(InvalidOptionError, match=r"the folder 'models'; .* try 'models/\*\.vtu'"):
        find_inputs(["models"])
    with pytest.raises(InvalidOptionError, match="names no file"):
        find_inputs(["models/*.xyz"])
    with pytest.raises(InvalidOptionError, match="did you mean 'method'"):
        make_jobs(paths, place, {"methot": "odt"})
    with pytest.raises(InvalidOptionError, match="plain value"):
        make_jobs(paths, place, {"fixed": np.zeros(3, dtype=int)})
    with pytest.raises(MeshFileError, match=r"^suffix=\.xyzzy has no suffix of a mesh file"):
        make_jobs(paths, place, {}, suffix=".xyzzy")
    with pytest.raises(InvalidOptionError, match=r"got suffix='\./x\.vtu'"):
        make_jobs(paths, place, {}, suffix="./x.vtu")


def test_a_folder_that_cannot_be_written_is_told_before_any_work(place, capsys):
    write_ball(place / "models" / "a.vtu", 60)
    (place / "out").write_text("a file")
    assert cli.main(["batch", "models/a.vtu", "--out", "out"]) == 1
    assert "cannot write into" in capsys.readouterr().err
    assert (place / "out").read_text() == "a file"


def test_a_full_disk_is_a_row_and_leaves_nothing_half_written(place):
    import resource

    write_ball(place / "models" / "large.vtu", 1500)
    write_ball(place / "models" / "small.vtu", 60)
    done = subprocess.run(
        [sys.executable, "-m", "odt_plugins", "batch", "models/*.vtu", "--out", "out"],
        capture_output=True, text=True, check=False, timeout=100, env=full_disk(),
        preexec_fn=lambda: (resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000)),
                            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)),
    )
    assert done.returncode == 1, done.stderr
    assert done.stdout.startswith("1 ok, 1 failed")
    with open("out/summary.csv", newline="") as file:
        large = next(csv.DictReader(file))
    assert "cannot write" in large["message"]
    assert "large" in large["source"]
    assert files(place / "out") == ["small.vtu", *(f"summary.{s}" for s in
                                                   ("csv", "html", "parquet"))]
    assert rows_of(place / "out") == ["small.vtu.json"]


def test_surfaces_go_through_tetwild_when_asked(place):
    pytest.importorskip("pytetwild")
    points = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
             [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    side = np.repeat(np.arange(1, 7), 2)
    meshio.Mesh(points, [("triangle", faces)], cell_data={"side": [side]}).write("models/cube.vtu")
    jobs = make_jobs(["models/cube.vtu"], place / "out", {}, tetrahedralize=True, edge_length=0.15)
    (row,) = run_batch(jobs)
    assert row["status"] == "ok", row["message"]
    assert 0.0 < row["tetwild_seconds"] < row["seconds"] - row["optimize_seconds"] + 1e-3
    mesh = meshio.read(place / "out" / "cube.vtu")
    assert tet_meshes.signed_volumes(mesh.points, mesh.cells[0].data).sum() == pytest.approx(
        1.0, abs=0.02)
    label = mesh.cell_data_dict["side"]["triangle"]
    assert np.bincount(label).tolist()[0] == 0
    for value, (axis, end) in zip(range(1, 7), [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1)],
                                  strict=True):
        at = mesh.points[mesh.cells_dict["triangle"][label == value]][:, :, axis]
        assert at == pytest.approx(end, abs=0.01)


def rows_of(folder: Path) -> list[str]:
    return sorted(p.name for p in (folder / HIDDEN / "rows").rglob("*.json"))


def test_a_killed_batch_goes_on_where_it_stopped(place):
    for n in (60, 70, 80):
        write_ball(place / "models" / f"{n}.vtu", n)
    write_ball(place / "models" / "90.vtu", 90)
    (place / "models" / "90.slow").write_text("1000")
    words = [sys.executable, "-m", "odt_plugins", "batch", "models/6*.vtu", "models/7*.vtu",
             "models/90.slow", "--out", "out", "--suffix", ".vtu", "--workers", "2"]
    first = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)
    assert first.stderr is not None
    wait_until(lambda: len(rows_of(place / "out")) == 2)
    started = children(first.pid)
    first.kill()
    first.wait()
    first.stderr.close()
    wait_until(lambda: not any(alive(pid) for pid in started))
    assert files(place / "out") == ["60.vtu", "70.vtu"]
    times = [os.stat(f"out/{n}.vtu").st_mtime_ns for n in (60, 70)]
    (place / "models" / "90.slow").write_text("0")
    done = subprocess.run([*words[:-2], "--resume"], capture_output=True, text=True, check=False,
                          timeout=100)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("3 ok (2 of them before)")
    assert [os.stat(f"out/{n}.vtu").st_mtime_ns for n in (60, 70)] == times
    assert len(meshio.read("out/90.vtu").points) == len(meshio.read("models/90.vtu").points)


@pytest.mark.parametrize(("name", "flags"), [("SIGINT", ["--workers", "2"]), ("SIGTERM", [])])
def test_a_stopped_batch_ends_with_one_line_and_the_summary_of_what_was_done(place, name, flags):
    write_ball(place / "models" / "60.vtu", 60)
    (place / "models" / "90.slow").write_text("1000")
    words = [sys.executable, "-m", "odt_plugins", "batch", "models/60.vtu", "models/90.slow",
             "--out", "out", "--suffix", ".vtu", *flags]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True,
                          start_new_session=True) as process:
        wait_until(lambda: rows_of(place / "out"))
        started = children(process.pid)
        if name == "SIGINT":
            # A terminal sends it to all processes of the group.
            os.killpg(process.pid, signal.SIGINT)
        else:
            process.terminate()
        said = process.communicate(timeout=60)[1]
    assert process.returncode == 1
    assert said.strip() == "odt-plugins: stopped before the end, no half-written file is left"
    wait_until(lambda: not any(alive(pid) for pid in started))
    summary = [f"summary.{suffix}" for suffix in ("csv", "html", "parquet")]
    assert files(place / "out") == ["60.vtu", *summary]
    assert [p.name for p in (place / "out" / HIDDEN).iterdir()] == ["rows"]
    assert table(place / "out") == {"60.vtu": "ok", "90.slow": "stopped"}


def table(out: Path) -> dict[str, str]:
    """Status of every input."""
    with open(out / "summary.csv", newline="") as file:
        return {Path(row["source"]).name: row["status"] for row in csv.DictReader(file)}


def test_the_summary_of_a_stopped_batch_is_completed_by_going_on(place, monkeypatch, capsys):
    names = [f"{n}.vtu" for n in (60, 70, 80)]
    for name in names:
        write_ball(place / "models" / name, int(name[:2]))
    stop_at: list[str] = []

    def process(job: Job, folder: Path) -> dict[str, Any]:
        if job.name in stop_at:
            raise KeyboardInterrupt
        return copied(job, folder) | FIGURES

    monkeypatch.setattr(batch, "TOGETHER", 1)
    monkeypatch.setattr(batch, "_process", process)
    words = ["batch", "models/*.vtu", "--out", "out", "--resume"]

    def run(*stops: str) -> tuple[int, list[str]]:
        stop_at[:] = stops
        return cli.main(words), list(table(place / "out").values())

    assert run("70.vtu") == (1, ["ok", "stopped", "stopped"])
    said = capsys.readouterr()
    assert said.out.startswith("1 ok, 2 stopped\n")
    assert "(1 in " in said.out
    assert said.err.strip() == "odt-plugins: stopped before the end, no half-written file is left"
    assert "1 ok, 2 stopped" in (place / "out" / "summary.html").read_text(encoding="utf-8")
    assert run() == (0, ["ok", "ok", "ok"])
    # What is done already keeps its row, also where a batch is stopped before it comes to it.
    write_ball(place / "models" / "60.vtu", 65)
    assert run("60.vtu") == (1, ["stopped", "ok", "ok"])
    assert capsys.readouterr().out.startswith("3 ok (1 of them before)\n")


def test_a_run_that_was_killed_is_cleared_away_and_one_that_works_is_not(place):
    hidden = place / "out" / HIDDEN
    hidden.mkdir(parents=True)
    with subprocess.Popen([sys.executable, "-c", ""]) as gone:
        gone.wait()
    mine = make_scratch(hidden, "work")
    dead = hidden / mine.name.replace(f"-{os.getpid()}-", f"-{gone.pid}-")
    (dead / "inner").mkdir(parents=True)
    other = hidden / "work-elsewhere-1-x"
    other.mkdir()
    (hidden / f"work-elsewhere-2-x{GONE}").mkdir()
    again = make_scratch(hidden, "work")
    assert sorted(hidden.iterdir()) == sorted([mine, again, other])


def test_a_worker_with_other_packages_is_refused_before_it_does_a_job(place, monkeypatch):
    write_ball(place / "models" / "60.vtu", 60)
    jobs = make_jobs(find_inputs(["models/60.vtu"]), place / "out", {})
    wanted = batch.versions_here() | {"numba": "0.1"}
    monkeypatch.setattr(batch, "versions_here", lambda: wanted)
    with pytest.raises(InvalidOptionError, match=r"has numba .*expected 0\.1 as in"):
        run_batch(jobs)
    refused = InvalidOptionError("the worker on x has numba 1")
    monkeypatch.setattr(batch, "_as_they_finish", lambda *_: iter([(0, refused)]))
    with pytest.raises(InvalidOptionError, match="the worker on x"):
        run_batch(jobs)
    assert not list((place / "out").glob("*.vtu"))


def test_a_process_ends_when_its_work_folder_is_gone(place):
    (place / "models" / "a.slow").write_text("1000")
    work = place / "work"
    (work / RESULT).mkdir(parents=True)
    task = {"source": str(place / "models" / "a.slow"), "folder": str(work), "name": "a.vtu",
            "options": {}, "memory_limit": None, "tetrahedralize": False}
    told = {"tasks": [task], "folder": str(work), "parent": os.getpid()}
    with subprocess.Popen([sys.executable, "-m", "odt_plugins.distributed.job"], text=True,
                          stdin=subprocess.PIPE, start_new_session=True) as process:
        assert process.stdin is not None
        process.stdin.write(json.dumps(told))
        process.stdin.close()
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(2)
        clear(work)
        assert process.wait(30) == -signal.SIGKILL


def test_what_a_killed_worker_was_doing_is_done_by_another(place):
    distributed = pytest.importorskip("distributed")
    for n in (60, 70):
        write_ball(place / "models" / f"{n}.vtu", n)
        (place / "models" / f"{n}.slow").write_text("2")
    jobs = make_jobs(find_inputs(["models/*.slow"]), place / "out", {}, suffix=".vtu")
    rows: list[Any] = []
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as own,
        distributed.Client(own) as client,
    ):
        pids = client.run(os.getpid)
        thread = threading.Thread(target=lambda: rows.extend(run_batch(jobs, client=client)))
        thread.start()
        work = place / "out" / HIDDEN
        wait_until(lambda: len(list(work.glob("work-*/*"))) == 2)
        victim = min(pids.values())
        inner = children(victim)
        assert inner
        os.kill(victim, signal.SIGKILL)
        wait_until(lambda: not any(alive(pid) for pid in inner))
        thread.join(90)
    assert [row["status"] for row in rows] == ["ok"] * 2
    assert files(place / "out") == ["60.vtu", "70.vtu"]
    for name in rows_of(place / "out"):
        row = json.loads((place / "out" / HIDDEN / "rows" / name).read_text())
        assert row["status"] == "ok"


def test_patterns_leave_out_folders_and_results(place, monkeypatch):
    monkeypatch.setattr(batch, "_process", copied)
    write_ball(place / "models" / "a.vtu", 60)
    (place / "models" / "out.vtu").mkdir()
    out = place / "models" / "out"
    run_batch(make_jobs(find_inputs(["models/**/*.vtu"], out), out, {}))
    assert files(out) == ["a.vtu"]
    (out / "a.vtu.json").write_text("{}")
    assert find_inputs(["models/**/*.*"], out) == ["models/a.vtu"]
    write_ball(out / "b.vtu", 60)
    assert find_inputs(["models/**/*.vtu"], out) == ["models/a.vtu", "models/out/b.vtu"]
    assert find_inputs(["models/out/a.vtu"], out) == ["models/out/a.vtu"]
    assert len(find_inputs(["models/**/*.vtu"])) == 3


def test_tetwild_that_is_not_there_is_told_before_any_work(place, monkeypatch, capsys):
    monkeypatch.setattr("odt_plugins.errors.find_spec", lambda name: name != "pytetwild" or None)
    write_ball(place / "models" / "a.stl", 60)
    words = ["batch", "models/a.stl", "--out", "out", "--tetrahedralize"]
    assert cli.main(words) == 1
    assert 'pip install "odt-plugins[pytetwild]"' in capsys.readouterr().err
    assert not (place / "out").exists()


def test_surfaces_that_cannot_be_filled_are_rows(place):
    pytest.importorskip("pytetwild")
    write_ball(place / "models" / "tets.vtu", 60)
    sheet = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    meshio.Mesh(sheet, [("triangle", [[0, 1, 2], [0, 2, 3]])]).write(place / "models" / "open.stl")
    jobs = make_jobs(find_inputs(["models/*.*"]), place / "out", {}, tetrahedralize=True)
    messages = {Path(row["source"]).name: row["message"] for row in run_batch(jobs)}
    assert messages["tets.vtu"] == (
        "tets.vtu holds tetrahedra; expected a surface of triangles to be filled")
    assert "TetWild found no tetrahedra inside the surface" in messages["open.stl"]
    assert files(place / "out") == []


def test_surfaces_that_are_filled_in_part_have_a_status_of_their_own(place):
    pytest.importorskip("pytetwild")
    sphere = trimesh.creation.icosphere(2)
    bowl = trimesh.Trimesh(sphere.vertices, sphere.faces[sphere.triangles_center[:, 2] < 0])
    bowl.export(place / "models" / "bowl.off")
    sphere.export(place / "models" / "ball.off")
    words = ["batch", "models/bowl.off", "models/ball.off", "--out", "out", "--tetrahedralize",
             "--edge-length", "0.2", "--quiet"]
    for again in ([], ["--resume"]):
        assert cli.main([*words, *again]) == 1
        with open(place / "out" / "summary.csv", newline="") as file:
            rows = {Path(row["source"]).name: row for row in csv.DictReader(file)}
        assert rows["bowl.off"]["status"] == "partly filled"
        assert "of the boundary of the result stands for no face" in rows["bowl.off"]["message"]
        assert rows["ball.off"]["status"] == "ok"
        for row in rows.values():
            assert row["resumed"] == str(bool(again))
            assert float(row["after_mean_quality"]) > 0.5
            assert (place / "out" / row["result"]).is_file()


@pytest.mark.parametrize(("name", "again"), [("SIGSEGV", False), ("SIGKILL", True)])
def test_a_tetwild_that_crashes_is_a_crash(place, monkeypatch, name, again):
    folder = place / "toolkits"
    folder.mkdir()
    (folder / "pytetwild.py").write_text(
        f"import os, signal\ndef tetrahedralize(**_): os.kill(os.getpid(), signal.{name})\n")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("PYTHONPATH", str(folder) + os.pathsep + os.environ["PYTHONPATH"])
    path = str(place / "models" / "a.stl")
    meshio.Mesh(np.eye(3), [("triangle", [[0, 1, 2]])]).write(path)
    (row,) = run_batch(make_jobs([path], place / "out", {}, tetrahedralize=True))
    assert row["status"] == "crashed"
    assert f"it was ended by {name}; expected a closed surface" in row["message"]
    # What the user or a system short of memory ended is tried again.
    assert rows_of(place / "out") == ([] if again else ["a.vtu.json"])


def test_a_scene_is_refused_before_any_work_where_its_result_is_to_be_a_mesh(tmp_path):
    trimesh.Scene([trimesh.creation.icosphere(1)]).export(tmp_path / "a.glb")
    paths = [str(tmp_path / "a.glb")]
    assert make_jobs(paths, tmp_path / "out", {})[0].name == "a.glb"
    with pytest.raises(MeshFileError, match=r"cannot write a scene to a\.vtu; try a \.glb file"):
        make_jobs(paths, tmp_path / "out", {}, suffix=".vtu")


def test_a_file_without_a_suffix_of_a_mesh_is_a_row_and_the_others_are_done(place, capsys):
    write_ball(place / "models" / "a.vtu", 60)
    (place / "models" / "readme.txt").write_text("of what is here")
    assert cli.main(["batch", "models/*", "--out", "out"]) == 1
    assert "1 ok, 1 failed" in capsys.readouterr().out
    assert (place / "out" / "a.vtu").is_file()
    assert "readme.txt has no suffix of a mesh file" in (place / "out/summary.csv").read_text()
