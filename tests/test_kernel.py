"""Kernels: compiled the same way everywhere, also where nothing can be cached."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np

import odt_plugins
from odt_plugins.engine import kernel
from odt_plugins.engine.tetrahedron import tet_quality

ENGINE = Path(odt_plugins.__file__).parent / "engine"


def test_all_kernels_go_through_one_decorator():
    for path in ENGINE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert path.name == "kernel.py" or not re.search(r"\bn?jit\b", text), path


def test_kernels_are_cached_and_divide_as_numpy_does():
    @kernel.kernel
    def inverse(x: float) -> float:
        return 1.0 / x

    assert inverse(0.0) == np.inf
    assert tet_quality._cache is not None
    assert tet_quality.targetoptions["nogil"]


def test_without_a_place_for_the_cache_kernels_are_compiled_all_the_same(monkeypatch):
    asked = []

    def njit(**options):
        asked.append(options)
        if options.get("cache"):
            msg = "cannot cache function: no locator available"
            raise RuntimeError(msg)
        return numba.njit(**options)

    monkeypatch.setattr(kernel, "njit", njit)

    @kernel.compiled()
    def twice(x: float) -> float:
        return 2.0 * x

    assert twice(4.0) == 8.0
    assert [bool(options.get("cache")) for options in asked] == [True, False]


def test_a_process_that_may_write_nowhere_can_use_the_engine(tmp_path):
    code = """
import numba.core.caching as caching
caching._CacheLocator.ensure_cache_path = lambda self: (_ for _ in ()).throw(OSError())
from odt_plugins.engine.order import morton_keys
from odt_plugins.engine.star import vertex_stars
import numpy as np
print(vertex_stars(np.array([[0, 1, 2]], dtype=np.int32), 3).indptr.tolist())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["[0,", "1,", "2,", "3]"], done.stderr
