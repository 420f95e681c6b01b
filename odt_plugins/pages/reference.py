"""What the package offers, as pages that Sphinx fills: public names and commands."""

from __future__ import annotations

import inspect

import click

import odt_plugins

SECTIONS: dict[str, tuple[str, ...]] = {
    "Improve": ("optimize", "optimize_with_report", "untangle", "untangle_with_report", "quality"),
    "Give other sizes": ("remesh", "remesh_with_report", "refine", "refine_with_report",
                         "metric_from_field"),
    "Fill a surface": ("tetrahedralize", "tetrahedralize_with_report"),
    "Inside of toolkits": ("register", "run_filter_script"),
    "What is told": ("Report", "QualitySummary", "Options"),
}
"""Public names in the order of the page; others, errors and warnings follow."""


def python_page() -> str:
    """Every public name with its docstring, in reStructuredText."""
    lines = [*_heading("Python", "="), ".. currentmodule:: odt_plugins", ""]
    for title, names in SECTIONS.items():
        lines += _heading(title, "-")
        for name in names:
            lines += _entry(name)
    known = {name for names in SECTIONS.values() for name in names}
    left = [name for name in odt_plugins.__all__ if name not in known and name != "__version__"]
    for title, raised in (("Besides", False), ("Errors and warnings", True)):
        some = [name for name in left if _is_raised(getattr(odt_plugins, name)) == raised]
        lines += _heading(title, "-") if some else []
        for name in some:
            lines += _entry(name)
    return "\n".join(lines)


def commands_page(root: click.Group) -> str:
    """Every command with what its ``--help`` says, in reStructuredText."""
    lines = _heading("Commands", "=")
    whole = click.Context(root, info_name="odt-plugins")
    for name in root.list_commands(whole):
        command = root.get_command(whole, name)
        if command is None or command.hidden:
            continue
        context = click.Context(command, info_name=f"odt-plugins {name}", max_content_width=100)
        lines += [*_heading(f"odt-plugins {name}", "-"), ".. code-block:: text", ""]
        lines += [f"   {line}" if line else "" for line in command.get_help(context).split("\n")]
        lines.append("")
    return "\n".join(lines)


def _is_raised(found: object) -> bool:
    return inspect.isclass(found) and issubclass(found, BaseException)


def _heading(title: str, line: str) -> list[str]:
    return [title, line * len(title), ""]


def _entry(name: str) -> list[str]:
    found = getattr(odt_plugins, name)
    if not inspect.isclass(found):
        return [f".. autofunction:: {name}", ""]
    return [f".. autoclass:: {name}", "   :members:", "   :no-undoc-members:", ""]
