"""The start of ``odt-plugins``, and of ``python -m odt_plugins.cli``."""

import sys

from odt_plugins.adapters import apart


def start() -> int:
    """Let another process load VTK where files need it, while this one loads all the rest."""
    apart.make_ready_for(sys.argv)
    from odt_plugins.cli.main import main

    return main()


if __name__ == "__main__":
    sys.exit(start())
