"""Templates filled by jinja2: pages, Markdown, LaTeX and BibTeX."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from odt_plugins.errors import require

BASE = Path(__file__).parent / "templates"
"""What all pages have in common."""

TEX = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}", "<": r"\textless{}", ">": r"\textgreater{}", '"': "''",
    "°": r"$^\circ$", "▲": r"$^{\ast}$", "△": r"$^{\dagger}$", "·": r"$\cdot$",
} | {sign: f"\\{sign}" for sign in "&%$#_"}
"""What LaTeX would read as something else, or its fonts lack."""


def check_page() -> None:
    """See whether the page can be made, before any work is done.

    Raises
    ------
    MissingDependencyError    jinja2 is not installed
    """
    require("the page of the comparison", "compare", "jinja2")


def fill_template(template: Path, **values: Any) -> str:
    """Fill a template; what is filled in is escaped in HTML only.

    Parameters
    ----------
    template : path      may extend the ``base.html`` of this room and what stands beside it
    **values             of its names

    Raises
    ------
    MissingDependencyError    jinja2 is not installed
    """
    check_page()
    from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape

    loader = FileSystemLoader([template.parent, BASE])
    environment = Environment(loader=loader, autoescape=select_autoescape(["html"]),
                              undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
                              keep_trailing_newline=True)
    environment.filters |= {"tex": tex, "markdown": markdown}
    return environment.get_template(template.name).render(**values)


def tex(value: object) -> str:
    """Escape a text for LaTeX, lines made one."""
    return re.sub(r"\s", " ", "".join(TEX.get(sign, sign) for sign in str(value)))


def markdown(value: object) -> str:
    """Escape a text for a field of a Markdown table, lines made one."""
    return re.sub(r"\s", " ", str(value)).replace("|", "\\|")
