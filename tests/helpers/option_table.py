"""The table of options on the page, one f-string a row, which is less than the call of a library.

The table is made of the fields of Options.

Run this file to write the table to the page anew.
"""

from __future__ import annotations

from pathlib import Path

import odt_plugins
from odt_plugins.options import OPTIONS, meaning

PAGE = Path(odt_plugins.__file__).parent / "README.md"
START, END = "<!-- options: start -->\n", "<!-- options: end -->\n"


def table() -> str:
    """Markdown table of all options."""
    rows = ["| Option | Default | Choices | Meaning |", "| --- | --- | --- | --- |"]
    for name, about in OPTIONS.items():
        choices = ", ".join(f"`{choice}`" for choice in about.metadata["choices"])
        rows.append(f"| `{name}` | `{about.default!r}` | {choices} | {meaning(name)} |")
    return "\n".join(rows) + "\n"


def on_page(page: str) -> str:
    """The table that stands on a page between the two marks."""
    return page.partition(START)[2].partition(END)[0]


def main() -> None:
    """Write the table to the page."""
    page = PAGE.read_text(encoding="utf-8")
    before, _, rest = page.partition(START)
    PAGE.write_text(before + START + table() + END + rest.partition(END)[2], encoding="utf-8")


if __name__ == "__main__":
    main()
