"""What the pages say is run: every README.md of the repository, and the changelog.

A page has fenced blocks of these kinds, by their info string:

- ``python``: run as it stands, in an empty directory;
- ``sh``: every ``odt-plugins`` command is run, the commands of a page one after the other in one
  directory that holds `in.vtu`, `vertices.txt` and `models/`; of ``bash`` commands the script is
  checked, others are not allowed;
- ``sh long``: every command is parsed by the real command line or by the parser of the script;
- ``bibtex``.
"""

from __future__ import annotations

import argparse
import re
import runpy
import shlex
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import click
import meshio
import pytest

from odt_plugins.cli import main as cli
from odt_plugins.compare.contestants import choose
from odt_plugins.compare.start import ball

TOP = Path(__file__).parents[2]
PACKAGE = TOP / "odt_plugins"
PAGES = {path.relative_to(TOP).as_posix(): path.read_text(encoding="utf-8")
         for path in (TOP / "README.md", *sorted(PACKAGE.rglob("README.md")),
                      PACKAGE / "CHANGELOG.md",
                      *sorted(TOP.glob("examples/**/README.md")),
                      *sorted(TOP.glob("tests/**/README.md")))}
FIRST = PAGES["README.md"]
KINDS = ("python", "sh", "sh long", "bibtex")
FENCE = re.compile(r"^```([^\n]*)\n(.*?)^```", flags=re.DOTALL | re.MULTILINE)


def blocks(text: str, kind: str) -> list[str]:
    return [body for info, body in FENCE.findall(text) if info == kind]


def commands(text: str, kind: str) -> list[str]:
    """Commands of a page, continued lines as one."""
    return [line for block in blocks(text, kind)
            for line in block.replace("\\\n", " ").splitlines() if line.strip()]


SNIPPETS = [pytest.param(code, id=f"{page}-{k}") for page, text in PAGES.items()
            for k, code in enumerate(blocks(text, "python"))]
LONG = [pytest.param(line, id=line[:70]) for text in PAGES.values()
        for line in commands(text, "sh long")]
RUN = [page for page, text in PAGES.items()
       if any(line.startswith("odt-plugins") for line in commands(text, "sh"))]


def parsed(line: str) -> None:
    """Parse a command of odt-plugins as click does, without running it."""
    _, name, *words = shlex.split(line)
    command = cli.cli.get_command(click.Context(cli.cli), name)
    assert command is not None, name
    given = command.make_context(name, words).params
    if name == "compare":
        choose(given["against"])


class Parsed(Exception):
    """The arguments of a script were parsed."""


def test_the_first_page_is_short_and_begins_with_the_two_commands() -> None:
    assert len(FIRST.splitlines()) <= 150
    assert commands(FIRST, "sh")[:2] == ["bash examples/demo.sh", "bash tests/run.sh"]
    assert len(blocks(FIRST, "python")) == 2
    assert len([c for c in commands(FIRST, "sh") if c.startswith("odt-plugins")]) == 5


@pytest.mark.parametrize("page", PAGES)
def test_every_block_is_of_a_known_kind(page: str) -> None:
    assert {info for info, _ in FENCE.findall(PAGES[page])} <= set(KINDS)
    assert PAGES[page].count("\n```") % 2 == 0
    for line in commands(PAGES[page], "sh"):
        program, script, *_ = shlex.split(line)
        assert program == "odt-plugins" or (program == "bash" and (TOP / script).is_file()), line


@pytest.mark.parametrize("page", PAGES)
def test_numbers_in_brackets_say_of_which_paper_they_are(page: str) -> None:
    if re.search(r"\(\d\.\d+\)|Section \d|Theorem \d|Lemma \d", PAGES[page]):
        assert "Chen" in PAGES[page]


@pytest.mark.parametrize("code", SNIPPETS)
def test_a_snippet_runs_as_it_stands(code: str, tmp_path: Path) -> None:
    for name in re.findall(r"^import (\w+)", code, flags=re.MULTILINE):
        pytest.importorskip(name)
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True,
                          text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("page", RUN)
