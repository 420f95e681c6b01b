"""The docstring of every room teaches, and names only what exists."""

from __future__ import annotations

import ast
import re
from dataclasses import fields
from functools import cache
from pathlib import Path

import pytest

import odt_plugins

PACKAGE = Path(odt_plugins.__file__).parent
ROOMS = sorted(path.parent for path in PACKAGE.rglob("__init__.py") if path.parent != PACKAGE)
OPTIONS = {field.name for field in fields(odt_plugins.Options)}


@cache
def named(path: Path) -> set[str]:
    """Names of the functions, classes and constants of a module."""
    names: set[str] = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names |= {target.id for target in targets if isinstance(target, ast.Name)}
    return names


def defined(folder: Path) -> set[str]:
    """Names of all modules below a folder."""
    return set().union(*(named(path) for path in folder.rglob("*.py")))


ALL = defined(PACKAGE)


def teaching(folder: Path) -> str:
    return ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))) or ""


@pytest.mark.parametrize("folder", ROOMS, ids=lambda p: p.relative_to(PACKAGE).as_posix())
def test_a_room_names_functions_that_exist(folder):
    names = set(re.findall(r"(?<!`)`([\w.]+)`(?!`)", teaching(folder)))
    for name in names:
        if "." in name:
            path = PACKAGE.joinpath(*name.removeprefix("odt_plugins.").split("."))
            assert path.is_dir() or path.with_suffix(".py").is_file(), name
        else:
            assert name in ALL or name in OPTIONS, name
    assert len({name for name in names if name in defined(folder)}) >= 2 or not names


@pytest.mark.parametrize("folder", ROOMS, ids=lambda p: p.relative_to(PACKAGE).as_posix())
def test_a_room_tells_its_method_and_its_source(folder):
    text = teaching(folder)
    if folder.name == "baselines":
        assert text
        return
    assert 5 <= len(text.splitlines()) <= 32
    if folder.name != "promise":
        assert re.search(r"^(?:Source|References)", text, flags=re.MULTILINE)
    if re.search(r"\(\d\.\d+\)|Section \d", text):
        assert "Chen" in text
