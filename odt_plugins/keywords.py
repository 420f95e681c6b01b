"""Keyword arguments of the public functions, for type checkers and for help()."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypedDict, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from odt_plugins.objectives import Objective
from odt_plugins.options import OPTIONS, Boundary, Fields, Method, Progress, Repair

FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])


class OptionKeywords(TypedDict, total=False):
    """Keyword arguments of :func:`odt_plugins.optimize`: the fields of :class:`Options`.

    A type checker cannot derive these from :class:`Options`; a test holds both equal.
    """

    method: Method
    density: str | ArrayLike | Callable[[NDArray[np.float64]], ArrayLike]
    metric: str | ArrayLike | Callable[[NDArray[np.float64]], ArrayLike] | None
    smoothing: Mapping[str, Any]
    finish: bool
    objective: Objective
    insert: bool | float
    boundary: Boundary
    envelope: float
    reference: Any
    feature_angle: float
    fixed: ArrayLike | None
    selection: ArrayLike | None
    regions: str | Sequence[str] | ArrayLike | None
    fields: Fields
    free: str | tuple[str, ...]
    keep: str | tuple[str, ...]
    repair: Repair
    threads: int
    progress: Progress | bool | None


class RunKeywords(OptionKeywords, total=False):
    """The same with what says where the work is done and where the result goes."""

    target: str | os.PathLike[str] | None
    file_format: str | None
    binary: bool | None
    blocks: int | None
    block_rounds: int
    workers: int
    client: Any


RUN: dict[str, Any] = {"target": None, "file_format": None, "binary": None, "blocks": None,
                       "block_rounds": 3, "workers": 0, "client": None}
"""The latter arguments of :func:`odt_plugins.optimize`, which are no options of a run."""


def with_option_signature(
    *without: str, run: bool = False, **others: Any
) -> Callable[[FunctionT], FunctionT]:
    """Let help() and inspect show every option instead of `**options`, without some names, and
    with other defaults of some.

    With `run` the arguments in RUN stand before them.
    """

    def decorate(function: FunctionT) -> FunctionT:
        signature = inspect.signature(function)
        own = [p for p in signature.parameters.values()
               if p.kind is not p.VAR_KEYWORD and p.name not in without]
        own += [inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=value,
                                  annotation=RunKeywords.__annotations__[name].__forward_arg__)
                for name, value in RUN.items() if run]
        keywords = [
            inspect.Parameter(
                name, inspect.Parameter.KEYWORD_ONLY, default=others.get(name, about.default),
                annotation=about.type
            )
            for name, about in OPTIONS.items() if name not in without
        ]
        function.__signature__ = signature.replace(parameters=[*own, *keywords])  # type: ignore[attr-defined]
        return function

    return decorate
