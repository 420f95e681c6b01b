"""The packages that decide the bits of a result: they must be the same everywhere."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping

from odt_plugins.errors import InvalidOptionError
from odt_plugins.report.machine import installed_version

PACKAGES = ("odt-plugins", "numpy", "scipy", "pyamg")


def versions_here() -> dict[str, str]:
    """Version of every package of PACKAGES in this process."""
    return {name: installed_version(name) for name in PACKAGES}


def expect_versions(
    wanted: Mapping[str, str], found: Mapping[str, str] | None = None, where: str | None = None
) -> None:
    """Refuse to work with other packages than those of the process that gave the work.

    Parameters
    ----------
    wanted : dict           versions there
    found : dict or None    versions here, by :func:`versions_here` unless given
    where : str or None     for the message; this process on this machine unless given
    """
    here = versions_here() if found is None else found
    other = [name for name in wanted if here.get(name) != wanted[name]]
    if other:
        name = other[0]
        where = where or f"the worker on {socket.gethostname()} (process {os.getpid()})"
        msg = (f"{where} has {name} {here.get(name, 'not installed')} ({len(other)} packages "
               f"differ); expected {wanted[name]} as in this process, try installing the same "
               "there")
        raise InvalidOptionError(msg)
