"""Blocks on a real Dask cluster: worker processes on loopback that are killed, missing or wrong."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from processes import alive, children, full_disk, wait_until

import odt_plugins
from odt_plugins.cli import main as cli
from odt_plugins.compare.start import ball
from odt_plugins.distributed import cluster as cluster_module
from odt_plugins.distributed import optimize as blocks_module
from odt_plugins.distributed.local import executor
from odt_plugins.distributed.versions import expect_versions, versions_here
from odt_plugins.errors import InvalidOptionError, WorkerError

distributed = pytest.importorskip("distributed")

pytestmark = [
    pytest.mark.timeout(120),
    # Dask ends its processes and sockets behind the back of the collector.
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]

START = ball(2500)
MESH = (START.points, START.cells)
BLOCKS = 3

COMMAND = """
import sys
from odt_plugins.cli.main import main
from odt_plugins.distributed import optimize
optimize.LEAST_CELLS = 1000
sys.exit(main(sys.argv[1:]))
"""
"""The command line, for which small meshes are worth blocks."""


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blocks_module, "LEAST_CELLS", 1000)
    monkeypatch.setattr(blocks_module, "WORTH_CELLS", 0)


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    """Two worker processes with their nannies."""
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as own,
        distributed.Client(own) as client,
    ):
        yield client


@pytest.fixture(scope="module")
def expected() -> tuple[Any, Any]:
    """The result in this process."""
    least, blocks_module.LEAST_CELLS = blocks_module.LEAST_CELLS, 1000
    try:
        result: tuple[Any, Any] = odt_plugins.optimize(MESH, blocks=BLOCKS)
    finally:
        blocks_module.LEAST_CELLS = least
    return result


def assert_same(a: Any, b: Any) -> None:
    assert all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def test_processes_and_a_cluster_give_the_bits_of_one_process(client, expected):
    assert not np.array_equal(expected[0], START.points)
    assert_same(odt_plugins.optimize(MESH, blocks=BLOCKS, workers=2), expected)
    assert_same(odt_plugins.optimize(MESH, blocks=BLOCKS, client=client), expected)


@pytest.mark.parametrize(("more", "processes"), [(0, 2), (1, 0)])
def test_processes_are_started_for_large_meshes_only(monkeypatch, more, processes):
    asked: list[int] = []

    def seen(client: Any = None, workers: int = 0) -> Any:
        asked.append(workers)
        return executor()

    start = ball(600)
    monkeypatch.setattr(blocks_module, "WORTH_CELLS", len(start.cells) + more)
    monkeypatch.setattr(blocks_module, "executor", seen)
    odt_plugins.optimize((start.points, start.cells), blocks=BLOCKS, workers=2)
    assert asked == [processes]


def test_pieces_on_a_cluster_give_the_bits_of_one_process(client, tmp_path):
    start = ball(1000)
    for k, name in enumerate(("left", "right")):
        cells = start.cells[(start.points[start.cells].mean(axis=1)[:, 0] > 0.0) == k]
        used, number = np.unique(cells, return_inverse=True)
        mesh = meshio.Mesh(start.points[used], [("tetra", number.reshape(-1, 4))])
        (tmp_path / "in").mkdir(exist_ok=True)
        mesh.write(tmp_path / "in" / f"{name}.vtu")
    odt_plugins.optimize(tmp_path / "in", target=tmp_path / "here.pvtu")
    odt_plugins.optimize(tmp_path / "in", target=tmp_path / "there.pvtu", client=client)
    for k in range(3):
        a, b = (meshio.read(tmp_path / name / f"{name}-{k}.vtu") for name in ("here", "there"))
        assert np.array_equal(a.points, b.points)
        assert np.array_equal(a.cells[0].data, b.cells[0].data)


def test_a_worker_killed_in_the_middle_of_a_block_is_made_up_for(client, expected):
    result: list[Any] = []
    thread = threading.Thread(target=lambda: result.append(
        odt_plugins.optimize(MESH, blocks=BLOCKS, client=client)))
    pids = client.run(os.getpid)
    thread.start()
    busy: list[str] = []

    def started() -> bool:
        busy[:] = [w for w, tasks in client.processing().items() if tasks]
        return bool(busy)

    wait_until(started)
    os.kill(pids[busy[0]], signal.SIGKILL)
    thread.join(90)
    assert result, "the run did not end"
    assert_same(result[0], expected)
    client.wait_for_workers(2, timeout=60)
    assert set(client.run(os.getpid).values()) != set(pids.values())


def test_a_worker_with_another_version_is_refused_before_any_work(client, tmp_path):
    metadata = tmp_path / "odt_plugins-9.9.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: odt-plugins\nVersion: 9.9\n")
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    worker = subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_worker", client.scheduler.address,
         "--nthreads", "1", "--no-dashboard", "--no-nanny", "--name", "other"],
        env={**os.environ, "PYTHONPATH": path}, cwd=tmp_path,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )
    try:
        wait_until(lambda: len(client.scheduler_info(n_workers=-1)["workers"]) == 3)
        with pytest.raises(InvalidOptionError, match=r"worker tcp://.* has odt-plugins 9\.9"):
            odt_plugins.optimize(MESH, blocks=BLOCKS, client=client)
        assert not any(client.processing().values())
    finally:
        worker.terminate()
        worker.wait(30)
    wait_until(lambda: len(client.scheduler_info(n_workers=-1)["workers"]) == 2)


def test_versions_are_compared_where_a_block_is_worked_on():
    expect_versions(versions_here())
    with pytest.raises(InvalidOptionError, match=r"worker on .* has numpy .*expected 0\.1"):
        expect_versions({"numpy": "0.1"})
    with pytest.raises(InvalidOptionError, match="the worker x has numba not installed"):
        expect_versions({"numba": "1"}, {"numpy": "1"}, "the worker x")


def explode(block: Any) -> Any:
    os.kill(os.getpid(), signal.SIGKILL)


LOSING = """
import os, signal
from odt_plugins.distributed.local import executor

