"""What the README says is run."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import click
import pytest

from odt_plugins.cli import main as cli

TOP = Path(__file__).parents[2]
TEXT = (TOP / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", TEXT, flags=re.DOTALL | re.MULTILINE)


SNIPPETS = blocks("python")
COMMANDS = [line for block in blocks("sh") for line in block.splitlines()]


def test_the_readme_has_its_four_snippets_and_its_commands() -> None:
    assert len(SNIPPETS) == 4
    assert COMMANDS[:2] == ["bash examples/demo.sh", "bash tests/run.sh"]


@pytest.mark.parametrize("code", SNIPPETS, ids=["arrays", "pytetwild", "pyvista", "generate"])
def test_a_snippet_runs_as_it_stands(code: str, tmp_path: Path) -> None:
    for name in re.findall(r"^import (\w+)", code, flags=re.MULTILINE):
        pytest.importorskip(name)
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True,
                          text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("line", [c for c in COMMANDS if c.startswith("odt-plugins")])
def test_a_command_of_the_readme_has_known_flags_and_values(line: str) -> None:
    _, name, *words = shlex.split(line)
    command = cli.cli.get_command(click.Context(cli.cli), name)
    command.make_context(name, words)


@pytest.mark.parametrize("script", ["examples/demo.sh", "tests/run.sh", "tests/environment.sh",
                                    ".ci/run"])
def test_the_scripts_are_valid_shell(script: str) -> None:
    assert (TOP / script).is_file()
    subprocess.run(["bash", "-n", script], cwd=TOP, check=True)


def test_links_lead_somewhere() -> None:
    for target in re.findall(r"\]\(([^)]+)\)", TEXT):
        assert target.startswith("https://") or (TOP / target).is_file(), target
    for name in re.findall(r"`(odt_plugins/\w+\.py)`", TEXT):
        assert (TOP / name).is_file(), name
    assert (TOP / "examples" / "bunny.png").stat().st_size < 300_000


def test_the_extras_named_exist() -> None:
    project = (TOP / "pyproject.toml").read_text(encoding="utf-8")
    for name in ("all", "pytetwild", "pymeshlab", "open3d", "plot", "demo", "test"):
        assert re.search(rf"^{name} = \[", project, flags=re.MULTILINE), name
