"""The start of ``odt-plugins``, and of ``python -m odt_plugins``."""

import gc
import io
import os
import sys

from odt_plugins.adapters import apart

READING = ("optimize", "quality", "untangle")
"""Commands that read the files that they are given in this process."""

RARELY = 50_000
"""Objects of Python that are made between two looks for garbage."""


def ready_streams() -> None:
    """Make the standard streams fit for any text.

    Closed ones are opened, so that no file takes their numbers; characters that the encoding of the
    output lacks, as that of Windows does, are told by number.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.open(os.devnull, os.O_RDWR), mode, encoding="utf-8"))
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def start() -> int:
    """Let another process load VTK where files need it, while this one loads all the rest.

    Nearly all that a command makes stays to its end, so that garbage is looked for rarely, and at
    the exit once.  This is for a process of its own; :func:`main` changes nothing of that.
    """
    ready_streams()
    gc.set_threshold(RARELY)
    command, *words = sys.argv[1:] or [""]
    try:
        if command in READING and not {"-h", "--help"} & {*words}:
            apart.make_ready_for(words)
        from odt_plugins.cli.main import main

        return main()
    except KeyboardInterrupt:
        sys.exit("odt-plugins: stopped before it began")
    finally:
        gc.collect()
        gc.freeze()


if __name__ == "__main__":
    sys.exit(start())
