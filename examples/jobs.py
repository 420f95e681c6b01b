"""Runs the ten-line jobs of the gallery, draws their pictures and prints their figures.

python examples/jobs.py [NAME ...] [--folder FOLDER]

A job is a block of Python under "Whole jobs in ten lines" in examples/README.md, and its name that
of the picture above it. The block leaves the meshes `before` and `after`, and `figures`: what is
worth telling, before and after. Without a name all are run.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gallery
import numpy as np

from odt_plugins.adapters.registry import find_adapter

PAGE = Path(__file__).with_name("README.md")
SECTION = "## Whole jobs in ten lines\n"


def jobs() -> dict[str, str]:
    """The block of Python of every job, by the name of its picture."""
    section = PAGE.read_text(encoding="utf-8").partition(SECTION)[2].partition("\n## ")[0]
    return dict(re.findall(r"!\[[^\]]*\]\((\w+)\.png\).*?```python\n(.*?)```", section, re.DOTALL))


def run(code: str) -> dict[str, Any]:
    """What a block leaves; files that it writes go with their directory."""
    space: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        exec(code, space)  # the page is ours
        space["drawn"] = {when: arrays(space[when]) for when in ("before", "after")}
    return space


def arrays(mesh: Any) -> tuple[np.ndarray, np.ndarray]:
    """Points and positive cells of a mesh of any toolkit, or of a file."""
    host = find_adapter(os.fspath(mesh) if isinstance(mesh, Path) else mesh).read(mesh)
    points, cells = np.asarray(host.points, dtype=float), np.asarray(host.cells).astype(int)
    if cells.shape[1] == 4:
        turned = np.linalg.det(points[cells][:, 1:] - points[cells][:, :1]) < 0
        cells[turned] = cells[turned][:, [0, 1, 3, 2]]
    return points, cells


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the jobs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(jobs()))
    parser.add_argument("--folder", type=Path, default=Path())
    given = parser.parse_args(arguments)
    print("| job | figure | before | after |\n|---|---|---|---|")
    for name in given.names or jobs():
        done = run(jobs()[name])
        gallery.side_by_side(done["drawn"], given.folder / f"{name}.png")
        for figure, (old, new) in done["figures"].items():
            print(f"| {name} | {figure} | {old:.4g} | {new:.4g} |", flush=True)


if __name__ == "__main__":
    main()
