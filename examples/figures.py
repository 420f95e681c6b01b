"""Runs ``odt-plugins optimize`` on mesh files and prints one table of figures for all of them.

python examples/figures.py MESH... [-- OPTIONS of odt-plugins optimize]
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

from odt_plugins.cli.main import main as command

HEADER = (
    "| start | | mean q | 1 % | min q | angles | < 10° | < 20° | AMIPS | step | "
    "vertices | seconds |\n|---|---|---|---|---|---|---|---|---|---|---|---|"
)


def row(name: str, when: str, figures: dict[str, Any], step: str, seconds: str) -> str:
    """One line of the table."""
    return (
        f"| {name} | {when} | {figures['mean_quality']:.4f} | {figures['p1_quality']:.3f} | "
        f"{figures['min_quality']:.3f} | {figures['min_angle']:.1f}..{figures['max_angle']:.1f} | "
        f"{figures['below_10']} | {figures['below_20']} | "
        f"{figures['mean_amips']:.3f}, {figures['max_amips']:.2f} | "
        f"{step} | {figures['n_points']} | {seconds} |"
    )


def measure(path: Path, options: list[str]) -> tuple[dict[str, Any], float]:
    """Report of one run of the command, and its wall time without Python's start."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / path.name
        report = Path(folder) / "report.json"
        start = time.perf_counter()
        code = command(["optimize", str(path), str(output), *options, "--report", str(report),
                        "--quiet"])
        seconds = time.perf_counter() - start
        if code != 0:
            sys.exit(code)
        return json.loads(report.read_text()), seconds


def main(arguments: list[str]) -> None:
    """Measure every mesh, the first one twice so that compilation is not counted."""
    cut = arguments.index("--") if "--" in arguments else len(arguments)
    paths, options = [Path(a) for a in arguments[:cut]], arguments[cut + 1 :]
    if {"-h", "--help"} & set(options):
        sys.exit(command(["optimize", "--help"]))
    if not paths or {"-h", "--help"} & set(arguments):
        sys.exit("usage: python examples/figures.py MESH... [-- OPTIONS of odt-plugins optimize]")
    print(HEADER)
    gains = []
    for path in paths:
        measure(path, [*options, "--smoothing", "rounds=1"])
        report, seconds = measure(path, options)
        before, after = report["before"], report["after"]
        gains.append(after["min_altitude"] / before["min_altitude"])
        print(row(path.stem, "before", before, f"{before['min_altitude']:.3g}", ""))
        print(row(path.stem, "after", after, f"x {gains[-1]:.2f}", f"{seconds:.1f}"))
    print(f"\nstable time step (least altitude over wave speed): median x {median(gains):.2f}, "
          f"least x {min(gains):.2f}")


if __name__ == "__main__":
    main(sys.argv[1:])
