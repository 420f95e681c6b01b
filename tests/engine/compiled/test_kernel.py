"""Kernels: compiled the same way everywhere, also where nothing can be cached."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from processes import full_disk

import odt_plugins
from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.compiled import kernel, library, plain
from odt_plugins.engine.topology.lookup import place_in
from odt_plugins.progress import compiling_heard

ENGINE = Path(odt_plugins.__file__).parent / "engine"

DECORATORS = {"kernel", "apart_kernel", "inlined_kernel", "allocating_kernel"}


def test_all_kernels_go_through_one_decorator():
    for path in ENGINE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert path.name in ("building.py", "plain.py") or not re.search(r"\bnjit\(", text), path


@pytest.fixture(scope="module")
def trees() -> dict[str, ast.Module]:
    """The sources of the engine by the names of the modules."""
    return {f"odt_plugins.engine.{'.'.join(path.relative_to(ENGINE).with_suffix('').parts)}":
            ast.parse(path.read_text(encoding="utf-8")) for path in ENGINE.rglob("*.py")}


def test_every_loop_of_a_kernel_has_a_bound_before_it_begins(trees):
    loops = 0
    for module, tree in trees.items():
        for node in tree.body:
            if not isinstance(node, ast.FunctionDef):
                continue
            if not any("kernel" in ast.unparse(mark) for mark in node.decorator_list):
                continue
            inner = list(ast.walk(node))
            loops += sum(isinstance(part, ast.For) for part in inner)
            endless = [part.lineno for part in inner if isinstance(part, ast.While)]
            assert not endless, (module, node.name, endless)
    assert loops > 200


def test_a_place_is_looked_for_in_its_own_row_only():
    rows = np.arange(12, dtype=np.int32).reshape(4, 3)
    assert [place_in(rows, 1, value) for value in (3, 4, 5)] == [0, 1, 2]
    for value in (2, 6, 11, -1):
        assert 0 <= place_in(rows, 1, value) < 3


def test_no_index_of_a_kernel_is_written_as_a_negative_number(trees):
    """A library takes an index for what counts from the start, where numba counts others back."""
    found = 0
    for module, tree in trees.items():
        for node in ast.walk(tree):
            if not isinstance(node, ast.FunctionDef):
                continue
            if not {getattr(mark, "id", "") for mark in node.decorator_list} & DECORATORS:
                continue
            for part in ast.walk(node):
                if isinstance(part, ast.Subscript):
                    found += 1
                    assert not any(isinstance(inner, ast.USub) for inner in ast.walk(part.slice)), (
                        module, part.lineno)
    assert found > 1000


CHECKED = """
import numpy as np
from odt_plugins.engine.compiled.kernel import kernel

@kernel
def element(row, at):
    return row[at]

print(element(np.arange(3.0), 2))
try:
    element(np.arange(3.0), 3)
except IndexError as error:
    print("stopped:", error)
"""


def test_indices_are_checked_where_numba_is_told_to(tmp_path):
    (tmp_path / "kernels.py").write_text(CHECKED, encoding="utf-8")
    done = subprocess.run([sys.executable, str(tmp_path / "kernels.py")], check=True, text=True,
                          capture_output=True, env=os.environ | {
                              "NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_BOUNDSCHECK": "1"})
    assert done.stdout.startswith("2.0\n")
    assert "stopped: index is out of bounds" in done.stdout


def test_kernels_divide_as_numpy_does():
    @kernel.kernel
    def inverse(x: float) -> float:
        return 1.0 / x

    assert inverse(0.0) == np.inf


def test_code_is_chosen_by_the_types_of_the_arguments():
    @kernel.kernel
    def halves(x: float) -> float:
        return x / 2

    assert [halves(x) for x in (3, 3.0, np.float32(3.0), True)] == [1.5, 1.5, 1.5, 0.5]
    assert len(halves.loaded) == 4


def test_compiling_a_kernel_is_heard_and_a_later_call_is_not(monkeypatch):
    monkeypatch.setattr(plain, "kept", lambda: None)

    @kernel.kernel
    def third(x: float) -> float:
        return x / 3.0

    @kernel.kernel
    def ninth(x: float) -> float:
        return third(third(x))

    heard: list[bool] = []
    with compiling_heard(heard.append):
        assert [ninth(9.0), ninth(18.0)] == [1.0, 2.0]
    assert heard == [True, False]
    assert third(3.0) == 1.0
    assert heard == [True, False]


def test_a_kernel_that_raises_says_so():
    @kernel.allocating_kernel
    def root(x: float) -> float:
        if x < 0.0:
            raise ValueError("negative")
        return np.sqrt(np.full(3, x)).sum() / 3.0

    assert root(4.0) == 2.0
    with pytest.raises(ValueError, match="negative"):
        root(-1.0)


def test_a_kernel_may_return_arrays_and_named_tuples():
    @kernel.allocating_kernel
    def found(n: int) -> tuple[Extremes, np.ndarray]:
        return Extremes(1.0, 2.0, 3.0), np.arange(n)

    extremes, array = found(3)
    assert extremes == Extremes(1.0, 2.0, 3.0)
    assert isinstance(extremes, Extremes)
    assert array.tolist() == [0, 1, 2]


NOTHING = """
import numpy as np
from odt_plugins.engine.topology.star import vertex_stars
for _ in range(2):
    print(vertex_stars(np.array([[0, 1, 2]], dtype=np.int32), 3).indptr.tolist())
