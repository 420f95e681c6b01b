"""Machine code on disk that goes with the source of all kernels.

A kernel takes in the code of those that it calls, in files of its own or of others: its name on
disk has the hash of all of them, of what compiled it and of the processor that it is for.  Code
comes from :data:`AHEAD`, which an installation fills, or else from where this user's processes keep
what they compile.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import sys
from collections.abc import Callable, Iterator
from functools import cache, cached_property
from pathlib import Path
from typing import Any
from uuid import uuid4

import llvmlite.binding as llvm
import numba
from numba.core.caching import FunctionCache, NullCache
from numba.core.runtime._nrt_python import c_helpers
from numba.core.serialize import dumps

from odt_plugins.engine.compiled.code import from_disk, to_disk

AHEAD = Path(__file__).parent / "ahead"
"""Kernels that were compiled when the package was installed, for :func:`common_machine`."""

SUFFIX = ".kernel"
"""Of the files with machine code."""

PROCESSORS = {
    "x86-64-v3": ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "xsave"),
    "x86-64-v2": ("cx16", "popcnt", "sse4.2", "ssse3"),
}
"""Processors that many share, by LLVM's name, the better first: what they have to have."""


@cache
def common_machine(system: str) -> tuple[str, str, str]:
    """Give the best of the processors in common use that this one can stand in for.

    Parameters
    ----------
    system : str    LLVM's name of processor family and system

    Returns
    -------
    system, processor, features    as numba tells machines apart; what the environment variables
                                   NUMBA_CPU_NAME and NUMBA_CPU_FEATURES are for its kernels
    """
    known = llvm.get_host_cpu_features()
    fitting = (name for name, needed in PROCESSORS.items() if all(map(known.get, needed)))
    return system, next(fitting, "generic"), ""


def source_stamp(folder: Path) -> str:
    """Short hash of the files in a folder, and below, in which kernels stand."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        # An editor may leave links that lead nowhere.
        with contextlib.suppress(OSError):
            text = path.read_bytes()
            if b"kernel" in text:
                digest.update(hashlib.sha256(text).digest())
    return digest.hexdigest()[:12]


@cache
def _machine(codegen: Any) -> tuple[str, ...]:
    """System, processor and features, as numba tells machines apart."""
    return tuple(codegen.magic_tuple())


@cache
def _know_runtime() -> None:
    """Tell LLVM where numba's runtime is, which kernels that allocate call.

    What numba compiles of it besides is for kernels that are compiled.
    """
    for name, address in c_helpers.items():
        llvm.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)


@cache
def _file_stamp(name: str) -> bytes:
    """Hash of a file, of its name where it cannot be read."""
    try:
        return hashlib.sha256(Path(name).read_bytes()).digest()
    except OSError:
        return name.encode()


class KernelCache(NullCache):  # type: ignore[misc]
    """What numba asks for a kernel before it compiles it, and tells of it afterwards.

    Processes with other sources never read or write the same file.  On a full disk, and where
    nothing may be written, a kernel is compiled in every process.  Code that is found needs
    nothing of what numba imports for compiling, half a second of work.

    Parameters
    ----------
    function : callable    the kernel
    stamp : str            hash of the sources of all kernels
    """

    def __init__(self, function: Callable[..., Any], stamp: str) -> None:
        self._function, self._stamp = function, stamp

    @cached_property
    def _locator(self) -> Any:
        """What numba knows of the place to write to; None where there is none."""
        try:
            return FunctionCache(self._function)._impl.locator
        except RuntimeError:
            return None

    @property
    def cache_path(self) -> str | None:
        """Directory to write to."""
        return str(self._locator.get_cache_path()) if self._locator else None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Give a kernel for these types of arguments, None if there is none on disk."""
        _know_runtime()
        machine = _machine(target_context.codegen())
        for path in self._places(sig, machine):
            with contextlib.suppress(OSError, EOFError, pickle.UnpicklingError):
                return from_disk(target_context, pickle.loads(path.read_bytes()))
        return None

    def _places(self, sig: Any, machine: tuple[str, ...]) -> Iterator[Path]:
        """Files that may hold a kernel; where users keep theirs is looked for at last."""
        if not os.environ.get("NUMBA_CPU_NAME"):
            yield AHEAD / self._name(sig, common_machine(machine[0]))
        if self.cache_path:
            yield Path(self.cache_path) / self._name(sig, machine)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a kernel for these types of arguments, where there is a place and room."""
        if self.cache_path and not data.library.has_dynamic_globals:
            with contextlib.suppress(OSError):
                self._locator.ensure_cache_path()
                write(Path(self.cache_path) / self._name(sig, data.codegen.magic_tuple()),
                      dumps(to_disk(data)))

    def _name(self, sig: Any, machine: tuple[str, ...]) -> str:
        code = self._function.__code__
        closure = [cell.cell_contents for cell in self._function.__closure__ or ()]
        key = (numba.__version__, sys.implementation.cache_tag, machine, self._stamp,
               _file_stamp(code.co_filename), code.co_firstlineno, closure, str(sig))
        digest = hashlib.sha256(repr(key).encode()).hexdigest()
        return f"{self._function.__module__}.{self._function.__name__}.{digest[:20]}{SUFFIX}"


def write(path: Path, content: bytes) -> None:
    """Write a file whole or not at all.

    Raises
    ------
    OSError
    """
    beside = path.with_name(uuid4().hex)
    try:
        beside.write_bytes(content)
        beside.replace(path)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise
