"""What a package index shows of the package, and what its source archive holds."""

import os
import re
import subprocess
import sys
import tarfile
import tomllib
from email.parser import Parser
from pathlib import Path

import pytest
from setuptools import find_packages

import odt_plugins
from odt_plugins.cli import main as cli

TOP = Path(__file__).parents[2]
SAMPLE = (
    "tests/mesh/test_chunks.py::test_of_several_errors_the_first_is_raised_and_nothing_else_is_begun",
    "tests/pages/test_readme.py::test_the_first_page_is_short_and_begins_with_the_two_commands",
    "tests/test_structure.py::test_the_top_level_holds_what_it_shall_and_nothing_else",
)
"""Tests that need no kernels and hold those that need all of the project."""

BUILD = ("import sys, setuptools.build_meta as build;"
         "print(getattr(build, sys.argv[1])(sys.argv[2]))")


def built(hook, folder, project):
    """The name of what a hook of the build backend makes of the project."""
    done = subprocess.run([sys.executable, "-c", BUILD, hook, str(folder)], cwd=project, text=True,
                          capture_output=True, check=True)
    return folder / done.stdout.splitlines()[-1]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The source archive."""
    return built("build_sdist", tmp_path_factory.mktemp("built"), TOP)


@pytest.fixture(scope="module")
def archive(made):
    """Names in the source archive, and its metadata."""
    with tarfile.open(made) as packed:
        names = {name.partition("/")[2] for name in packed.getnames()}
        top = packed.getnames()[0].partition("/")[0]
        metadata = packed.extractfile(f"{top}/PKG-INFO").read().decode()
    return names, Parser().parsestr(metadata)


def test_the_archive_holds_what_the_project_does(archive):
    names, _ = archive
    mine = {".gitignore", "LICENSE", "README.md", "pyproject.toml", "setup.py"}
    for folder in (".ci", "examples", "odt_plugins", "tests"):
        mine |= {path.relative_to(TOP).as_posix() for path in (TOP / folder).rglob("*")
                 if path.is_file()
                 and not {"__pycache__", "kernels.so"} & {*path.relative_to(TOP).parts}}
    assert mine - names == set()
    assert not [name for name in names if "__pycache__" in name or "kernels.so" in name]


def test_tests_pass_from_the_unpacked_archive(made, tmp_path):
    with tarfile.open(made) as packed:
        packed.extractall(tmp_path, filter="data")
    top, = tmp_path.iterdir()
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *SAMPLE], cwd=top,
        env={**os.environ, "PYTHONPATH": str(top)}, text=True, capture_output=True, check=False)
    assert done.returncode == 0, done.stdout


def test_the_site_is_no_part_of_the_wheel():
    told = tomllib.loads((TOP / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    packages = find_packages(TOP, **told["packages"]["find"])
    assert "odt_plugins.cli" in packages
    assert not [name for name in packages if name.startswith("odt_plugins.pages")]
    # Otherwise what the source archive holds would come along as data.
    assert told["include-package-data"] is False


def test_the_index_is_told_what_it_asks_for(archive):
    _, metadata = archive
    assert metadata["Author"] or metadata["Author-email"]
    assert "mesh optimization" in metadata["Keywords"]
    assert any(line.startswith("Topic ::") for line in metadata.get_all("Classifier"))
    assert metadata["Version"] == odt_plugins.__version__


def test_the_first_page_needs_nothing_beside_it(archive):
    _, metadata = archive
    page = metadata.get_payload()
    targets = re.findall(r"\]\(([^)]+)\)", page)
    assert targets
    for target in targets:
        assert target.startswith(("https:", "data:image/png;base64,")), target[:80]


def test_the_citation_has_the_version_and_the_paper():
    text = (TOP / "odt_plugins" / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {odt_plugins.__version__}\n" in text
    doi = re.search(r"doi = \{(.+?)\}", (TOP / "README.md").read_text(encoding="utf-8"))[1]
    assert f"doi: {doi}" in text


def test_a_shell_completes_the_commands(monkeypatch, capsys):
    monkeypatch.setenv("_ODT_PLUGINS_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", "odt-plugins opt")
    monkeypatch.setenv("COMP_CWORD", "1")
    with pytest.raises(SystemExit):
        cli.main([])
    assert "optimize" in capsys.readouterr().out


def test_what_runs_have_compiled_is_removed_and_nothing_else(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    (tmp_path / "odt_plugins" / "stamp").mkdir(parents=True)
    (tmp_path / "odt_plugins" / "stamp" / "a.b.1.nbc").write_bytes(b"12345")
    (tmp_path / "other").write_bytes(b"1")
    assert cli.main(["cache"]) == 0
    assert "1 kernel, 0.0 MB, in " in capsys.readouterr().out
    assert cli.main(["cache", "--clear"]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["other"]
