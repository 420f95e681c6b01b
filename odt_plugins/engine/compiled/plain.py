"""Kernels that numba compiles while a program runs, where no library has them.

Each is kept in a folder of this user, for these sources and what the user has chosen of numba; a
later process takes it from there.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from contextlib import nullcontext
from functools import cache
from hashlib import sha256
from pathlib import Path
from threading import RLock
from typing import Any

import numba
from numba import njit, typeof
from numba.extending import typeof_impl

from odt_plugins.engine.compiled.library import CHOSEN, PROCESSOR, place, stamp
from odt_plugins.progress import HEARING, compiling_told

COMPILING = RLock()
"""Held while numba is told what to keep where, and while it compiles."""


@cache
def tell(kind: Any) -> None:
    """Let kernels, which are of this class, call kernels."""
    typeof_impl.register(kind)(lambda kernel, context: typeof(part(kernel)))


@cache
def part(kernel: Any) -> Any:
    """What numba compiles where another kernel calls this one."""
    return njit(nogil=True, error_model="numpy", forceinline=kernel.inlined)(kernel.py_func)


@cache
def whole(kernel: Any) -> Any:
    """What numba compiles where Python calls a kernel, kept on disk where that is possible."""
    config: Any = numba.config
    function, before = kernel.py_func, config.CACHE_DIR
    # numba keeps nothing of what stands in no file.
    folder = kept() if Path(function.__code__.co_filename).is_file() else None
    config.CACHE_DIR = str(folder or before)
    try:
        return njit(nogil=True, error_model="numpy", cache=folder is not None)(function)
    finally:
        config.CACHE_DIR = before


@cache
def kept() -> Path | None:
    """Where this user's processes keep what they compile; None, and a word, where they cannot."""
    chosen = [f"{name}={os.environ.get(name)}" for name in (PROCESSOR, *CHOSEN)]
    folder = place()
    if folder is not None:
        folder = folder / sha256("".join([stamp(), *chosen]).encode()).hexdigest()[:16]
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK | os.X_OK):
                return folder
        except OSError:
            pass
    say(f"compiled kernels cannot be kept in {folder or 'a folder, as there is no home'}; "
        "the environment variable NUMBA_CACHE_DIR names another one")
    return None


@cache
def say(line: str) -> None:
    """Say a line once, on stderr where the program has chosen no other place for what is logged."""
    logging.getLogger("odt_plugins").warning("odt_plugins: %s", line)


def compiled(kernel: Any, args: tuple[Any, ...]) -> Callable[..., Any]:
    """Compile a kernel for arguments of these types, or take it from disk; gives what runs it."""
    kind: Any = type(kernel)
    tell(kind)
    with COMPILING:
        made = whole(kernel)
        known = _on_disk(made, kernel)
        if not known and not HEARING:
            say("numba compiles kernels, which takes a minute or more, as no library has them; "
                "later runs take them from disk")
        with nullcontext() if known else compiling_told():
            try:
                made.compile(tuple(map(typeof, args)))
            except OSError as error:
                # The kernel is compiled by then: the disk has no room for it.
                say(f"compiled kernels cannot be kept: {error}")
    return made


def _on_disk(made: Any, kernel: Any) -> bool:
    """Whether numba has kept this kernel, at least for some types."""
    folder = made.stats.cache_path
    return folder is not None and any(Path(folder).glob(f"*{kernel.py_func.__name__}-*"))
