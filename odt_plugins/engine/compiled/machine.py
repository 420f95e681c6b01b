"""Machine code as a function that Python calls.

What numba writes needs little of numba: an `Environment` for its constants, and the addresses of
functions in C that take arrays and numbers out of Python's objects.  These are in three extension
modules, which are loaded here without numba's own modules, a third of a second of work.
"""

from __future__ import annotations

import builtins
import ctypes
import math
import os
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from importlib.machinery import PathFinder
from importlib.util import find_spec, module_from_spec
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite.binding as llvm

TRIED = '"version": "0.68.'
"""What stands in numba's file of its version where all that is done here and in
:mod:`odt_plugins.engine.compiled.compiler` has been tried.  With another one kernels are compiled
by numba's own passes, and numba is imported."""


class MachineCode(NamedTuple):
    """A kernel for some types of arguments."""

    content: bytes
    """Of an object file."""

    entry: str
    """Name of the function that takes a tuple of Python's objects."""

    constants: dict[str, list[Any]]
    """Python's objects that it uses, by the place in it that leads to them; the first one is that
    of the entry."""

    needs: tuple[str, ...]
    """Names of the functions in C that it calls."""

    lasting: bool
    """Whether other processes can use it: it holds no address of this one."""


@cache
def numba_version() -> str:
    """Content of numba's file of its version, which is not imported."""
    return (_numba_folder() / "_version.py").read_text(encoding="utf-8")


def tried() -> bool:
    """Whether this is a numba that is known here."""
    return TRIED in numba_version()


def _numba_folder() -> Path:
    found: Any = find_spec("numba")
    return Path(found.submodule_search_locations[0])


def _extension(name: str) -> Any:
    """Give an extension module of numba; where numba was not imported, without all the rest."""
    if "numba" in sys.modules:
        return import_module(name)
    if name not in sys.modules:
        folder = _numba_folder().joinpath(*name.split(".")[1:-1])
        spec: Any = PathFinder.find_spec(name, [str(folder)])
        module = module_from_spec(spec)
        spec.loader.exec_module(module)
        # numba takes what is there, where it is imported later.
        sys.modules.setdefault(name, module)
    return sys.modules[name]


@cache
def _know_symbols() -> Any:
    """Tell LLVM where the functions are that machine code calls; gives what makes functions."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    # Elsewhere numba looks for functions of the C library as well.
    if not tried() or os.name != "posix":
        from numba.core.registry import cpu_target

        cpu_target.target_context.refresh()
    functions, helpers = _extension("numba._dynfunc"), _extension("numba._helperlib")
    runtime = _extension("numba.core.runtime._nrt_python")
    runtime.memsys_use_cpython_allocator()
    symbols = {"_Py_NoneStruct": id(None)}
    for name, address in (*functions.c_helpers.items(), *helpers.c_helpers.items()):
        symbols[f"numba_{name}"] = address
        if hasattr(math, name):
            symbols[name] = address
    for name, address in runtime.c_helpers.items():
        symbols[name if name.startswith("_") else f"NRT_{name}"] = address
    for name, kind in vars(builtins).items():
        if isinstance(kind, type) and issubclass(kind, BaseException):
            symbols[f"PyExc_{name}"] = id(kind)
    for name, address in symbols.items():
        llvm.add_symbol(name, address)
    # The first engine tells LLVM where the functions of Python and of the C library are.
    _engine()
    return functions


def _engine() -> Any:
    """An engine of LLVM that holds nothing: names of one kernel do not meet those of others."""
    target = llvm.Target.from_triple(llvm.get_process_triple())
    machine = target.create_target_machine(codemodel="jitdefault", jit=True)
    nothing = llvm.parse_assembly("")
    engine = llvm.create_mcjit_compiler(nothing, machine)
    engine.remove_module(nothing)
    return engine


def fits(code: MachineCode) -> bool:
    """Whether all functions are there that machine code calls; without one the process ends."""
    _know_symbols()
    return all(map(llvm.address_of_symbol, code.needs))


def function_of(code: MachineCode, name: str) -> Callable[..., Any]:
    """Make machine code a function.

    Parameters
    ----------
    code : MachineCode
    name : str            of the function
    """
    functions, engine = _know_symbols(), _engine()
    engine.add_object_file(llvm.object_file.ObjectFileRef.from_data(code.content))
    engine.finalize_object()
    environments = []
    for symbol, constants in code.constants.items():
        environment = functions.Environment({})
        environment.consts.extend(constants)
        environments.append(environment)
        place = engine.get_global_value_address(symbol)
        if place:
            ctypes.c_void_p.from_address(place).value = id(environment)
    run: Callable[..., Any] = functions.make_function(
        sys.modules[__name__], name, "", engine.get_function_address(code.entry),
        environments[0], (engine, *environments))
    return run