def explode(block):
    os.kill(os.getpid(), signal.SIGKILL)

if __name__ == "__main__":
    with executor(workers=1) as apply:
        list(apply(explode, [1, 2]))
"""


def test_lost_processes_end_the_run_with_a_sentence(tmp_path):
    (tmp_path / "losing.py").write_text(LOSING)
    done = subprocess.run([sys.executable, "losing.py"], cwd=tmp_path, capture_output=True,
                          text=True, check=False, timeout=200)
    assert done.returncode == 1
    assert "WorkerError: a worker process ended before its work did" in done.stderr


STOPPED = """
import os, signal, sys, time
from odt_plugins.distributed.local import executor

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with executor(workers=2) as apply:
        for _ in apply(time.sleep, [0, 100]):
            if sys.argv[1] == "Ctrl-C":
                os.killpg(0, signal.SIGINT)
                time.sleep(5)
            raise ValueError(sys.argv[1])
"""


@pytest.mark.parametrize(("why", "last"), [("Ctrl-C", "KeyboardInterrupt"),
                                           ("of progress", "ValueError: of progress")])
def test_processes_end_at_once_and_without_a_word_where_a_run_is_stopped(why, last, tmp_path):
    (tmp_path / "stopped.py").write_text(STOPPED)
    done = subprocess.run([sys.executable, "stopped.py", why], cwd=tmp_path, text=True, check=False,
                          capture_output=True, timeout=60, start_new_session=True)
    assert done.returncode != 0
    assert done.stderr.splitlines()[-1] == last
    assert done.stderr.count("Traceback") == 1


UNGUARDED = ["""
from odt_plugins.distributed.local import executor

with executor(workers=1) as apply:
    list(apply(abs, [1, 2]))
""", """
from pathlib import Path
from odt_plugins.distributed.batch import make_jobs, run_batch

