"""What a kernel is: a function that Python calls as machine code."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from functools import partial, update_wrapper
from typing import Any

import numpy as np
from numpy import bool_, float64, int64, ndarray

from odt_plugins.engine.compiled.library import library
from odt_plugins.errors import require

SCALARS: dict[type, str] = {
    bool: "bool", bool_: "bool", int: "int64", int64: "int64", float: "float64", float64: "float64",
}
"""Numbers of Python and NumPy that kernels take for the same."""

ALIGNED, WRITEABLE, ROWS = 0x100, 0x400, 0x1
"""Of the flags of an array, as NumPy's ``ndarray.flags.num`` holds them; ROWS: one follows the
other without a gap."""

PLAIN = ALIGNED | WRITEABLE | ROWS
"""Flags of the arrays that machine code takes as they are."""

Run = Callable[[tuple[Any, ...], list[Any]], Any]
"""What runs for arguments of some types: takes them as they are, and what :func:`lay_out` makes."""


def lay_out(values: Iterable[Any], kinds: list[Any], slots: list[Any]) -> None:
    """Append to ``slots`` numbers and the addresses of arrays, tuples laid out flat.

    To ``kinds`` comes what tells the values from those of other types, and from some of the same.
    """
    for value in values:
        kind = type(value)
        if kind is ndarray:
            kinds += (value.dtype, value.ndim, value.flags.num)
            slots.append(id(value))
        elif kind in SCALARS:
            kinds.append(SCALARS[kind])
            slots.append(value)
        elif isinstance(value, tuple):
            kinds += (kind, len(value))
            lay_out(value, kinds, slots)
        else:
            kinds += (kind, value.dtype, value.ndim, value.flags.num) if (
                isinstance(value, ndarray)) else (kind,)
            slots.append(id(value))


def spelled(value: Any) -> str:
    """Type of an argument as a library spells it, however an array lies in memory.

    ``float64``, ``f8[2]`` for an array of two axes, ``odt_plugins.module.Class(f8[2], int64)``.
    """
    if isinstance(value, ndarray):
        kind = value.dtype.str[1:] if value.dtype.isnative else value.dtype.str
        return f"{kind}[{value.ndim}]"
    kind = type(value)
    if isinstance(value, tuple):
        name = "tuple" if kind is tuple else f"{kind.__module__}.{kind.__qualname__}"
        return f"{name}({', '.join(map(spelled, value))})"
    return SCALARS.get(kind) or f"{kind.__module__}.{kind.__qualname__}"


def flat(values: Iterable[Any]) -> Iterator[Any]:
    """Give the numbers and arrays of nested tuples in order."""
    for value in values:
        if isinstance(value, tuple):
            yield from flat(value)
        else:
            yield value


def through_copies(run: Run) -> Run:
    """Let machine code run on copies of the arrays that do not lie as it takes them.

    What it changes goes back, where an array may be written to.
    """
    def copied(args: tuple[Any, ...], slots: list[Any]) -> Any:
        copies = []
        for place, value in enumerate(flat(args)):
            if isinstance(value, ndarray) and value.flags.num & PLAIN != PLAIN:
                copy = np.array(value, order="C", subok=False)
                slots[place] = id(copy)
                copies.append((value, copy, copy.copy()))
        result = run(args, slots)
        for value, copy, before in copies:
            if value.flags.writeable:
                np.copyto(value, copy, where=copy != before)
        return result

    return copied


class Kernel:
    """A function of scalars and arrays that Python calls as machine code.

    It comes from the library that an installation brings (:mod:`..compiled.library`), by the types
    of the arguments.  Where there is none, or where other types come, numba compiles it
    (:mod:`..compiled.plain`).  Arguments go by position.  Where NUMBA_DISABLE_JIT is set, it is the
    function of Python that runs.

    Parameters
    ----------
    function : callable
    allocates : bool        whether it makes arrays of its own
    inlined : bool          whether it becomes part of the kernels that call it
    apart : bool            whether a library has it as a function that its callers call
    """

    def __init__(self, function: Callable[..., Any], *, allocates: bool = True,
                 inlined: bool = False, apart: bool = False) -> None:
        update_wrapper(self, function)
        self.py_func = function
        self.allocates, self.inlined, self.apart = allocates, inlined, apart
        self.loaded: dict[str, Run] = {}
        self.runs: dict[Any, Run] = {}
        self.in_python = False

    def __call__(self, *args: Any) -> Any:
        """Run the machine code for arguments of these types."""
        if self.in_python:
            return self.py_func(*args)
        kinds: list[Any] = []
        slots: list[Any] = []
        lay_out(args, kinds, slots)
        key = tuple(kinds)
        run = self.runs.get(key)
        if run is None:
            run = self.runs[key] = self._find(args)
        return run(args, slots)

    def _find(self, args: tuple[Any, ...]) -> Run:
        self.in_python = os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")
        if self.in_python:
            return lambda args, slots: self.py_func(*args)
        name = f"{self.py_func.__module__}.{self.py_func.__qualname__}"
        line = f"{name}({', '.join(map(spelled, args))})"
        run = self.loaded[line] = library().get(line) or by_numba(self, args)
        plain = all(value.flags.num & PLAIN == PLAIN
                    for value in flat(args) if isinstance(value, ndarray))
        return run if plain or line not in library() else through_copies(run)


def by_numba(kernel: Kernel, args: tuple[Any, ...]) -> Run:
    """Compile a kernel for arguments of these types.

    Raises
    ------
    MissingDependencyError
    """
    require("a kernel that is in no library", "numba", "numba")
    from odt_plugins.engine.compiled.plain import compiled

    made = compiled(kernel, args)
    return lambda args, slots: made(*args)


allocating_kernel = Kernel
"""Decorator of a kernel that makes arrays of its own."""

kernel = partial(Kernel, allocates=False)
"""Decorator of a scalar kernel that allocates no array; its caller keeps the arrays alive.

numba counts the references to every array that a call hands on, by atomic operations that take
longer than most of our calls.  In a library such a kernel counts none."""

apart_kernel = partial(Kernel, allocates=False, apart=True)
"""Decorator of a kernel as :data:`kernel` that stays a function: for long ones with many callers,
few of whose runs need any."""

inlined_kernel = partial(Kernel, allocates=False, inlined=True)
"""Decorator of a kernel as :data:`kernel` that becomes part of its callers: for those called so
often that handing on the arrays, up to 150 words a call, takes longer than the work."""
