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
from processes import full_disk

import odt_plugins
from odt_plugins.ahead import compile_ahead
from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.cells.sphere import apex_across
from odt_plugins.engine.compiled import cache as kernel_cache
from odt_plugins.engine.compiled import kernel
from odt_plugins.engine.compiled.compiler import compile_whole
from odt_plugins.engine.compiled.library import Library, Part
from odt_plugins.engine.compiled.machine import TRIED, MachineCode, fits
from odt_plugins.engine.moves import cavity
from odt_plugins.engine.topology import star
from odt_plugins.engine.topology.lookup import place_in
from odt_plugins.engine.topology.tets import Tets
from odt_plugins.progress import compiling_heard

ENGINE = Path(odt_plugins.__file__).parent / "engine"


def test_all_kernels_go_through_one_decorator():
    for path in ENGINE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert path.name == "compiler.py" or not re.search(r"\bnjit\b", text), path


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


def test_an_index_that_is_no_constant_counts_from_the_start():
    @kernel.kernel
    def second_row(table: np.ndarray, row: int, column: int) -> float:
        table[row + 1, column] += table[-1, 0]
        return table[row + 1, column]

    whole = np.arange(8.0).reshape(4, 2)
    for number in (int, np.int32):
        assert second_row(whole[1:].copy(), number(0), number(1)) == 5.0 + 6.0
        assert second_row(whole[1:], number(-2), number(1)) == 1.0 + 6.0
        whole[0, 1] = 1.0


CHECKED = """
import numpy as np
from odt_plugins.engine.compiled.kernel import kernel

@kernel
def element(row, at):
    return row[at]

print(element(np.arange(3.0), 2))
try:
    element(np.arange(3.0), -1)
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


@pytest.mark.parametrize("name", kernel_cache.CHOSEN)
def test_kernels_of_other_settings_of_numba_have_other_names_on_disk(name, tmp_path, monkeypatch):
    def plus_one(x: float) -> float:
        return x + 1.0

    code = MachineCode(b"", "", {}, (), lasting=True)
    for chosen in kernel_cache.CHOSEN:
        monkeypatch.delenv(chosen, raising=False)
    monkeypatch.setattr(kernel_cache, "kept", lambda: tmp_path)
    kernel_cache.save(plus_one, (float,), code)
    assert kernel_cache.load(plus_one, (float,)) == code
    monkeypatch.setenv(name, "1")
    assert kernel_cache.load(plus_one, (float,)) is None


def test_kernels_divide_as_numpy_does():
    @kernel.kernel
    def inverse(x: float) -> float:
        return 1.0 / x

    assert inverse(0.0) == np.inf


def key_of(*values):
    kinds = []
    kernel.add_kinds(values, kinds)
    return tuple(kinds)


def test_arguments_of_one_type_go_to_the_same_code_and_others_do_not():
    square, table = np.zeros((3, 3)), np.zeros((3, 1), np.int32)
    values = (
        1, 1.0, True, None, np.int32(1), np.float32(1.0), square, square[:, 0], square.T[1:],
        square.T, square[::2, ::2], square[0], table, table.view(np.uint32), (1, 1.0), (1.0, 1),
        Extremes(1.0, 1.0, 1.0), (1.0, 1.0, 1.0), ((1.0, 1.0), 1.0),
        ((1.0,), 1.0, 1.0), ((), 1.0), (1.0,), np.frombuffer(bytes(8)))
    type_of = kernel.type_of
    ours, types = [*map(type_of, values)], [*map(numba.typeof, values)]
    keys = [*map(key_of, values)]
    for own, known, key in zip(ours, types, keys, strict=True):
        assert [own == other for other in ours] == [known == other for other in types], known
        assert all(own == other for other, its in zip(ours, keys, strict=True) if its == key)
    for one, other in ((((1.0,), 1.0), ((1.0, 1.0),)), (((), (1.0,)), (((), 1.0),)),
                       ((1.0, ()), ((1.0,),))):
        assert key_of(*one) != key_of(*other)
    for one, other in ((1, np.int64(2)), (1.0, np.float64(2.0)), (True, np.bool_(False)),
                       (np.zeros((3, 1)), np.zeros((1, 3))), (np.zeros(0), np.zeros(7))):
        assert type_of(one) == type_of(other)
    own, other = np.zeros(3), np.zeros(3).view(np.dtype("float64").newbyteorder("<"))
    assert repr(own.dtype) != repr(other.dtype)
    assert repr(type_of(own)) == repr(type_of(other))
    split = np.zeros(9, np.uint8)[1:].view(np.float64)
    assert type_of(split) != type_of(np.zeros(1))


def test_code_is_chosen_by_the_types_of_the_arguments():
    @kernel.kernel
    def halves(x: float) -> float:
        return x / 2

    assert [halves(x) for x in (3, 3.0, np.float32(3.0), True)] == [1.5, 1.5, 1.5, 0.5]
    assert len(halves.loaded) == 4


def test_compiling_a_kernel_is_heard_and_a_later_call_is_not():
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


def test_kernels_hold_no_lock_of_python():
    for made in (kernel.kernel, kernel.allocating_kernel, kernel.inlined_kernel):
        one = made(lambda x: x + 1.0)
        code = compile_whole(one.py_func, one.options, (1.0,))
        assert {"PyEval_SaveThread", "PyEval_RestoreThread"} <= {*code.needs}


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
import sys
import numpy as np
from odt_plugins.engine.compiled import cache
from odt_plugins.engine.topology.star import vertex_stars
print(vertex_stars(np.array([[0, 1, 2]], dtype=np.int32), 3).indptr.tolist(), cache.kept())
"""


