"""The start of ``odt-plugins``, and of ``python -m odt_plugins.cli``."""

import sys

from odt_plugins.adapters import apart

READING = ("optimize", "quality", "untangle")
"""Commands that read the files that they are given in this process."""


def start() -> int:
    """Let another process load VTK where files need it, while this one loads all the rest."""
    command, *words = sys.argv[1:] or [""]
    if command in READING and not {"-h", "--help"} & {*words}:
        apart.make_ready_for(words)
    from odt_plugins.cli.main import main

    return main()


if __name__ == "__main__":
    sys.exit(start())
