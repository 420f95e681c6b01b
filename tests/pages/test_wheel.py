"""The wheel: one for all Pythons, the same twice, and what it needs with and without a linker."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from email.message import Message
from email.parser import Parser
from pathlib import Path

import pytest

TOP = Path(__file__).parents[2]

BUILD = "import sys, setuptools.build_meta as build; build.build_wheel(sys.argv[1])"

KERNELS = "odt_plugins.engine.topology.order._sort_by_lowest(i4[2], i8[1], i4[1])\n"


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sources with one kernel for the library, which takes seconds."""
    folder = tmp_path_factory.mktemp("project")
    for name in ("LICENSE", "README.md", "pyproject.toml", "setup.py"):
        shutil.copy(TOP / name, folder)
    shutil.copytree(TOP / "examples", folder / "examples")
    shutil.copytree(TOP / "odt_plugins", folder / "odt_plugins",
                    ignore=shutil.ignore_patterns("__pycache__", "kernels.so"))
    signatures = folder / "odt_plugins" / "engine" / "compiled" / "signatures.txt"
    assert KERNELS in signatures.read_text(encoding="utf-8")
    signatures.write_text(KERNELS, encoding="utf-8")
    return folder


def built(project: Path, folder: Path, **chosen: str) -> Path:
    shutil.rmtree(project / "build", ignore_errors=True)
    env = os.environ | {"SOURCE_DATE_EPOCH": "1700000000", "PYTHONPATH": ""} | chosen
    subprocess.run([sys.executable, "-c", BUILD, str(folder)], cwd=project, env=env, check=True,
                   capture_output=True)
    (wheel,) = folder.glob("*.whl")
    return wheel


def looked_into(wheel: Path) -> tuple[set[str], Message]:
    with zipfile.ZipFile(wheel) as packed:
        names = {*packed.namelist()}
        (metadata,) = (name for name in names if name.endswith("/METADATA"))
        return names, Parser().parsestr(packed.read(metadata).decode())


LIBRARY = "odt_plugins/engine/compiled/kernels.so"


def test_one_wheel_serves_all_pythons_is_the_same_twice_and_needs_no_numba(project, tmp_path):
    first, second = (built(project, tmp_path / name, PYTHONHASHSEED=name) for name in "12")
    assert "-py3-none-" in first.name
    assert not first.name.endswith("-any.whl")
    assert first.read_bytes() == second.read_bytes()
    names, metadata = looked_into(first)
    assert LIBRARY in names
    assert not [need for need in metadata.get_all("Requires-Dist")
                if need.startswith(("numba", "llvmlite")) and "extra" not in need]


def test_without_a_linker_the_package_is_plain_python_and_needs_numba(project, tmp_path):
    wheel = built(project, tmp_path, CC=str(tmp_path / "none"))
    assert wheel.name.endswith("-py3-none-any.whl")
    names, metadata = looked_into(wheel)
    assert LIBRARY not in names
    assert "numba>=0.60" in metadata.get_all("Requires-Dist")
