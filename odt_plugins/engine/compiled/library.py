"""The library of kernels that comes with an installation, loaded without numba.

A library has for every kernel and every level of the processor a function ``void f(i64 *slots)``.
Slots hold the size of the head of Python's objects, then numbers and addresses of arrays, of which
the function reads place and shape as NumPy's C interface lays them out (`PyArrayObject`). It leaves
the results in the first slots. ``odt_kernels`` is the table of contents, ``odt_level`` tells which
of the levels of a processor this one has.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import re
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from struct import Struct
from typing import Any

import numpy as np

PACKAGE = Path(__file__).parents[2]
"""The folder of all kernels."""

MARK = b"compiled.kernel import"
"""In the files in which kernels stand."""

FILE = Path(__file__).parent / "kernels.so"
"""The library."""

PROCESSOR = "NUMBA_CPU_NAME"
"""Variable of the environment that names a processor, which a library may have as a level."""

CHOSEN = ("NUMBA_CPU_FEATURES", "NUMBA_ENABLE_AVX", "NUMBA_BOUNDSCHECK", "NUMBA_OPT")
"""Further variables by which a user chooses what numba compiles for, and how."""

HEAD = object.__basicsize__
"""Bytes before the address of the data of an array."""

CODES = {"int64": "q", "float64": "d", "bool": "?7x"}
"""Letters of :mod:`struct` for numbers in slots; arrays have an address."""

LEAF = re.compile(r"[\w.]+(?=[\[,)]|$)")
"""Types of numbers and arrays among those of a kernel."""

Entry = Callable[[tuple[Any, ...], list[Any]], Any]


def source_stamp(folder: Path) -> str:
    """Short hash of the files in a folder, and below, in which kernels stand."""
    digest = hashlib.sha256()
    for top, inner, names in os.walk(folder):
        inner[:] = sorted(set(inner) - {"__pycache__"})
        for name in sorted(name for name in names if name.endswith(".py")):
            # An editor may leave links that lead nowhere.
            with contextlib.suppress(OSError):
                text = Path(top, name).read_bytes()
                if MARK in text:
                    digest.update(hashlib.sha256(text).digest())
    return digest.hexdigest()[:12]


@cache
def stamp() -> str:
    """Tells states of the sources apart, as they are at the first call."""
    return source_stamp(PACKAGE)


def place() -> Path | None:
    """Where kernels of this user lie that numba compiled; None for a user without a home.

    In NUMBA_CACHE_DIR, or where the system keeps caches.
    """
    caches = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    caches = caches or os.environ.get("LOCALAPPDATA") or os.path.expanduser("~/.cache")
    return None if caches.startswith("~") else Path(caches) / "odt_plugins"


@cache
def library() -> dict[str, Entry]:
    """Load the library: its functions by the kernels' names and types.

    Nothing where there is none for these sources and this processor or the one of
    :data:`PROCESSOR`, or where the user has chosen how numba compiles.
    """
    return {} if any(map(os.environ.get, CHOSEN)) else load(FILE)


def load(file: Path) -> dict[str, Entry]:
    """As :func:`library`, from a file."""
    try:
        loaded = ctypes.CDLL(str(file))
    except OSError:
        return {}
    table = ctypes.string_at(ctypes.addressof(ctypes.c_char.in_dll(loaded, "odt_kernels")))
    head, *lines = table.decode().splitlines()
    of, *levels = head.split()
    best, wanted = loaded.odt_level(), os.environ.get(PROCESSOR)
    level = best if not wanted else levels.index(wanted) + 1 if wanted in levels else 0
    if not 0 < level <= best or of != stamp() or not _arrays_are_as_known():
        return {}
    return {line.partition(" -> ")[0]: _entry(getattr(loaded, f"odt_{level}_{number}"), line)
            for number, line in enumerate(lines)}


def _arrays_are_as_known() -> bool:
    """Whether place and shape of an array lie where machine code looks for them."""
    if sys.implementation.name != "cpython":
        return False
    array, words = np.empty((2, 3)), ctypes.c_ssize_t * 3
    data, _, shape = words.from_address(id(array) + HEAD)
    return data == array.ctypes.data and words.from_address(shape)[:2] == [2, 3]


def _entry(function: Any, line: str) -> Entry:
    """Make a function of a library one of Python.

    Parameters
    ----------
    function : of ctypes
    line : str              of the table of contents, ``module.kernel(types) -> results``
    """
    types, _, results = line.partition(" -> ")
    given = Struct("q" + "".join(CODES.get(kind, "q") for kind in LEAF.findall(types)))
    made = Struct("".join(map(CODES.__getitem__, LEAF.findall(results))))
    slots_of = ctypes.c_char * max(given.size, made.size)
    pack, unpack, single = given.pack_into, made.unpack_from, results in CODES

    def run(args: tuple[Any, ...], slots: list[Any]) -> Any:
        held = slots_of()
        pack(held, 0, HEAD, *slots)
        function(held)
        if single:
            return unpack(held)[0]
        return unpack(held) if made.size else None

    return run
