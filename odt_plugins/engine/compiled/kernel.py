"""What a kernel is: a function that Python calls as machine code."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from functools import cached_property, partial, update_wrapper
from threading import RLock
from typing import Any

from numpy import bool_, float64, int64, ndarray

from odt_plugins.engine.compiled import cache
from odt_plugins.engine.compiled.machine import fits, function_of
from odt_plugins.progress import compiling_told

SCALARS: dict[type, str] = {
    bool: "bool", bool_: "bool", int: "int64", int64: "int64", float: "float64", float64: "float64",
}
"""Numbers of Python and NumPy that kernels take for the same."""

ALIGNED, WRITEABLE = 0x100, 0x400
"""Of the flags of an array, as NumPy's ``ndarray.flags.num`` holds them."""

LAYOUTS = "ACFC"
"""Letters of the flags C and F: neither, C, F, both."""

LOADING = RLock()
"""Held while machine code is looked for, so that no two threads make the same, or while it is made,
as numba compiles one kernel at a time."""


def add_kinds(values: Iterable[Any], kinds: list[Any]) -> None:
    """Append to ``kinds`` what tells values from those of other types, and from some of the same.

    Tuples are laid out flat: a run makes hundreds of such keys, and nested ones take longer.
    """
    for value in values:
        kind = type(value)
        if kind is ndarray:
            kinds += (value.dtype, value.ndim, value.flags.num)
        elif kind in SCALARS:
            kinds.append(SCALARS[kind])
        elif isinstance(value, tuple):
            kinds += (kind, len(value))
            add_kinds(value, kinds)
        elif isinstance(value, ndarray):
            add_kinds((value.view(ndarray),), kinds)
        else:
            kinds.append(kind)


def type_of(value: Any) -> Any:
    """Give what all arguments have in common that go to the same machine code.

    The same types have the same ``repr``, which equal dtypes have not.
    """
    if isinstance(value, ndarray):
        flags = value.flags.num
        return value.dtype.str, value.ndim, LAYOUTS[flags & 3], flags & (ALIGNED | WRITEABLE)
    kind = type(value)
    if isinstance(value, tuple):
        return kind, *map(type_of, value)
    return SCALARS.get(kind, kind)


class Kernel:
    """A function that numba compiles, and that Python calls without numba once it is on disk.

    Machine code for the types of the arguments is loaded by the first call of a process, from
    where the installation put it or this user's processes keep theirs; what is not there is
    compiled, and kept where there is a place to write to, unless it is a closure.  A kernel that
    other kernels call is taken in by each of them.  Arguments go by position; subclasses of arrays
    count as arrays. Where NUMBA_DISABLE_JIT is set, it is the function of Python that runs.
    No index but a literal may be negative, see ``compiler.from_start``.

    Parameters
    ----------
    function : callable
    **options               what numba is told of it
    """

    def __init__(self, function: Callable[..., Any], **options: Any) -> None:
        update_wrapper(self, function)
        self.py_func = function
        self.options = options
        self.loaded: dict[Any, Callable[..., Any]] = {}
        self._by_kinds: dict[Any, Callable[..., Any]] = {}
        cache.file_stamp(function.__code__.co_filename)

    def __call__(self, *args: Any) -> Any:
        """Run the machine code for arguments of these types."""
        kinds: list[Any] = []
        add_kinds(args, kinds)
        key = tuple(kinds)
        run = self._by_kinds.get(key)
        if run is None:
            run = self._by_kinds[key] = self._load(tuple(map(type_of, args)), args)
        return run(*args)

    def _load(self, types: Any, args: Any) -> Callable[..., Any]:
        if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
            return self.py_func
        with LOADING:
            if types not in self.loaded:
                code = None if self.py_func.__closure__ else cache.load(self.py_func, types)
                if code is None or not fits(code):
                    with compiling_told():
                        from odt_plugins.engine.compiled.compiler import compile_whole

                        code = compile_whole(self.py_func, self.options, args)
                        cache.save(self.py_func, types, code)
                self.loaded[types] = function_of(code, self.py_func.__name__)
            return self.loaded[types]

    @cached_property
    def part(self) -> Any:
        """What numba compiles where another kernel calls this one."""
        from odt_plugins.engine.compiled.compiler import part

        return part(self.py_func, self.options)

    @property
    def _numba_type_(self) -> Any:
        return self.part._numba_type_


allocating_kernel = Kernel
"""Decorator of a kernel that makes arrays of its own."""

kernel = partial(Kernel, _nrt=False)
"""Decorator of a scalar kernel that allocates no array; its caller keeps the arrays alive.

numba counts the references to every array that a call hands on, by atomic operations that take
longer than most of our calls.  Code that allocates nothing does not need it."""

inlined_kernel = partial(Kernel, _nrt=False, forceinline=True)
"""Decorator of a kernel as :data:`kernel` that becomes part of its callers: for those called so
often that handing on the arrays, up to 150 words a call, takes longer than the work."""
