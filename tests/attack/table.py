"""The counts of a run as a Markdown table; one join a row is less than the call of a library."""

from __future__ import annotations

import datetime
import platform
from pathlib import Path

from odt_plugins.distributed.versions import versions_here

README = Path(__file__).parent.parent / "README.md"

MARKS = ("<!-- last run -->", "<!-- end of last run -->")


def table(
    counts: dict[str, dict[str, int]], seconds: dict[str, float], first: int, command: str
) -> list[str]:
    """Lines of the table: cases by outcome for every kind, the command, date and versions."""
    versions = ", ".join(f"{name} {version}" for name, version in versions_here().items())
    lines = ["| | cases | ok | refused | FAILED | seconds |", "|---|---|---|---|---|---|"]
    for kind, found in counts.items():
        row = [sum(found.values()), *found.values(), round(seconds[kind])]
        lines.append(f"| {kind} | " + " | ".join(map(str, row)) + " |")
    today = datetime.datetime.now(tz=datetime.UTC).date()
    return [*lines, "", f"`{command}`, first seed {first}, {today}; Python "
            f"{platform.python_version()} on {platform.machine()}, {versions}"]


def record(lines: list[str], readme: Path = README) -> None:
    """Put the table between its marks in a page."""
    before, _, rest = readme.read_text(encoding="utf-8").partition(MARKS[0])
    _, _, after = rest.partition(MARKS[1])
    parts = [before + MARKS[0], "", *lines, "", MARKS[1] + after]
    readme.write_text("\n".join(parts), encoding="utf-8")