def test_the_short_commands_of_a_page_run(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("matplotlib", "pyarrow", "jinja2"):
        pytest.importorskip(name)
    start = ball(150)
    (tmp_path / "models").mkdir()
    for name in ("in.vtu", "models/small.vtu"):
        meshio.write(tmp_path / name, meshio.Mesh(start.points, [("tetra", start.cells)]))
    (tmp_path / "vertices.txt").write_text("0\n1\n")
    monkeypatch.chdir(tmp_path)
    for line in commands(PAGES[page], "sh"):
        if line.startswith("odt-plugins"):
            assert cli.main(shlex.split(line)[1:]) == 0, line
            for name in shlex.split(line):
                if name.endswith((".vtu", ".json", ".png")) and "*" not in name:
                    assert (tmp_path / name).stat().st_size > 0, name


@pytest.mark.parametrize("line", LONG)
def test_a_long_command_is_parsed(
    line: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
) -> None:
    program, script, *words = shlex.split(line, comments=True)
    if program == "odt-plugins":
        parsed(line)
        return
    assert program == "python"
    if script == "-m":
        assert words[0] == "pytest"
        assert all((TOP / word).exists() for word in words[1:] if word.startswith("tests"))
        return
    path = TOP / script
    if path.is_dir():
        command = import_module(f"{path.name}.command").main
        command.make_context(script, words)
        return
    text = path.read_text(encoding="utf-8")
    if path.name == "figures.py":
        cut = words.index("--") if "--" in words else len(words)
        assert words[:cut]
        assert all((TOP / word).is_file() for word in words[:cut])
        parsed(shlex.join(["odt-plugins", "optimize", "in.vtu", "out.vtu", *words[cut + 1:]]))
    elif "ArgumentParser" in text:
        parse = argparse.ArgumentParser.parse_args

        def only_parse(parser: argparse.ArgumentParser, *given: object) -> None:
            raise Parsed(parse(parser, words))

        monkeypatch.setattr(argparse.ArgumentParser, "parse_args", only_parse)
        monkeypatch.setattr(sys, "argv", [script, *words])
        monkeypatch.syspath_prepend(str(path.parent))
        monkeypatch.chdir(tmp_path)
        with pytest.raises(Parsed):
            runpy.run_path(str(path), run_name="__main__")
    else:
        assert len(words) <= 2
        assert not words or "sys.argv" in text or "paper_common import" in text
        assert all(word in text for word in words if word.startswith("-"))


def test_the_gallery_draws_what_is_asked_for() -> None:
    """The names that are given to examples/gallery.py exist."""
    text = (TOP / "examples" / "gallery.py").read_text(encoding="utf-8")
    known = set(re.findall(r'"(\w+)": \w+', text.split("PICTURES:")[1].split("\n}")[0]))
    asked = {word for page in PAGES.values() for line in commands(page, "sh long")
             if "examples/gallery.py" in line
             for word in line.split("gallery.py")[1].split("--")[0].split()}
    assert asked == known


@pytest.mark.parametrize("script", ["examples/demo.sh", "tests/run.sh", "tests/environment.sh",
                                    ".ci/run"])
def test_the_scripts_are_valid_shell(script: str) -> None:
    assert (TOP / script).is_file()
    subprocess.run(["bash", "-n", script], cwd=TOP, check=True)


@pytest.mark.parametrize("page", PAGES)
def test_links_and_paths_lead_somewhere(page: str) -> None:
    folder = (TOP / page).parent
    text = FENCE.sub("", PAGES[page])
    for target in re.findall(r"\]\(([^)]+)\)", text):
        assert target.startswith("https://") or (folder / target).is_file(), target
    places = (TOP, folder, PACKAGE, PACKAGE / "engine" / "ground")
    for name in re.findall(r"`([\w./-]+(?:\.(?:py|md|sh|mlx)|/))`", text):
        made = ("demo-output/", "comparison/", "models/", "domain.py")
        assert name in made or any((place / name).exists() for place in places), name


def test_the_first_page_leads_to_all_others() -> None:
    listed = set(re.findall(r"\]\(([\w./]+\.md)\)", FIRST))
    assert listed == set(PAGES) - {"README.md"}


def test_pictures_are_small_and_on_a_page() -> None:
    shown = {((TOP / page).parent / target).resolve() for page, text in PAGES.items()
             for target in re.findall(r"!\[[^\]]*\]\(([^)]+\.png)\)", text)}
    assert shown == set((TOP / "examples").rglob("*.png"))
    for picture in shown:
        assert picture.stat().st_size < 210_000, picture.name


@pytest.mark.parametrize("page", [p for p in PAGES if p.startswith("examples/")])
def test_a_picture_of_the_gallery_stands_beside_its_command(page: str) -> None:
    for section in PAGES[page].split("\n## ")[1:]:
        drawn = " ".join([*commands(section, "sh long"), *re.findall(r"`(\S+\.png)`", section)])
        for stem in re.findall(r"!\[[^\]]*\]\((?:\S*/)?(\w+)\.png\)", section):
            assert re.search(rf"\b{stem}", drawn), stem


def test_the_recipes_name_functions_that_exist() -> None:
    text = PAGES["odt_plugins/README.md"].split("## Recipes")[1].split("\n## ")[0]
    sources = "\n".join(path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py"))
    names = set(re.findall(r"`(\w+)(?:\([^`]*\))?`", text))
    assert len(names) > 20
    for name in names - {"compare"}:
        assert re.search(rf"^(?:def |class |@?)?{name}\b[^.]", sources, flags=re.MULTILINE), name


def test_the_extras_named_exist() -> None:
    project = (TOP / "pyproject.toml").read_text(encoding="utf-8")
    version = re.search(r'^version = "(.+)"', project, flags=re.MULTILINE)
    assert version
    assert f"version = {{{version[1]}}}" in FIRST
    named = {name for text in PAGES.values()
             for extras in re.findall(r'pip install "?(?:\.|odt-plugins)\[([\w,]+)\]', text)
             for name in extras.split(",")}
    assert {"all", "compare", "dask"} <= named
    for name in named | {"pytetwild", "pymeshlab", "open3d", "plot", "demo", "test"}:
        assert re.search(rf"^{name} = \[", project, flags=re.MULTILINE), name
