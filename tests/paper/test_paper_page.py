"""The table from the paper to the code: every name exists, and its docstring has the numbers."""

from __future__ import annotations

import importlib
import inspect
import re
from pathlib import Path

import pytest

TOP = Path(__file__).parents[2]


def table(path, heading=""):
    """Rows of the tables of a page, or of the section of a page below a heading."""
    text = (TOP / path).read_text(encoding="utf-8")
    if heading:
        text = text.split(f"## {heading}\n")[1].split("\n## ")[0]
    return [re.findall(r"[^|]+", line) for line in text.splitlines() if line.startswith("| ")]


CODE = [row for row in table("odt_plugins/engine/README.md", "From the paper to the code")
        if len(row) == 3 and "`" in row[2]]
SCRIPTS = [row for row in table("examples/paper/README.md") if len(row) == 2 and "`" in row[0]]


def found(name):
    """The object of a dotted name under odt_plugins."""
    parts = name.split(".")
    for k in range(len(parts) - 1, 0, -1):
        try:
            value = importlib.import_module(".".join(["odt_plugins", *parts[:k]]))
        except ModuleNotFoundError:
            continue
        for part in parts[k:]:
            value = inspect.getattr_static(value, part)
        return getattr(value, "func", value)
    raise AssertionError(name)


def documented(text, number):
    """Whether a docstring has the number; (4.2) is not (4.20), Section 5 not Section 5.2."""
    bare = re.sub(r"\s+", " ", text)
    return re.search(re.escape(number) + r"(?!\.?\d)", bare) is not None


@pytest.mark.parametrize("row", CODE, ids=lambda row: row[0].strip())
def test_a_row_names_functions_that_have_its_numbers(row):
    numbers = [n.strip() for n in row[0].split(",")]
    docs = {name: inspect.getdoc(found(name)) for name in re.findall(r"`([\w.]+)`", row[2])}
    assert docs
    for name, doc in docs.items():
        assert doc, name
        assert any(documented(doc, n) for n in numbers), name
    for number in numbers:
        assert any(documented(doc, number) for doc in docs.values()), number


def test_the_page_has_the_numbered_formulas_of_section_4():
    listed = set(re.findall(r"\(4\.(\d+)\)", " ".join(row[0] for row in CODE)))
    assert {str(k) for k in range(1, 32)} - listed == {"16"}


@pytest.mark.parametrize("row", SCRIPTS, ids=lambda row: row[0].strip())
def test_a_script_exists_and_says_what_it_shows(row):
    path, = re.findall(r"`([\w./]+)`", row[0])
    shown = row[1].split(",")[0].strip()
    assert (TOP / path).read_text(encoding="utf-8").startswith('"""' + shown), path


def test_every_script_is_on_the_page():
    here = {f"examples/paper/{p.name}" for p in (TOP / "examples" / "paper").glob("*.py")}
    assert here - {"examples/paper/paper_common.py"} == {
        re.findall(r"`([\w./]+)`", row[0])[0] for row in SCRIPTS}
