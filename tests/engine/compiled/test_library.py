"""The library of kernels: what it has, how it is built, and when it is taken."""

from __future__ import annotations

import ast
import importlib
import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import odt_plugins
from odt_plugins import ahead
from odt_plugins.engine.compiled import library
from odt_plugins.engine.compiled.building import levels

PACKAGE = Path(odt_plugins.__file__).parent

DECORATORS = {"kernel", "apart_kernel", "inlined_kernel", "allocating_kernel"}

KERNELS = """
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.compiled.kernel import allocating_kernel, inlined_kernel, kernel


class Pair(NamedTuple):
    values: object
    numbers: tuple


@inlined_kernel
def third(values, at):
    return values[at] / 3.0


@kernel
def shifted(pair, by):
    for k in range(pair.values.shape[0]):
        pair.values[k] = third(pair.values, np.int32(k)) + third(pair.values, k) + by


@allocating_kernel
def sums(table, pair, flag):
    scratch = np.zeros(table.shape[1])
    shifted(Pair(scratch, pair.numbers), 1.0)
    for i in range(table.shape[0]):
        for k in range(table.shape[1]):
            scratch[k] += table[i, k] if flag else 0.0
    shifted(pair, pair.numbers[0])
    return scratch.sum(), pair.numbers[1] + table.shape[1], pair.numbers[0] > 1.0


@kernel
def last(table):
    return table[table.shape[0] - 1, table.shape[1] - 1]
"""

LINES = (
    "odt_kernels_of_a_test.sums(i4[2], odt_kernels_of_a_test.Pair(f8[1], tuple(float64, int64)),"
    " bool)",
    "odt_kernels_of_a_test.last(i4[2])",
    "odt_kernels_of_a_test.shifted(odt_kernels_of_a_test.Pair(f8[1], tuple(float64, int64)),"
    " float64)",
)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, object]:
    """A small library, and the module of its kernels."""
    folder = tmp_path_factory.mktemp("library")
    (folder / "odt_kernels_of_a_test.py").write_text(KERNELS, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", f"{folder}{os.pathsep}{PACKAGE.parent}")
        patch.syspath_prepend(str(folder))
        patch.setattr(ahead, "WORKERS", 1)
        ahead.build(folder / "small.so", LINES)
        yield folder / "small.so", importlib.import_module("odt_kernels_of_a_test")


@pytest.fixture
def loaded(built, monkeypatch):
    """The small library in the place of the other one, and the module of its kernels."""
    file, module = built
    entries = library.load(file)
    assert {*entries} == {*LINES}
    monkeypatch.setattr("odt_plugins.engine.compiled.kernel.library", lambda: entries)
    monkeypatch.setattr("odt_plugins.engine.compiled.kernel.by_numba", refused)
    for name in ("sums", "last"):
        getattr(module, name).loaded.clear()
        getattr(module, name).runs.clear()
    return module


def refused(kernel, args):
    raise AssertionError(kernel)


def in_python(kernel, *args):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NUMBA_DISABLE_JIT", "1")
        return kernel.py_func(*args)


def test_kernels_of_a_library_do_as_they_do_in_python(loaded):
    table = np.arange(6, dtype=np.int32).reshape(2, 3)
    for flag in (True, np.bool_(False)):
        one, two = (loaded.Pair(np.array([3.0, 6.0]), (1.5, np.int64(4))) for _ in range(2))
        result = loaded.sums(table, one, flag)
        assert result == in_python(loaded.sums, table, two, flag)
        assert [*map(type, result)] == [float, int, bool]
        assert (one.values == two.values).all()
    assert loaded.last(table) == 5


def test_arrays_that_lie_otherwise_go_through_copies(loaded):
    table = np.arange(12, dtype=np.int32).reshape(2, 6)
    table.flags.writeable = False
    values = np.arange(8.0)
    pair = loaded.Pair(values[::2], (1.5, 4))
    twin = loaded.Pair(np.arange(8.0)[::2], (1.5, 4))
    assert loaded.sums(table.T, pair, True) == in_python(loaded.sums, table.T, twin, True)
    assert (pair.values == twin.values).all()
    assert values[1::2].tolist() == [1.0, 3.0, 5.0, 7.0]
    for seen in (table, table.T, table[:, ::2], table[:0:-1], table.astype(np.int32, order="F")):
        assert loaded.last(seen) == seen[-1, -1]


def test_any_number_of_processes_builds_the_same_library(built, tmp_path, monkeypatch):
    file, module = built
    folder = Path(module.__file__).parent
    monkeypatch.setenv("PYTHONPATH", f"{folder}{os.pathsep}{PACKAGE.parent}")
    monkeypatch.setattr(ahead.os, "cpu_count", lambda: 2)
    monkeypatch.setattr(ahead, "WORKERS", 2)
    ahead.build(tmp_path / "small.so", LINES)
    assert (tmp_path / "small.so").read_bytes() == file.read_bytes()


def test_other_types_are_for_numba(loaded):
    for other in (np.zeros((2, 2)), np.zeros(3, np.int32), np.zeros((2, 2), ">i4"), 3):
        with pytest.raises(AssertionError):
            loaded.last(other)


def test_a_library_of_other_sources_or_none_is_left_alone(built, monkeypatch, tmp_path):
    file, _ = built
    assert library.load(tmp_path / "none.so") == {}
    (tmp_path / "text.so").write_text("no library", encoding="utf-8")
    assert library.load(tmp_path / "text.so") == {}
    monkeypatch.setattr(library, "stamp", lambda: "another")
    assert library.load(file) == {}
    monkeypatch.undo()
    monkeypatch.setattr(library, "HEAD", library.HEAD + 8)
    assert library.load(file) == {}


def test_a_named_processor_gets_its_level_of_a_library(built, monkeypatch):
    file, _ = built
    asked = []
    monkeypatch.setattr(library, "_entry", lambda function, line: asked.append(function.__name__))
    monkeypatch.delenv(library.PROCESSOR, raising=False)
    library.load(file)
    best = int(asked[-1].split("_")[1])
    for level, name in enumerate(levels(), 1):
        asked.clear()
        monkeypatch.setenv(library.PROCESSOR, name)
        library.load(file)
        assert asked == [f"odt_{level}_{k}" for k in range(len(LINES)) if level <= best]
    monkeypatch.setenv(library.PROCESSOR, "another")
    assert library.load(file) == {}


@pytest.mark.parametrize("name", library.CHOSEN)
def test_whoever_chooses_how_numba_compiles_gets_kernels_of_numba(name, monkeypatch):
    for other in library.CHOSEN:
        monkeypatch.delenv(other, raising=False)
    monkeypatch.setattr(library, "load", lambda file: {"kernel": None})
    assert library.library.__wrapped__() == {"kernel": None}
    monkeypatch.setenv(name, "1")
    assert library.library.__wrapped__() == {}


def test_building_tells_what_failed(tmp_path, monkeypatch):
    monkeypatch.setenv("CC", str(tmp_path / "no-linker"))
    with pytest.raises(OSError, match="no-linker"):
        ahead.build(tmp_path / "a.so", ["odt_plugins.engine.cells.cost.is_energy(int64)"])
    with pytest.raises(subprocess.CalledProcessError):
        ahead.build(tmp_path / "a.so", ["odt_plugins.engine.cells.cost.no_kernel(int64)"])
    assert not [*tmp_path.iterdir()]


def test_every_kernel_that_python_calls_is_written_down():
    written = {line.partition("(")[0] for line in
               ahead.SIGNATURES.read_text(encoding="utf-8").splitlines()}
    trees = {".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts):
             ast.parse(path.read_text(encoding="utf-8")) for path in PACKAGE.rglob("*.py")}
    kernels = {(module, node.name) for module, tree in trees.items() for node in tree.body
               if is_kernel(node)}
    called = set()
    for module, tree in trees.items():
        here = {name: (at, name) for at, name in kernels if at == module}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom):
                here |= {alias.asname or alias.name: (node.module, alias.name)
                         for alias in node.names if (node.module, alias.name) in kernels}
        for node in ast.walk(tree) if here else ():
            if isinstance(node, ast.FunctionDef) and not is_kernel(node):
                parts = [*ast.walk(node)]
                # Of a kernel's ``py_func`` there is no machine code.
                others = {id(part.value) for part in parts if isinstance(part, ast.Attribute)}
                names = [part for part in parts
                         if isinstance(part, ast.Name) and id(part) not in others]
                own = {part.id for part in names if isinstance(part.ctx, ast.Store)}
                own |= {arg.arg for arg in parts if isinstance(arg, ast.arg)}
                called |= {".".join(here[part.id]) for part in names if part.id in here
                           and part.id not in own}
    assert len(called) > 70
    assert called <= written
    for name in written:
        module, _, last = name.rpartition(".")
        assert (module, last) in kernels


