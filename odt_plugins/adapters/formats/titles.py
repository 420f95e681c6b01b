"""Names of groups: as keys of one dictionary where files give one to several, and as bytes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from itertools import chain, count
from typing import Any

import numpy as np
from numpy.typing import NDArray

CONTROL = r"[\x00-\x1f\x7f\x85\u2028\u2029]"
"""A letter that ends a line or is none."""

BARRED = r'["\x00-\x1f\x7f\x85\u2028\u2029]'
"""A letter that ends a line or a name in quotes, or is none."""


def titled(groups: Iterable[tuple[str, int, int]]) -> dict[str, NDArray[np.int64]]:
    """Tag and dimension of groups by their names.

    Of groups with the same name the second one, by dimension and tag, has its dimension behind it,
    others that and their tags.

    Parameters
    ----------
    groups : name, dimension and tag of each
    """
    out: dict[str, NDArray[np.int64]] = {}
    for dim, tag, name in sorted((dim, tag, name) for name, dim, tag in groups):
        last = f"{name} ({dim}D, {tag})"
        title = next((t for t in (name, f"{name} ({dim}D)") if t not in out), last)
        out[title] = np.array([tag, dim])
    return out


def plain(title: str, names: Mapping[str, Any]) -> str:
    """Name of a group of :func:`titled` in its file."""
    tag, dim = names[title]
    for behind in (f" ({dim}D)", f" ({dim}D, {tag})"):
        name = title.removesuffix(behind)
        if title.endswith(behind) and name in names:
            return name
    return title


def written(names: Iterable[str], barred: str = BARRED) -> dict[str, str]:
    """What names are in a file: `_` in place of barred letters, with a number where one has that.

    Parameters
    ----------
    names : str
    barred : str     a pattern of the letters
    """
    given = dict.fromkeys(names)
    out: dict[str, str] = {}
    for name in given:
        one = re.sub(barred, "_", name)
        titles = (one + end for end in chain([""], (f"_{k}" for k in count(2))))
        out[name] = next(title for title in titles if title == name or (
            title not in given and title not in out.values()))
    return out


def decoded(text: bytes) -> str:
    """Text of a file: UTF-8 where it can be that, else Latin-1."""
    try:
        return text.decode("utf-8")
    except UnicodeDecodeError:
        return text.decode("latin-1")


def encoded(text: str, like: bytes) -> bytes:
    """Bytes of a text in the encoding in which :func:`decoded` reads another text of its file."""
    if decoded(like).encode("utf-8") == like:
        return text.encode("utf-8")
    try:
        return text.encode("latin-1")
    except UnicodeEncodeError:
        return text.encode("utf-8")
