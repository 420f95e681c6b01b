"""What a comparison was run on: processor, system, versions."""

from __future__ import annotations

import os
import platform
import sys
import time
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = ("odt-plugins", "numpy", "scipy", "numba", "pyamg", "gmsh", "netgen-mesher", "mmgpy",
            "cgal", "pytetwild", "pymeshlab", "open3d", "pyvista", "scikit-fem", "matplotlib")


def describe(threads: int, seed: int) -> dict[str, str | int]:
    """Give processor, cores, system, date, threads, seed and versions as plain values."""
    facts: dict[str, str | int] = {
        "date": time.strftime("%Y-%m-%d %H:%M:%S %Z"), "processor": _processor(),
        "cores": os.cpu_count() or 1, "system": platform.platform(),
        "python": platform.python_version(), "threads": threads, "seed": seed,
    }
    if hasattr(os, "getloadavg"):
        facts["load at the end"] = f"{os.getloadavg()[0]:.1f}"
    return facts | {name: installed_version(name) for name in PACKAGES}


@cache
def installed_version(name: str) -> str:
    """Version of a package as this process first found it, or "not installed"."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def _processor() -> str:
    if sys.platform == "linux":
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
