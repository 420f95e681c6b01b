"""Kernels: compiled the same way everywhere, also where nothing can be cached."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core.caching import NullCache
from processes import full_disk

import odt_plugins
from odt_plugins.ahead import compile_ahead
from odt_plugins.engine.cells.sphere import apex_across
from odt_plugins.engine.cells.tetrahedron import tet_quality
from odt_plugins.engine.compiled import cache as kernel_cache
from odt_plugins.engine.compiled import kernel
from odt_plugins.engine.compiled.library import Library, Part
from odt_plugins.engine.moves import cavity
from odt_plugins.engine.topology.lookup import place_in
from odt_plugins.engine.topology.tets import Tets

ENGINE = Path(odt_plugins.__file__).parent / "engine"


def test_all_kernels_go_through_one_decorator():
    for path in ENGINE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert path.name == "kernel.py" or not re.search(r"\bn?jit\b", text), path


def test_every_loop_of_a_kernel_has_a_bound_before_it_begins():
    loops = 0
    for path in ENGINE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.FunctionDef):
                continue
            if not any("kernel" in ast.unparse(mark) for mark in node.decorator_list):
                continue
            inner = list(ast.walk(node))
            loops += sum(isinstance(part, ast.For) for part in inner)
            endless = [part.lineno for part in inner if isinstance(part, ast.While)]
            assert not endless, (path.name, node.name, endless)
    assert loops > 200


def test_a_place_is_looked_for_in_its_own_row_only():
    rows = np.arange(12, dtype=np.int32).reshape(4, 3)
    assert [place_in(rows, 1, value) for value in (3, 4, 5)] == [0, 1, 2]
    for value in (2, 6, 11, -1):
        assert 0 <= place_in(rows, 1, value) < 3


def test_kernels_are_cached_and_divide_as_numpy_does():
    @kernel.kernel
    def inverse(x: float) -> float:
        return 1.0 / x

    assert inverse(0.0) == np.inf
    assert tet_quality._cache is not None
    assert tet_quality.targetoptions["nogil"]


def test_without_a_place_for_the_cache_kernels_are_compiled_all_the_same(monkeypatch):
    def nowhere(function):
        msg = "cannot cache function: no locator available"
        raise RuntimeError(msg)

    monkeypatch.setattr(kernel_cache, "FunctionCache", nowhere)

    @kernel.compiled()
    def twice(x: float) -> float:
        return 2.0 * x

    assert twice(4.0) == 8.0
    assert twice._cache.cache_path is None


def test_a_process_that_may_write_nowhere_can_use_the_engine(tmp_path):
    code = """
import numba.core.caching as caching
caching._CacheLocator.ensure_cache_path = lambda self: (_ for _ in ()).throw(OSError())
from odt_plugins.engine.topology.order import morton_keys
from odt_plugins.engine.topology.star import vertex_stars
import numpy as np
print(vertex_stars(np.array([[0, 1, 2]], dtype=np.int32), 3).indptr.tolist())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["[0,", "1,", "2,", "3]"], done.stderr


def test_a_full_disk_keeps_no_kernel_and_stops_none(tmp_path):
    code = """
import resource
from odt_plugins.engine.topology.star import vertex_stars
resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
import numpy as np
print(vertex_stars(np.array([[0, 1, 2]], dtype=np.int32), 3).indptr.tolist())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False,
                          env=full_disk(NUMBA_CACHE_DIR=str(tmp_path)))
    assert done.stdout.split() == ["[0,", "1,", "2,", "3]"], done.stderr
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_a_kernel_takes_in_what_it_calls_and_inner_kernels_have_no_machine_code():
    @kernel.inner_kernel
    def third(x: float) -> float:
        return x / 3.0

    @kernel.inner_kernel
    def both(x: float) -> float:
        return third(x) + third(2.0 * x)

    @kernel.kernel
    def outer(x: float) -> float:
        return both(x) + third(x)

    assert outer(1.5) == 2.0
    assert both(3.0) == 3.0
    for inner in (third, both):
        (compiled,) = inner.overloads.values()
        assert isinstance(inner._cache, NullCache)
        assert compiled.library._compiled_object is None
    (compiled,) = outer.overloads.values()
    assert compiled.library._compiled_object is not None
    assert not [f.name for f in compiled.library._final_module.functions
                if f.is_declaration and "third" in f.name]


def test_a_numba_that_was_not_tried_compiles_by_itself(tmp_path):
    (tmp_path / "kernels.py").write_text("""
import numba
numba.__version__ = "0.60.0"
from odt_plugins.engine.compiled.kernel import OWN, inlined_kernel, inner_kernel, kernel

@inlined_kernel
def third(x: float) -> float:
    return x / 3.0

@inner_kernel
def both(x: float) -> float:
    return third(x) + third(2.0 * x)

@kernel
def outer(x: float) -> float:
    return both(x) + third(x)