def is_kernel(node: ast.AST) -> bool:
    return isinstance(node, ast.FunctionDef) and bool(
        {getattr(mark, "id", "") for mark in node.decorator_list} & DECORATORS)


def test_what_is_written_down_fits_the_kernels():
    for line in ahead.SIGNATURES.read_text(encoding="utf-8").splitlines():
        call = ast.parse(line, mode="eval").body
        kernel = getattr(importlib.import_module(ast.unparse(call.func.value)), call.func.attr)
        assert len(inspect.signature(kernel.py_func).parameters) == len(call.args), line
        for part in ast.walk(call):
            inner = isinstance(part, ast.Call) and part is not call
            if inner and ast.unparse(part.func) != "tuple":
                made = getattr(importlib.import_module(ast.unparse(part.func.value)),
                               part.func.attr)
                assert len(made._fields) == len(part.args), line


RUN = """
import sys
sys.modules["numba"] = sys.modules["llvmlite"] = None
from odt_plugins import ahead, optimize
from odt_plugins.compare.start import ball, plate
from odt_plugins.engine.compiled import threads
from odt_plugins.engine.topology import coloring, order
from odt_plugins.generate.clouds import pebble
threads.THREADED_CELLS = 0
# The last run below cuts a small mesh into slabs.
del ahead.RUNS["cells"]["ball", ahead.LARGE]
# A kernel is chosen by the types of its arguments, not by how many vertices there are.
ahead.SMALL = 100
for name, runs in ahead.RUNS.items():
    ahead.RUNS[name] = {(mesh, ahead.SMALL): options for (mesh, _), options in runs.items()}
    ahead.run(name)
optimize(pebble(1000))
optimize((plate(1000).points, plate(1000).cells))
optimize((ball(300).points, ball(300).cells), boundary="slide", insert=True, threads=2)
coloring.ONE_BLOCK, coloring.SMALLEST, order.LAYERS = 0, 8, 4
optimize((ball(1500).points, ball(1500).cells), threads=2, smoothing={"rounds": 2})
"""


def test_usual_runs_need_no_numba():
    if not library.library():
        pytest.fail("no library of these sources; python -m odt_plugins.ahead "
                    f"{library.FILE.relative_to(PACKAGE.parent)}")
    done = subprocess.run([sys.executable, "-c", RUN], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_no_private_name_of_numba_or_llvmlite_is_used():
    for path in PACKAGE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        if re.search(r"^(import|from) (numba|llvmlite)", text, re.MULTILINE):
            assert not re.search(r"numba\.core|llvmlite\.\w+\._|import _", text), path
