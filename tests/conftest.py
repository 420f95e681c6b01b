"""Settings shared by all tests; in CI one that is skipped fails the run."""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import settings

settings.register_profile("odt", deadline=None, max_examples=25, derandomize=True)
settings.load_profile("odt")


# A process of tests holds many toolkits: looking through all of them for garbage takes long.
gc.set_threshold(100_000, 20, 20)


# Shells start what runs in the background deaf to Ctrl-C, and processes of tests inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def many_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Meshes of any size are worth several threads."""
    from odt_plugins.engine.compiled import threads

    monkeypatch.setattr(threads, "THREADED_CELLS", 0)


@pytest.fixture
def many_blocks(monkeypatch: pytest.MonkeyPatch, many_threads: None) -> None:
    """Small meshes have blocks of vertices in colours, chunks of which threads do side by side."""
    from odt_plugins.engine.topology import coloring

    monkeypatch.setattr(coloring, "ONE_BLOCK", 0)
    monkeypatch.setattr(coloring, "SMALLEST", 8)


@pytest.fixture
def kernels_in_python(monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels are functions of Python, where numba would compile for longer than these take."""
    from odt_plugins.engine.compiled.kernel import Kernel

    monkeypatch.setattr(Kernel, "__call__", lambda self, *args: self.py_func(*args))


@pytest.fixture
def nothing_compiled(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Kernels are those of the library; one that it lacks, and all it calls, run in Python.

    What the library lacks is part of kernels that it has, and numba compiles it for many seconds.
    """
    from odt_plugins.engine.compiled import kernel as kernels

    lacking = []

    def run(kernel, args):
        with pytest.MonkeyPatch.context() as within, np.errstate(all="ignore"):
            within.setattr(kernels.Kernel, "__call__", lambda self, *args: self.py_func(*args))
            return kernel.py_func(*args)

    def in_python(kernel, args):
        lacking.append(kernel)
        return lambda args, slots: run(kernel, args)

    monkeypatch.setattr(kernels, "by_numba", in_python)
    yield
    for kernel in lacking:
        kernel.runs.clear()
        kernel.loaded.clear()


@pytest.fixture(params=[2, 3], ids=["d2", "d3"])
def d(request: pytest.FixtureRequest) -> int:
    """Dimension of the space."""
    return int(request.param)


def pytest_sessionfinish(session: pytest.Session) -> None:
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    skipped = len(reporter.stats.get("skipped", [])) if reporter else 0
    if skipped and os.environ.get("CI") == "true":
        reporter.write_line(f"{skipped} tests were skipped; CI allows none", red=True)
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


@pytest.fixture(autouse=True, scope="module")
def gmsh_ends():
    """No test finds a session of Gmsh, its models and options, that another file of tests left."""
    yield
    gmsh = sys.modules.get("gmsh")
    if gmsh is not None and gmsh.isInitialized():
        gmsh.finalize()