def test_a_process_that_may_write_nowhere_can_use_the_engine():
    env = os.environ | {"NUMBA_CACHE_DIR": f"{os.devnull}/cache", "NUMBA_CPU_NAME": "generic"}
    done = subprocess.run([sys.executable, "-c", NOTHING], capture_output=True, text=True,
                          check=False, env=env)
    assert done.stdout.strip() == "[0, 1, 2, 3] None", done.stderr


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


def test_a_kernel_takes_in_what_it_calls_which_then_has_no_machine_code():
    @kernel.kernel
    def third(x: float) -> float:
        return x / 3.0

    @kernel.kernel
    def both(x: float) -> float:
        return third(x) + third(2.0 * x)

    @kernel.kernel
    def outer(x: float) -> float:
        return both(x) + third(x)

    assert outer(1.5) == 2.0
    assert [len(one.loaded) for one in (outer, both, third)] == [1, 0, 0]
    for inner in (third, both):
        (compiled,) = inner.part.overloads.values()
        assert compiled.library._compiled_object is None
    assert both(3.0) == 3.0
    assert len(both.loaded) == 1


UNTRIED = """
from odt_plugins.engine.compiled import machine
machine.TRIED = "another"
from odt_plugins.engine.compiled.kernel import inlined_kernel, kernel

@inlined_kernel
def third(x: float) -> float:
    return x / 3.0

@kernel
def both(x: float) -> float:
    return third(x) + third(2.0 * x)

@kernel
def outer(x: float) -> float:
    return both(x) + third(x)

print(outer(1.5), both(3.0), machine.tried())
"""


def test_the_newest_numba_that_may_be_installed_was_tried():
    """Kernels use names that are private to numba."""
    project = (Path(__file__).parents[3] / "pyproject.toml").read_text(encoding="utf-8")
    tried = int(TRIED.split(".")[-2])
    assert re.findall(r'"numba>=[\d.]+([^"]*)"', project) == [f",<0.{tried + 1}"] * 2


