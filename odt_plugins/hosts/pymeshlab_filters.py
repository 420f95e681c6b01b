"""Filters of odt_plugins inside pymeshlab: methods, apply_filter, scripts, lists and log."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable
from typing import Any
from xml.etree import ElementTree

from odt_plugins.adapters.pymeshlab_set import saved_script
from odt_plugins.errors import ODTError
from odt_plugins.hosts.filter_table import BY_GUI, FILTERS, Filter
from odt_plugins.hosts.pymeshlab_apply import (
    has_selection,
    in_words,
    require_faces,
    run_filter,
    say,
)
from odt_plugins.hosts.pymeshlab_work import diagonal
from odt_plugins.hosts.script import apply_script


def register() -> None:
    """Add the filters to pymeshlab: methods, apply_filter, lists, filter scripts."""
    import pymeshlab

    kind = pymeshlab.MeshSet
    if hasattr(kind, next(iter(FILTERS))):
        return
    for chosen in FILTERS.values():
        setattr(kind, chosen.name, _method(chosen))
    _replace(kind, "apply_filter", _apply_filter)
    _replace(kind, "filter_parameter_values", _filter_parameter_values)
    _replace(kind, "apply_filter_script", _apply_filter_script)
    for name, function in (
        ("filter_list", _filter_list),
        ("print_filter_list", _print_filter_list),
        ("print_filter_parameter_list", _print_filter_parameter_list),
        ("search", _search),
    ):
        _replace(pymeshlab, name, function)


def _method(chosen: Filter) -> Callable[..., Any]:
    def method(self: Any, **parameters: Any) -> Any:
        return run_filter(self, chosen.name, parameters)

    own = inspect.Parameter("self", inspect.Parameter.POSITIONAL_ONLY)
    keywords = [
        inspect.Parameter(p.name, inspect.Parameter.KEYWORD_ONLY, default=p.default)
        for p in chosen.parameters
    ]
    method.__name__ = chosen.name
    method.__qualname__ = f"MeshSet.{chosen.name}"
    method.__doc__ = chosen.doc()
    method.__signature__ = inspect.Signature([own, *keywords])  # type: ignore[attr-defined]
    return method


def _replace(owner: Any, name: str, wrapper: Callable[..., Any]) -> None:
    """Put a wrapper before a function of pymeshlab; it gets that function first."""
    native = getattr(owner, name)

    def wrapped(*args: Any, **kwargs: Any) -> Any:
        return wrapper(native, *args, **kwargs)

    wrapped.__name__ = name
    wrapped.__doc__ = native.__doc__
    setattr(owner, name, wrapped)


def _apply_filter(native: Any, self: Any, filter_name: str, **kwargs: Any) -> Any:
    if filter_name in FILTERS:
        return run_filter(self, filter_name, kwargs)
    import pymeshlab

    try:
        return native(self, filter_name, **kwargs)
    except pymeshlab.PyMeshLabException as exc:
        known = pymeshlab.filter_list()
        near = difflib.get_close_matches(filter_name, known, n=1)
        if filter_name in known or not near:
            raise
        msg = f"{exc}\nDid you mean {near[0]}?"
        raise type(exc)(msg) from exc


def _filter_parameter_values(native: Any, self: Any, name: str, **kwargs: Any) -> Any:
    if name not in FILTERS:
        return native(self, name, **kwargs)
    try:
        require_faces(self, name)
        return FILTERS[name].values(kwargs, diagonal(self), has_selection(self))
    except ODTError as exc:
        raise in_words(exc, name) from exc


def _apply_filter_script(native: Any, self: Any) -> None:
    script = saved_script(self)
    names = [entry.get("name") for entry in ElementTree.fromstring(script)]
    if any(name in BY_GUI for name in names):
        apply_script(self, script, "the filter script")
    else:
        native(self)


def _filter_list(native: Any) -> list[str]:
    return sorted([*native(), *FILTERS])


def _print_filter_list(native: Any) -> None:
    native()
    say("".join(f"\t{name}\n" for name in FILTERS))


def _print_filter_parameter_list(native: Any, name: str) -> None:
    if name not in FILTERS:
        native(name)
        return
    say(f"{name} filter - list of parameter names:\n")
    for p in FILTERS[name].parameters:
        if p.kind == "length":
            shown = f"PercentageValue = {p.default}%"
        elif p.kind == "enum":
            shown = f"str = {p.default!r} (or one of {', '.join(map(repr, p.choices))})"
        else:
            kind = "str" if p.kind == "string" else p.kind
            shown = f"{kind} = {bool(p.default) if p.kind == 'bool' else p.default}"
        say(f"\t{p.name} : {shown}\n")


def _search(native: Any, keyword: str) -> None:
    native(keyword)
    say("".join(f"{name}\n" for name in FILTERS if keyword.lower() in name))