"""
"""A program that calls four kernels, twice."""

BY_NUMBA = {"NUMBA_OPT": "1"}
"""Has numba compile every kernel, and quickly."""


def ran(program: str, **chosen: str) -> subprocess.CompletedProcess[str]:
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True,
                          check=False, env=os.environ | chosen)
    assert done.returncode == 0, done.stderr
    return done


def test_where_nothing_can_be_kept_that_is_said_once_and_kernels_run():
    done = ran(NOTHING, NUMBA_CACHE_DIR=f"{os.devnull}/cache", **BY_NUMBA)
    assert done.stdout == "[0, 1, 2, 3]\n" * 2
    told = done.stderr.splitlines()
    assert [line.count("odt_plugins: ") for line in told] == [1, 1]
    assert "cannot be kept in /dev/null/cache/odt_plugins" in told[0]
    assert "numba compiles kernels" in told[1]


def test_what_numba_compiled_is_taken_from_disk_without_a_word(tmp_path):
    first = ran(NOTHING, NUMBA_CACHE_DIR=str(tmp_path), **BY_NUMBA)
    assert first.stderr.count("\n") == first.stderr.count("numba compiles kernels") == 1
    kept = sorted(tmp_path.rglob("*.nbc"))
    assert kept
    again = ran(NOTHING, NUMBA_CACHE_DIR=str(tmp_path), **BY_NUMBA)
    assert (again.stdout, again.stderr) == (first.stdout, "")
    assert sorted(tmp_path.rglob("*.nbc")) == kept
    other = ran(NOTHING, NUMBA_CACHE_DIR=str(tmp_path), NUMBA_BOUNDSCHECK="1", **BY_NUMBA)
    assert "numba compiles kernels" in other.stderr


WITHOUT = """
import sys
sys.modules["numba"] = None
from odt_plugins.errors import MissingDependencyError
"""


def test_without_a_library_and_numba_it_is_said_what_to_install():
    done = ran(WITHOUT + f"try:\n    exec({NOTHING!r})\nexcept MissingDependencyError as error:\n"
               "    print(error)", **BY_NUMBA)
    assert 'needs numba, not installed here; try pip install "odt-plugins[numba]"' in done.stdout


def test_a_full_disk_keeps_no_kernel_and_stops_none(tmp_path):
    code = """
import resource
from odt_plugins.engine.topology.star import vertex_stars
resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
import numpy as np
print(vertex_stars(np.array([[0, 1, 2]], dtype=np.int32), 3).indptr.tolist())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False,
                          env=full_disk(NUMBA_CACHE_DIR=str(tmp_path), **BY_NUMBA))
    assert done.stdout.split() == ["[0,", "1,", "2,", "3]"], done.stderr
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_what_a_kernel_uses_stands_in_files_with_kernels(trees):
    """A number that a kernel takes from another file is part of its machine code as well."""
    kernels = {
        name: [node for node in tree.body if isinstance(node, ast.FunctionDef)
               and {getattr(d, "id", "") for d in node.decorator_list}
               & DECORATORS] for name, tree in trees.items()}
    assert sum(map(len, kernels.values())) > 100
    for name, found in kernels.items():
        source = {alias.asname or alias.name: node.module for node in trees[name].body
                  if isinstance(node, ast.ImportFrom) for alias in node.names}
        used = {node.id for function in found for statement in function.body
                for node in ast.walk(statement) if isinstance(node, ast.Name)}
        for word in used & set(source):
            module = source[word]
            assert not module.startswith("odt_plugins") or kernels.get(module), (name, word)


def test_kernels_run_as_python_where_numba_is_told_not_to_compile():
    assert ran(NOTHING, NUMBA_DISABLE_JIT="1").stdout == "[0, 1, 2, 3]\n" * 2


def test_a_user_without_a_home_may_have_kernels(monkeypatch, tmp_path):
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    assert library.place() is None
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert library.place() == tmp_path / "odt_plugins"


def test_an_editor_may_leave_a_link_that_leads_nowhere(tmp_path):
    (tmp_path / "a.py").write_bytes(library.MARK)
    stamp = library.source_stamp(tmp_path)
    (tmp_path / ".#a.py").symlink_to("someone@here.17")
    assert library.source_stamp(tmp_path) == stamp
