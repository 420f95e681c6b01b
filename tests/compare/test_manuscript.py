"""LaTeX and BibTeX of the comparison: what a paper takes over as it stands."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import pytest
from contestants import in_this_process

from odt_plugins.compare.contestants import CONTESTANTS, OURS, choose
from odt_plugins.compare.manuscript import settings_table, to_bibtex, to_latex, to_markdown
from odt_plugins.compare.rows import compare_on, mark
from odt_plugins.compare.runner import Limits
from odt_plugins.compare.start import ball
from odt_plugins.report.template import tex

FACTS = {"processor": "A&B 100%", "threads": 1, "seed": 2, "date": "today"}


@pytest.fixture(scope="module")
def result():
    start = replace(ball(60), name="a_b|c&50%", origin="some/path_{x}.vtu")
    with in_this_process():
        return compare_on(start, choose(["laplacian", "CGAL odt", "pymeshlab"]), Limits(60.0, 1))


@pytest.fixture(scope="module")
def latex(result):
    return to_latex([result], FACTS, "odt-plugins compare 'a b_c'")


def tabulars(text):
    return re.findall(r"\\begin\{tabular\}\{([^\n]*)\}\n(.*?)\\end\{tabular\}", text, re.DOTALL)


def columns(layout):
    return len(re.findall(r"[lr]|p\{[^}]*\}", layout))


def bare(text):
    """LaTeX without comments and escaped signs."""
    lines = [re.sub(r"(?<!\\)%.*", "", line) for line in text.splitlines()]
    return re.sub(r"\\[&%$#_{}\\]", "", "\n".join(lines))


def test_tables_of_latex_are_of_booktabs_and_complete(latex, result):
    found = tabulars(latex)
    assert len(found) == 3
    for layout, body in found:
        assert body.index(r"\toprule") < body.index(r"\midrule") < body.index(r"\bottomrule")
        assert "hline" not in body
        rows = [row for row in body.splitlines() if row.endswith(r"\\")]
        for row in rows:
            spans = sum(int(n) - 1 for n in re.findall(r"\\multicolumn\{(\d+)\}", row))
            assert bare(row).count("&") + 1 + spans == columns(layout), row
    assert len([r for r in found[0][1].splitlines() if r.endswith(r"\\")]) == len(result.rows) + 2
    assert rf"\textbf{{{OURS}}}~\cite{{{OURS},ChenHolst2011}}" in latex


def test_latex_is_escaped(latex):
    text = bare(latex)
    assert r"a\_b|c\&50\%" in latex
    assert r"some/path\_\{x\}.vtu" in latex
    assert text.count("{") == text.count("}")
    assert text.count("$") % 2 == 0
    assert text.count(r"\begin{") == text.count(r"\end{")
    for line in text.splitlines():
        outside = re.sub(r"\$[^$]*\$", "", line)
        assert not re.search(r"[_^#~<>\"]", outside.replace("~\\cite", "")), line
    assert latex.isascii()
    assert tex("\\~^50% of {a_b}\nand 20°, ▲ △") == (
        r"\textbackslash{}\textasciitilde{}\textasciicircum{}50\% of \{a\_b\} and 20$^\circ$, "
        r"$^{\ast}$ $^{\dagger}$")


def test_every_key_that_is_cited_has_an_entry(latex, result):
    entries = to_bibtex([result])
    keys = re.findall(r"^@\w+\{([^,]+),$", entries, re.MULTILINE)
    cited = ",".join(re.findall(r"\\cite\{([^}]+)\}", latex)).split(",")
    assert sorted(keys) == sorted(set(cited))
    assert "netgen" not in keys


def test_entries_of_bibtex_are_whole(result):
    rows = [replace(result.rows[0], family=family, version="1.2")
            for family in dict.fromkeys(c.family for c in CONTESTANTS)]
    entries = to_bibtex([replace(result, rows=rows)]).split("@")[1:]
    assert len(entries) == len({c.family for c in CONTESTANTS}) + 1
    for entry in entries:
        assert entry.count("{") == entry.count("}")
        assert {"author", "title", "year"} <= set(re.findall(r"(\w+) = ", entry))
        assert "doi" in entry or "url" in entry or "odt-plugins," in entry
        assert ("Version 1.2" in entry) != entry.startswith(("article{laplac", "article{ChenH"))
        lines = entry.strip().splitlines()
        assert lines[-1] == "}"
        assert all(line.startswith("  ") and line.endswith(",") for line in lines[1:-2])


def test_settings_of_every_tool_that_ran_are_told(result):
    table = settings_table([result])
    told = {row[0]: json.loads(row[2]) for row in table.rows}
    assert told == {row.contestant: row.settings for row in result.rows if row.settings}
    assert told["Laplacian"] == {"iterations": 10, "smart": False}
    assert "MeshLab" not in told
    other = replace(result.rows[1], settings={"iterations": 5})
    rows = settings_table([result, result, replace(result, rows=[other])]).rows
    assert len(rows) == len(table.rows) + 1


def test_a_field_of_markdown_cannot_end_its_column(result):
    text = to_markdown([replace(result, rows=mark(result.rows))], FACTS, "the command")
    assert r"a_b\|c&50% (" in text
    for block in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in block.splitlines()}) == 1
