"""How the kernels are compiled."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numba
from numba import njit
from numba.core.cpu import CPUTargetOptions

from odt_plugins.engine.compiled.cache import KernelCache, source_stamp

TRIED = ("0.68.",)
"""Versions of numba that :mod:`odt_plugins.engine.compiled.compiler` takes apart; with another one
kernels are compiled as numba does by itself, which takes longer."""

STAMP = source_stamp(Path(__file__).parents[1])
"""Tells states of the engine apart in the cache of its kernels."""

UNCOUNTED: dict[str, Any] = {"_nrt": False} if hasattr(CPUTargetOptions, "_nrt") else {}
"""numba counts the references to every array that a call hands on, by atomic operations that
take longer than most of our calls.  Code that allocates nothing does not need it."""

COMMON: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
"""What numba is told of every kernel."""


def _own_compiler() -> Any:
    if not numba.__version__.startswith(TRIED):
        return None
    from odt_plugins.engine.compiled import compiler

    return compiler


OWN = _own_compiler()
"""Compiles kernels with less work than numba, None where numba does it by itself."""


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator of functions that numba compiles, and keeps where there is a place to write to.

    That is the directory of the package, or else the user's cache directory; without either
    they are compiled anew in every process.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher: Any = njit(**COMMON | (OWN.WHOLE if OWN else {}) | options)(function)
        dispatcher._cache = KernelCache(function, STAMP)
        # Looking for extensions of numba, of which no kernel needs one, takes longer than to load.
        dispatcher._compilation_chain_init_hook = bool
        return dispatcher

    return decorate


kernel = compiled(**UNCOUNTED)
"""Decorator of a scalar kernel that allocates no array; its caller keeps the arrays alive."""

allocating_kernel = compiled()
"""Decorator of a kernel that makes arrays of its own."""


class InnerKernel:
    """A kernel that only kernels call.

    It has neither machine code nor files of its own: whoever calls it takes its code in.  A call
    from Python, as tests make it, goes through a caller that is compiled for it.  numba hears of it
    when one that calls it is compiled.
    """

    def __init__(self, function: Callable[..., Any], **options: Any) -> None:
        self._function = function
        self._options = UNCOUNTED | {"no_cpython_wrapper": True} | options

    @cached_property
    def _dispatcher(self) -> Any:
        if not OWN:
            return compiled(**self._options)(self._function)
        dispatcher: Any = njit(**COMMON, **OWN.PART, **self._options)(self._function)
        dispatcher.compile = partial(OWN.compile_part, dispatcher)
        return dispatcher

    @property
    def _numba_type_(self) -> Any:
        return self._dispatcher._numba_type_

    def __getattr__(self, name: str) -> Any:
        return getattr(self._dispatcher, name)

    def __call__(self, *args: Any) -> Any:  # noqa: D102
        return self._caller(*args)

    @cached_property
    def _caller(self) -> Any:
        dispatcher = self._dispatcher
        caller: Any = njit(**COMMON)(lambda *args: dispatcher(*args))
        caller._cache = KernelCache(dispatcher.py_func, STAMP)
        return caller


inner_kernel = InnerKernel
"""Decorator of a kernel that only kernels call."""

inlined_kernel = partial(InnerKernel, forceinline=True)
"""The same of one that becomes part of its callers: for those called so often that handing on the
arrays, up to 150 words a call, takes longer than the work."""
