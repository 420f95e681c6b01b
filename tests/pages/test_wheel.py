"""The wheel: one for all Pythons, the same twice, and what it needs with and without a linker.

A library that is there for these sources is taken as it is, by wheels and editable installations.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from email.message import Message
from email.parser import Parser
from pathlib import Path

import pytest

TOP = Path(__file__).parents[2]

BUILD = "import sys, setuptools.build_meta as build; build.build_{}(sys.argv[1])"

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


def built(project: Path, folder: Path, kind: str = "wheel", **chosen: str) -> Path:
    shutil.rmtree(project / "build", ignore_errors=True)
    env = os.environ | {"SOURCE_DATE_EPOCH": "1700000000", "PYTHONPATH": ""} | chosen
    subprocess.run([sys.executable, "-c", BUILD.format(kind), str(folder)], cwd=project, env=env,
                   check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    return wheel


def looked_into(wheel: Path) -> tuple[set[str], Message]:
    with zipfile.ZipFile(wheel) as packed:
        names = {*packed.namelist()}
        (metadata,) = (name for name in names if name.endswith("/METADATA"))
        return names, Parser().parsestr(packed.read(metadata).decode())


LIBRARY = "odt_plugins/engine/compiled/kernels.so"


@pytest.fixture(scope="module")
def wheel(project: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built(project, tmp_path_factory.mktemp("first"), PYTHONHASHSEED="1")


def test_one_wheel_serves_all_pythons_is_the_same_twice_and_needs_no_numba(
        project, wheel, tmp_path):
    second = built(project, tmp_path, PYTHONHASHSEED="2")
    assert "-py3-none-" in wheel.name
    assert not wheel.name.endswith("-any.whl")
    assert wheel.read_bytes() == second.read_bytes()
    names, metadata = looked_into(wheel)
    assert LIBRARY in names
    assert not [need for need in metadata.get_all("Requires-Dist")
                if need.startswith(("numba", "llvmlite")) and "extra" not in need]


@pytest.fixture
def library(project: Path, wheel: Path) -> Iterator[Path]:
    """The library beside the sources, told from one built anew by what follows its code."""
    with zipfile.ZipFile(wheel) as packed:
        (project / LIBRARY).write_bytes(packed.read(LIBRARY) + b"kept")
    yield project / LIBRARY
    (project / LIBRARY).unlink(missing_ok=True)


@pytest.fixture
def unable(tmp_path: Path) -> str:
    """A place on the path with which nothing can be compiled."""
    (tmp_path / "path").mkdir()
    (tmp_path / "path" / "llvmlite.py").write_text("raise ImportError", encoding="utf-8")
    return str(tmp_path / "path")


def test_a_library_of_these_sources_is_not_built_again(project, library, unable, tmp_path):
    kept = library.read_bytes()
    built(project, tmp_path / "editable", "editable", PYTHONPATH=unable)
    assert library.read_bytes() == kept
    packed = zipfile.ZipFile(built(project, tmp_path / "wheel", PYTHONPATH=unable))
    assert packed.read(LIBRARY) == kept


def test_a_library_of_other_sources_or_with_fewer_kernels_is_built_again(
        project, library, unable, tmp_path):
    changes = {"engine/compiled/signatures.txt": KERNELS.replace("i4[1]", "i8[1]"),
               "engine/topology/order.py": "\n"}
    for name, more in changes.items():
        file = project / "odt_plugins" / name
        before = file.read_text(encoding="utf-8")
        file.write_text(before + more, encoding="utf-8")
        names, _ = looked_into(built(project, tmp_path / file.name, PYTHONPATH=unable))
        assert LIBRARY not in names
        file.write_text(before, encoding="utf-8")


def test_without_a_linker_the_package_is_plain_python_and_needs_numba(project, tmp_path):
    wheel = built(project, tmp_path, CC=str(tmp_path / "none"))
    assert wheel.name.endswith("-py3-none-any.whl")
    names, metadata = looked_into(wheel)
    assert LIBRARY not in names
    assert "numba>=0.60" in metadata.get_all("Requires-Dist")
