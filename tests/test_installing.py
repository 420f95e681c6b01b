"""What the scripts tell uv of pip, and what they do without uv."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

TOP = Path(__file__).parents[1]

PYTHON = r"""#!/usr/bin/env bash
case "$*" in
    "-m pip config list") cat "$CONFIG" ;;
    "-m pip install"*" uv") exit "$WITHOUT" ;;
    "-m uv "*) env | grep '^UV_' | sort; echo "uv ${*:3}"; exit "$FAILS" ;;
    *) echo "pip ${*:3}" ;;
esac
"""


def installed(tmp_path: Path, config: str = "", without: int = 0, fails: int = 0) -> list[str]:
    """Lines that installing prints, where a stub stands for Python."""
    (tmp_path / "python").write_text(PYTHON)
    (tmp_path / "python").chmod(0o755)
    (tmp_path / "config").write_text(config)
    told = {name: value for name, value in os.environ.items() if not name.startswith("UV_")}
    done = subprocess.run(
        ["bash", "-c", ". tests/environment.sh; install_package demo"], cwd=TOP, check=True,
        capture_output=True, text=True, env=told | {
            "PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}", "VIRTUAL_ENV": str(tmp_path),
            "CONFIG": str(tmp_path / "config"), "WITHOUT": str(without), "FAILS": str(fails)})
    return [line for line in done.stdout.splitlines() if not line.startswith("pip  ")]


def test_uv_takes_packages_from_where_pip_would(tmp_path: Path) -> None:
    lines = installed(tmp_path, (
        ":env:.find-links='/one /two'\nglobal.find-links='/three'\nglobal.constraint='/limits'\n"
        "global.index-url='https://a.example/simple'\nglobal.timeout='9'\n"
        "global.extra-index-url='\\nhttps://b.example\\nhttps://c.example'\n"))
    assert lines[-6:] == [
        "UV_CONSTRAINT=/limits", "UV_DEFAULT_INDEX=https://a.example/simple",
        "UV_FIND_LINKS=/one,/two", "UV_INDEX= https://b.example https://c.example",
        "UV_INDEX_STRATEGY=unsafe-best-match", "uv pip install --quiet -e .[demo]"]


@pytest.mark.parametrize("way", [{"without": 1}, {"fails": 2}])
def test_pip_installs_where_uv_does_not(way: dict[str, int], tmp_path: Path) -> None:
    assert installed(tmp_path, **way)[-1] == (
        "pip install --quiet --disable-pip-version-check -e .[demo]")