run_batch(make_jobs(["unguarded.py"], Path("out"), {}), workers=1)
"""]


@pytest.mark.parametrize("script", UNGUARDED, ids=["blocks", "batch"])
def test_scripts_that_processes_cannot_import_end_with_a_sentence(script, tmp_path):
    (tmp_path / "unguarded.py").write_text(script)
    done = subprocess.run([sys.executable, "unguarded.py"], cwd=tmp_path, capture_output=True,
                          text=True, check=False, timeout=60)
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert "WorkerError: worker processes ended while they imported the script" in last
    assert 'if __name__ == "__main__":' in last


def test_work_that_kills_every_worker_ends_the_run_with_a_sentence(client):
    import dask

    apply = cluster_module.on_cluster(client)
    with dask.config.set({"distributed.scheduler.allowed-failures": 0}):
        client.run_on_scheduler(lambda dask_scheduler: setattr(
            dask_scheduler, "allowed_failures", 0))
        with pytest.raises(WorkerError, match="the cluster lost the work"):
            list(apply(explode, [1]))
    client.run_on_scheduler(lambda dask_scheduler: setattr(dask_scheduler, "allowed_failures", 3))
    client.wait_for_workers(2, timeout=60)


def test_workers_that_are_paused_for_good_end_the_run_with_a_sentence(monkeypatch):
    import dask

    monkeypatch.setattr(cluster_module, "PATIENCE", 1.0)
    with (
        dask.config.set({"distributed.worker.memory.pause": 1e-3}),
        distributed.LocalCluster(n_workers=1, processes=False, memory_limit="4GB",
                                 dashboard_address=":0") as own,
        distributed.Client(own) as client,
    ):
        # a worker looks at its memory from time to time
        wait_until(lambda: cluster_module._all_paused(client))
        client.wait_for_workers = lambda *_, **__: None
        with pytest.raises(WorkerError, match="all workers of the cluster are paused"):
            list(cluster_module.on_cluster(client)(explode, [1]))


def test_a_scheduler_that_is_killed_ends_the_run_with_a_sentence(tmp_path):
    meshio.Mesh(START.points, [("tetra", START.cells)]).write(tmp_path / "in.vtu")
    file = tmp_path / "scheduler.json"
    options = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": tmp_path}
    scheduler = subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_scheduler", "--scheduler-file", str(file),
         "--host", "127.0.0.1", "--port", "0", "--no-dashboard"], **options)
    worker = None
    try:
        wait_until(lambda: file.exists() and file.read_text().endswith("}"))
        worker = subprocess.Popen(
            [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", str(file),
             "--nthreads", "1", "--no-dashboard", "--no-nanny"], **options)
        address = json.loads(file.read_text())["address"]
        run = run_cli(tmp_path, "optimize", "in.vtu", "out.vtu", "--blocks", str(BLOCKS),
                      "--scheduler", address)
        with distributed.Client(address) as client:
            wait_until(lambda: any(client.processing().values()))
            scheduler.kill()
        _, said = run.communicate(timeout=60)
    finally:
        for process in (scheduler, worker):
            if process is not None:
                process.kill()
                process.wait()
    assert run.returncode == 1
    lines = said.strip().splitlines()
    assert lines[0].startswith("Dask dashboard")
    assert lines[1:] == [f"odt-plugins: the connection to the scheduler {address} was lost; "
                         "expected it to be there until the end, try the run again"]
    assert not (tmp_path / "out.vtu").exists()


def test_nobody_at_the_address_is_one_sentence(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(cluster_module, "PATIENCE", 1.0)
    meshio.Mesh(START.points, [("tetra", START.cells)]).write(tmp_path / "in.vtu")
    paths = [str(tmp_path / "in.vtu"), str(tmp_path / "out.vtu")]
    assert cli.main(["optimize", *paths, "--scheduler", "tcp://127.0.0.1:1"]) == 2
    assert "need --blocks" in capsys.readouterr().err
    assert cli.main(["optimize", *paths, "--blocks", "2", "--scheduler", "tcp://127.0.0.1:1"]) == 1
    said = capsys.readouterr().err.strip()
    assert said.startswith("odt-plugins: no scheduler answers at tcp://127.0.0.1:1")
    assert "\n" not in said
    assert not (tmp_path / "out.vtu").exists()


def run_cli(folder: Path, *words: str, **settings: Any) -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, "-c", COMMAND, *words], cwd=folder,
                            stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True,
                            **settings)


WAITING = """
import time
from odt_plugins.distributed.local import executor
with executor(workers=1) as apply:
    list(apply(time.sleep, [1000.0]))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="looks at /proc")
def test_processes_end_with_the_one_that_started_them():
    first = subprocess.Popen([sys.executable, "-c", WAITING])
    wait_until(lambda: len(children(first.pid)) > 1)
    started = children(first.pid)
    time.sleep(1.0)
    first.kill()
    first.wait()
    wait_until(lambda: not any(alive(pid) for pid in started))


@pytest.mark.skipif(sys.platform != "linux", reason="looks at /proc")
def test_a_killed_client_leaves_nothing_and_the_next_run_is_whole(client, tmp_path, expected):
    meshio.Mesh(START.points, [("tetra", START.cells)]).write(tmp_path / "in.vtu")
    words = ["optimize", "in.vtu", "out.vtu", "--blocks", str(BLOCKS)]
    first = run_cli(tmp_path, *words, "--scheduler", client.scheduler.address)
    assert first.stderr is not None
    assert "dashboard" in first.stderr.readline()
    first.kill()
    first.wait()
    first.stderr.close()
    assert os.listdir(tmp_path) == ["in.vtu"]
    second = run_cli(tmp_path, *words, "--scheduler", client.scheduler.address)
    _, said = second.communicate(timeout=90)
    assert second.returncode == 0, said
    out = meshio.read(tmp_path / "out.vtu")
    assert np.array_equal(out.points, expected[0])
    assert sorted(os.listdir(tmp_path)) == ["in.vtu", "out.vtu"]


@pytest.mark.skipif(sys.platform == "win32", reason="limits of POSIX")
def test_a_full_disk_leaves_the_old_file(tmp_path):
    import resource

    meshio.Mesh(START.points, [("tetra", START.cells)]).write(tmp_path / "in.vtu")
    (tmp_path / "out.vtu").write_text("old")
    run = run_cli(tmp_path, "optimize", "in.vtu", "out.vtu", "--blocks", "2", "--quiet",
                  env=full_disk(),
                  preexec_fn=lambda: (resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000)),
                                      signal.signal(signal.SIGXFSZ, signal.SIG_IGN)))
    _, said = run.communicate(timeout=90)
    assert run.returncode == 1
    assert "cannot write out.vtu" in said
    assert (tmp_path / "out.vtu").read_text() == "old"
    assert sorted(os.listdir(tmp_path)) == ["in.vtu", "out.vtu"]
