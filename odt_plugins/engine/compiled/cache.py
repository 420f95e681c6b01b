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
from functools import cache
from pathlib import Path
from typing import Any
from uuid import uuid4

import llvmlite
import llvmlite.binding as llvm

from odt_plugins.engine.compiled.machine import MachineCode, numba_version

AHEAD = Path(__file__).parent / "ahead"
"""Kernels that were compiled when the package was installed, for :func:`common_machine`."""

ENGINE = Path(__file__).parents[1]
"""The folder of all kernels."""

CHOSEN = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NUMBA_ENABLE_AVX", "NUMBA_BOUNDSCHECK")
"""Variables of the environment by which a user chooses what numba compiles for, and how."""

SUFFIX = ".kernel"
"""Of the files with machine code."""

DIGEST = hashlib.sha256().digest_size
"""Bytes at the begin of a file that tell whether the rest is whole."""

PROCESSORS = {
    "x86-64-v3": ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "xsave"),
    "x86-64-v2": ("cx16", "popcnt", "sse4.2", "ssse3"),
}
"""Processors that many share, by LLVM's name, the better first: what they have to have."""


@cache
def common_machine() -> tuple[str, str, str]:
    """Give the best of the processors in common use that this one can stand in for.

    Returns
    -------
    system, processor, features    LLVM's name of processor family and system, and what the
                                   environment variables NUMBA_CPU_NAME and NUMBA_CPU_FEATURES are
                                   for its kernels
    """
    known = llvm.get_host_cpu_features()
    fitting = (name for name, needed in PROCESSORS.items() if all(map(known.get, needed)))
    return llvm.get_process_triple(), next(fitting, "generic"), ""


def this_machine() -> tuple[str, ...]:
    """The same of the processor that numba compiles for, and what else the user has chosen."""
    processor, features = map(os.environ.get, CHOSEN[:2])
    if features is None:
        features = llvm.get_host_cpu_features().flatten()
    others = (f"{name}={os.environ[name]}" for name in CHOSEN[2:] if os.environ.get(name))
    return llvm.get_process_triple(), processor or llvm.get_host_cpu_name(), features, *others


def source_stamp(folder: Path) -> str:
    """Short hash of the files in a folder, and below, in which kernels stand."""
    digest = hashlib.sha256()
    for top, inner, names in os.walk(folder):
        # Where kernels are kept there are hundreds of files and no source.
        inner[:] = sorted(set(inner) - {"__pycache__"})
        for name in sorted(name for name in names if name.endswith(".py")):
            # An editor may leave links that lead nowhere.
            with contextlib.suppress(OSError):
                text = Path(top, name).read_bytes()
                if b"kernel" in text:
                    digest.update(hashlib.sha256(text).digest())
    return digest.hexdigest()[:12]


STAMP = source_stamp(ENGINE)
"""Tells states of the engine apart, as they are when it is imported."""


@cache
def file_stamp(name: str) -> bytes:
    """Hash of a file, as it is at the first call; its name where it cannot be read.

    Nothing for a file that STAMP holds: kernels are compiled where the package is built.
    """
    if Path(name).is_relative_to(ENGINE):
        return b""
    try:
        return hashlib.sha256(Path(name).read_bytes()).digest()
    except OSError:
        return name.encode()


@cache
def kept() -> Path | None:
    """Where this user's processes keep what they compile; None where nothing can be written."""
    folder = place()
    if folder is None:
        return None
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK | os.X_OK):
            return folder
    return None


def place() -> Path | None:
    """Where kernels of this user lie: NUMBA_CACHE_DIR, or a folder where the system keeps caches.

    None for a user without a home.
    """
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(chosen)
    caches = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    caches = caches or os.path.expanduser("~/.cache")
    return None if caches.startswith("~") else Path(caches) / "odt_plugins"


def load(function: Callable[..., Any], types: Any) -> MachineCode | None:
    """Give a kernel for these types of arguments, None if there is none on disk."""
    for path in _places(function, types):
        with contextlib.suppress(OSError):
            content = path.read_bytes()
            if content.startswith(hashlib.sha256(content[DIGEST:]).digest()):
                return MachineCode(*pickle.loads(content[DIGEST:]))
    return None


def _places(function: Callable[..., Any], types: Any) -> Iterator[Path]:
    """Files that may hold a kernel, the likeliest first."""
    if not any(map(os.environ.get, CHOSEN)):
        yield AHEAD / _name(function, types, common_machine())
    folder = kept()
    if folder:
        yield folder / _name(function, types, this_machine())


def save(function: Callable[..., Any], types: Any, code: MachineCode) -> None:
    """Keep a kernel for these types of arguments, where there is a place and room."""
    folder = kept()
    if folder and code.lasting:
        content = pickle.dumps(tuple(code))
        with contextlib.suppress(OSError):
            write(folder / _name(function, types, this_machine()),
                  hashlib.sha256(content).digest() + content)


def _name(function: Callable[..., Any], types: Any, machine: tuple[str, ...]) -> str:
    code = function.__code__
    key = (numba_version(), llvmlite.__version__, sys.implementation.cache_tag, machine, STAMP,
           file_stamp(code.co_filename), code.co_firstlineno, types)
    digest = hashlib.sha256(repr(key).encode()).hexdigest()
    return f"{function.__module__}.{function.__name__}.{digest[:20]}{SUFFIX}"


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