print(OWN, outer(1.5), both(3.0))
""", encoding="utf-8")
    done = subprocess.run([sys.executable, "-m", "kernels"], capture_output=True, text=True,
                          check=False, env=dict(os.environ) | {"NUMBA_CACHE_DIR": str(tmp_path)},
                          cwd=tmp_path)
    assert done.stdout.strip() == "None 2.0 3.0", done.stderr


def test_callers_are_taken_in_before_what_they_call():
    codegen = numba.core.registry.cpu_target.target_context.codegen()
    whole, (first, second, third) = Library(codegen, "whole"), (Part(codegen, c) for c in "abc")
    whole._linking_libraries = [first, second]
    first._linking_libraries = second._linking_libraries = [third]
    for _ in range(2):
        assert whole.needed()[-1] is third
        assert {*whole.needed()} == {first, second, third}
        whole._linking_libraries.reverse()


INNER = """
from odt_plugins.engine.compiled.kernel import kernel
STEP = {step}
@kernel
def inner(x: float) -> float:
    return x + STEP
"""
OUTER = """
from odt_plugins.engine.inner import inner
from odt_plugins.engine.compiled.kernel import kernel
@kernel
def outer(x: float) -> float:
    return 2.0 * inner(x)
"""
CALL = """
from odt_plugins.engine.outer import outer
print(outer(1.0), sum(outer.stats.cache_hits.values()))
"""


def test_a_kernel_from_disk_imports_nothing_of_what_compiling_needs(tmp_path):
    code = """
import sys
import numpy as np
from odt_plugins.engine.moves.newton3d import make_derivatives
from odt_plugins.engine.topology.star import vertex_stars
assert vertex_stars(np.array([[0, 1, 2]], dtype=np.int32), 3).indptr.tolist() == [0, 1, 2, 3]
assert make_derivatives()[0].dtype == np.float64
print("numba.np.arraymath" in sys.modules, "scipy.linalg" in sys.modules)
"""
    env = dict(os.environ) | {"NUMBA_CACHE_DIR": str(tmp_path)}
    for _ in range(2):
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True,
                              check=False, env=env)
    assert done.stdout.strip() == "False False", done.stderr


def test_a_change_in_a_kernel_that_another_file_calls_is_seen(tmp_path):
    engine = tmp_path / "odt_plugins" / "engine"
    shutil.copytree(ENGINE / "compiled", engine / "compiled",
                    ignore=shutil.ignore_patterns("__*"))
    (engine / "outer.py").write_text(OUTER, encoding="utf-8")
    env = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}

    def call(*, at_once: int = 1) -> set[str]:
        running = [subprocess.Popen([sys.executable, "-c", CALL], stdout=subprocess.PIPE, text=True,
                                    cwd=tmp_path, env=env | {"PYTHONPATH": str(tmp_path)})
                   for _ in range(at_once)]
        return {process.communicate()[0].strip() for process in running}

    def write(step: float) -> None:
        (engine / "inner.py").write_text(INNER.format(step=step), encoding="utf-8")

    write(1.0)
    assert call() == {"4.0 0"}
    write(2.5)
    assert {line.split()[0] for line in call(at_once=2)} == {"7.0"}
    (engine / "driver.py").write_text("SHARE = 0.5", encoding="utf-8")
    write(1.0)
    assert call() == {"4.0 1"}


DECORATORS = {"kernel", "inner_kernel", "inlined_kernel", "allocating_kernel"}


def test_kernels_that_only_kernels_call_are_inner_kernels():
    """Others compile what unpacks the arguments of a call from Python, which takes its time."""
    marks: dict[str, set[str]] = {}
    named = set()

    def visit(node):
        if isinstance(node, ast.FunctionDef):
            found = DECORATORS & {getattr(d, "id", "") for d in node.decorator_list}
            if found:
                marks.setdefault(node.name, set()).update(found)
                return
        named.add(getattr(node, "id", getattr(node, "attr", "")))
        for child in ast.iter_child_nodes(node):
            visit(child)

    for path in ENGINE.parent.rglob("*.py"):
        visit(ast.parse(path.read_text(encoding="utf-8")))
    assert len(marks) > 100
    for name, mark in marks.items():
        if mark != {"allocating_kernel"}:
            inner = mark <= {"inner_kernel", "inlined_kernel"}
            assert inner == (name not in named), (name, mark)


def test_an_inner_kernel_is_called_from_python_through_a_caller():
    @kernel.inner_kernel
    def double(x: float) -> float:
        return 2.0 * x

    @kernel.kernel
    def quadruple(x: float) -> float:
        return double(double(x))

    assert quadruple(3.0) == 12.0
    assert double(3.0) == 6.0
    assert double.targetoptions["no_cpython_wrapper"]


def test_what_a_kernel_uses_stands_in_files_with_kernels():
    """A number that a kernel takes from another file is part of its machine code as well."""
    trees = {f"odt_plugins.engine.{'.'.join(path.relative_to(ENGINE).with_suffix('').parts)}":
             ast.parse(path.read_text(encoding="utf-8")) for path in ENGINE.rglob("*.py")}
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


LOADED = """
from pathlib import Path
from odt_plugins.engine.compiled import cache
cache.AHEAD = Path({ahead!r})
from odt_plugins.engine.topology import star
import numpy as np
star.vertex_stars(np.array([[0, 1, 2]], dtype=np.int32), 3)
print(sum(star._count.stats.cache_hits.values()))
"""


def test_kernels_that_were_compiled_ahead_are_not_compiled_again(tmp_path):
    ahead, kept = tmp_path / "ahead", tmp_path / "kept"
    (tmp_path / "other.txt").write_text("stays", encoding="utf-8")
    program = LOADED.format(ahead=str(ahead))

    def hits(**machine: str) -> str:
        env = os.environ | {"NUMBA_CACHE_DIR": str(kept), **machine}
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True,
                              check=True, env=env)
        return done.stdout.strip()

    compile_ahead(ahead, [program])
    names = sorted(path.name for path in ahead.iterdir())
    assert any("_count" in name for name in names)
    assert all(name.endswith(kernel_cache.SUFFIX) for name in names)
    assert hits() == "1"
    assert not list(kept.rglob(f"*{kernel_cache.SUFFIX}"))
    # Whoever names another processor is given none of them.
    assert hits(NUMBA_CPU_NAME="generic") == "0"
    compile_ahead(ahead, [program])
    assert sorted(path.name for path in ahead.iterdir()) == names


def test_compiling_ahead_tells_of_a_program_that_fails(tmp_path):
    with pytest.raises(subprocess.CalledProcessError):
        compile_ahead(tmp_path, ["raise SystemExit(3)", "pass"])


COVERED = """
import sys
from numba.core.dispatcher import Dispatcher
from odt_plugins import ahead, optimize
from odt_plugins.compare.start import ball, plate, stored
from odt_plugins.engine.compiled import threads

threads.THREADED_CELLS = 0

def known():
    return {(name, value.py_func.__qualname__, str(types))
            for name, module in list(sys.modules.items()) if name.startswith("odt_plugins")
            for value in vars(module).values() if isinstance(value, Dispatcher)
            for types in value.overloads}

for name in ahead.RUNS:
    ahead.run(name)
before = known()
for name in ("bunny", "bunny-surface"):
    optimize((stored(name).points, stored(name).cells))
optimize((plate(1000).points, plate(1000).cells))
optimize((stored("bone").points, stored("bone").cells), boundary="slide", insert=True, threads=2)
print(len(before), sorted(known() - before))
"""


def test_usual_runs_need_no_other_kernel_than_those_compiled_ahead():
    done = subprocess.run([sys.executable, "-c", COVERED], capture_output=True, text=True,
                          check=True)
    count, missing = done.stdout.strip().split(" ", 1)
    assert int(count) > 50
    assert missing == "[]"


def test_a_kernel_from_disk_is_taken_in_by_one_that_calls_it(tmp_path):
    (tmp_path / "kernels.py").write_text("""
import sys
from odt_plugins.engine.compiled.kernel import kernel

@kernel
def half(x: float) -> float:
    return x / 2.0

@kernel
def quarter(x: float) -> float:
    return half(half(x))

print(half(3.0), quarter(2.0) if "all" in sys.argv else "", sum(half.stats.cache_hits.values()))
""", encoding="utf-8")

    def told(*arguments: str) -> str:
        done = subprocess.run([sys.executable, "kernels.py", *arguments], capture_output=True,
                              text=True, check=True, cwd=tmp_path,
                              env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)})
        return done.stdout.strip()

    assert told() == "1.5  0"
    assert told("all") == "1.5 0.5 1"
    # What is damaged is compiled anew.
    for path in tmp_path.rglob(f"*.half.*{kernel_cache.SUFFIX}"):
        path.write_bytes(path.read_bytes()[:50])
    assert told("all") == "1.5 0.5 0"
    assert told("all") == "1.5 0.5 1"


def test_an_editor_may_leave_a_link_that_leads_nowhere(tmp_path):
    (tmp_path / "a.py").write_text("kernel", encoding="utf-8")
    stamp = kernel_cache.source_stamp(tmp_path)
    (tmp_path / ".#a.py").symlink_to("someone@here.17")
    assert kernel_cache.source_stamp(tmp_path) == stamp


def test_what_a_flip_calls_is_compiled_for_one_type():
    """For every type of an argument, and every literal, numba compiles a kernel anew."""
    n = 8
    cells = np.zeros((n, 4), np.int32)
    cells[0] = 0, 1, 2, 3
    # Not from the cache, where the kernels that it calls would not be asked for.
    tets = Tets(
        np.zeros((n, 3)), cells, np.full((n, 4), -1, np.int32), np.zeros(n, np.int32),
        np.zeros(n, np.bool_), np.zeros(n, np.uint8), np.array([1, 0, 0]), np.zeros(n, np.int32),
    )
    numba.njit(cavity.replace_cavity.py_func)(
        tets, np.zeros(4, np.int32), np.int64(1), cells[:1].copy(), np.int64(1),
        np.zeros((32, 5), np.int32), cavity.make_journal(np.bool_(True), np.int64(100)),
    )
    assert len(cavity._note.signatures) == len(cavity._sorted3.signatures) == 1
    apex = numba.njit(apex_across.py_func)
    assert apex(cells, 0, 0, 0) == 0
    assert apex.nopython_signatures[0].return_type == numba.int32