def test_a_numba_that_was_not_tried_compiles_by_itself(tmp_path):
    """Kernels of a module that is imported a second time come from disk."""
    (tmp_path / "kernels.py").write_text(UNTRIED, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", "import importlib, kernels; importlib.reload(kernels)"],
        capture_output=True, text=True, check=False, cwd=tmp_path,
        env=dict(os.environ) | {"NUMBA_CACHE_DIR": str(tmp_path)})
    assert done.stdout.split() == ["2.0", "3.0", "False"] * 2, done.stderr
    assert len(list(tmp_path.glob("*.kernel"))) == 2


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
import sys
from odt_plugins.engine.outer import outer
print(outer(1.0), int("numba" not in sys.modules))
"""


def test_code_on_disk_is_that_of_the_sources_wherever_they_lie(tmp_path):
    """It is found where the package is installed, and not after a change of what a kernel calls."""
    kept = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}
    built, installed = (tmp_path / place / "odt_plugins" / "engine"
                        for place in ("built", "installed"))
    shutil.copytree(ENGINE / "compiled", built / "compiled",
                    ignore=shutil.ignore_patterns("__*", "ahead"))
    for name in ("errors.py", "objectives.py", "options.py", "progress.py"):
        shutil.copy(ENGINE.parent / name, built.parent)
    (built / "outer.py").write_text(OUTER, encoding="utf-8")

    def told(engine: Path, step: float) -> str:
        (engine / "inner.py").write_text(INNER.format(step=step), encoding="utf-8")
        place = engine.parents[1]
        done = subprocess.run([sys.executable, "-c", CALL], capture_output=True, text=True,
                              check=True, cwd=place, env=kept | {"PYTHONPATH": str(place)})
        return done.stdout.strip()

    assert told(built, 1.0) == "4.0 0"
    assert told(built, 2.5) == "7.0 0"
    (built / "driver.py").write_text("SHARE = 0.5", encoding="utf-8")
    shutil.copytree(built.parent, installed.parent)
    assert told(installed, 1.0) == "4.0 1"


DECORATORS = {"kernel", "inlined_kernel", "allocating_kernel"}


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


LOADED = """
from pathlib import Path
from odt_plugins.engine.compiled import cache
cache.AHEAD = Path({ahead!r})
from odt_plugins.engine.topology import star
import numpy as np
star.vertex_stars(np.array([[0, 1, 2]], dtype=np.int32), 3)
import sys
print(int("numba" not in sys.modules))
"""


def test_kernels_that_were_compiled_ahead_are_not_compiled_again(tmp_path, monkeypatch):
    ahead, kept = tmp_path / "ahead", tmp_path / "kept"
    program = LOADED.format(ahead=str(ahead))
    compile_ahead(ahead, [program])
    names = sorted(path.name for path in ahead.iterdir())
    assert any("_sort_all" in name for name in names)
    assert all(name.endswith(kernel_cache.SUFFIX) for name in names)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True,
                          check=True, env=os.environ | {"NUMBA_CACHE_DIR": str(kept)})
    assert done.stdout.strip() == "1"
    assert not list(kept.rglob(f"*{kernel_cache.SUFFIX}"))

    # Whoever names another processor is given none of them.
    star.vertex_stars(np.array([[0, 1, 2]], dtype=np.int32), 3)
    monkeypatch.setattr(kernel_cache, "AHEAD", ahead)
    monkeypatch.setattr(kernel_cache, "kept", lambda: None)
    function, (types, *_) = star._sort_all.py_func, star._sort_all.loaded
    assert kernel_cache.load(function, types)
    monkeypatch.setenv("NUMBA_CPU_NAME", "generic")
    assert kernel_cache.load(function, types) is None

    (ahead / "other.txt").write_text("stays", encoding="utf-8")
    compile_ahead(ahead, ["pass"])
    assert [path.name for path in ahead.iterdir()] == ["other.txt"]


def test_compiling_ahead_tells_of_a_program_that_fails(tmp_path):
    with pytest.raises(subprocess.CalledProcessError):
        compile_ahead(tmp_path, ["raise SystemExit(3)", "pass"])


COVERED = """
import sys
from odt_plugins import ahead, optimize
from odt_plugins.compare.start import ball, plate, stored
from odt_plugins.engine.compiled import threads
from odt_plugins.engine.compiled.kernel import Kernel

threads.THREADED_CELLS = 0

def known():
    return {(name, value.py_func.__qualname__, str(types))
            for name, module in list(sys.modules.items()) if name.startswith("odt_plugins")
            for value in vars(module).values() if isinstance(value, Kernel)
            for types in value.loaded}

for name in ahead.RUNS:
    ahead.run(name)
before = known()
for name in ("bunny", "bunny-surface"):
    optimize((stored(name).points, stored(name).cells))
optimize((plate(1000).points, plate(1000).cells))
optimize((ball(15_000).points, ball(15_000).cells), threads=2, smoothing={"rounds": 2})
optimize((stored("bone").points, stored("bone").cells), boundary="slide", insert=True, threads=2)
print(len(before), int("numba" in sys.modules), sorted(known() - before))
import numba
print(numba.njit(lambda x: (x + 1.0).sum())(__import__("numpy").ones(3)))
"""


def test_usual_runs_need_no_other_kernel_than_those_compiled_ahead_and_no_numba():
    for _ in range(2):
        done = subprocess.run([sys.executable, "-c", COVERED], capture_output=True, text=True,
                              check=False)
        count, compiled, missing, total = done.stdout.split(maxsplit=3)
        # Kernels that were not on disk are now.
        if compiled == "0":
            break
    assert int(count) > 50
    assert (compiled, missing, total) == ("0", "[]", "6.0\n"), done.stderr


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

first = half(3.0)
print(first, int("numba" not in sys.modules), quarter(2.0) if "all" in sys.argv else "")
""", encoding="utf-8")

    def told(*arguments: str) -> str:
        done = subprocess.run([sys.executable, "kernels.py", *arguments], capture_output=True,
                              text=True, check=True, cwd=tmp_path,
                              env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)})
        return done.stdout.strip()

    assert told() == "1.5 0"
    assert told("all") == "1.5 1 0.5"


@pytest.mark.parametrize("damage", [
    lambda held: held[:50], lambda held: held[:200] + bytes(len(held) - 200), lambda held: b"N."])
def test_what_is_damaged_on_disk_is_compiled_anew(damage, tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_cache, "kept", lambda: tmp_path)

    def half(x: float) -> float:
        return x / 2.0

    def compiled() -> list[bool]:
        heard: list[bool] = []
        with compiling_heard(heard.append):
            assert kernel.kernel(half)(3.0) == 1.5
        return heard

    assert compiled()
    assert not compiled()
    (path,) = tmp_path.iterdir()
    path.write_bytes(damage(path.read_bytes()))
    assert compiled()
    assert not compiled()


HELPERS = """
import math, sys
import numpy as np
from odt_plugins.engine.compiled.kernel import Kernel

LARGE = np.full(200_000, 7.0)

@Kernel
def large(i: int) -> float:
    return LARGE[i]

@Kernel
def several(x: float) -> float:
    fraction, power = math.frexp(x)
    return math.ldexp(fraction, power) + math.erf(0.0) + math.gamma(1.0) + math.hypot(3.0, 4.0)

@Kernel
def root(x: float) -> float:
    if x < 0.0:
        raise ValueError("negative")
    return math.sqrt(x)

print(several(2.0), root(9.0), int("numba" not in sys.modules))
try:
    root(-1.0)
except ValueError as error:
    print(error, large(5))
"""


def test_what_another_process_cannot_use_is_not_kept_and_all_else_works_there(tmp_path):
    (tmp_path / "kernels.py").write_text(HELPERS, encoding="utf-8")
    for known in (0, 1):
        done = subprocess.run([sys.executable, "kernels.py"], capture_output=True, text=True,
                              check=False, cwd=tmp_path,
                              env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)})
        assert done.stdout.split() == ["8.0", "3.0", str(known), "negative", "7.0"], done.stderr


def test_code_that_calls_what_is_not_there_does_not_fit():
    code = MachineCode(b"", "", {}, ("pow", "no_such_function"), lasting=True)
    assert not fits(code)
    assert fits(code._replace(needs=("pow", "PyTuple_New", "numba_adapt_ndarray")))


def test_kernels_run_as_python_where_numba_is_told_not_to_compile():
    done = subprocess.run([sys.executable, "-c", NOTHING], capture_output=True, text=True,
                          check=False, env=os.environ | {"NUMBA_DISABLE_JIT": "1"})
    assert done.stdout.startswith("[0, 1, 2, 3]"), done.stderr


def test_a_user_without_a_home_may_have_kernels(monkeypatch, tmp_path):
    monkeypatch.delenv("HOME", raising=False)
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    kernel_cache.kept.cache_clear()
    try:
        assert kernel_cache.kept() is None
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
        kernel_cache.kept.cache_clear()
        assert kernel_cache.kept() == tmp_path / "odt_plugins"
    finally:
        kernel_cache.kept.cache_clear()


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
    assert len(cavity._note.part.signatures) == len(cavity._sorted3.part.signatures) == 1
    apex = numba.njit(apex_across.py_func)
    assert apex(cells, 0, 0, 0) == 0
    assert apex.nopython_signatures[0].return_type == numba.int32
