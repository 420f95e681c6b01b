"""What decides the result of an input of a batch, as one name."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from odt_plugins.distributed.named import MASKS
from odt_plugins.distributed.versions import versions_here
from odt_plugins.report.machine import installed_version

OF_FILES = ("reference", *MASKS)
"""Options that may be the path of a file."""

BESIDE = {".xdmf": (".h5",), ".xmf": (".h5",), ".mesh": (".sol", ".solb"),
          ".meshb": (".solb", ".sol"), ".ele": (".node", ".face", ".edge"),
          ".node": (".ele", ".face", ".edge")}
"""Suffixes of files that are read beside one of a suffix, where they are there."""


def placed(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options whose paths of files do not depend on the working directory."""
    return {name: os.path.abspath(value) if _is_path(name, value) else value
            for name, value in options.items()}


def job_key(job: Any) -> str:
    """Name what decides a result: the bytes of the files read, the options, and the versions.

    Parameters
    ----------
    job : Job    of :mod:`..batch`
    """
    source = Path(job.source)
    beside = [source.with_suffix(suffix) for suffix in BESIDE.get(source.suffix.lower(), ())]
    digest = hashlib.sha256()
    _add(digest, [source, *(path for path in beside if path.is_file())])
    options = {name: value for name, value in job.options.items() if name != "threads"}
    for name in OF_FILES:
        if _is_path(name, value := options.get(name)):
            options[name] = _add(hashlib.sha256(), [Path(str(value))])
    versions = versions_here()
    if job.tetrahedralize:
        versions["pytetwild"] = installed_version("pytetwild")
    rest = [options, job.name, job.tetrahedralize, job.edge_length, job.levels, job.sizes, versions]
    digest.update(json.dumps(rest, sort_keys=True).encode())
    return digest.hexdigest()


def _is_path(name: str, value: Any) -> bool:
    return name in OF_FILES and isinstance(value, str) and os.path.isfile(value)


def _add(digest: Any, paths: Iterable[Path]) -> str:
    """Take the bytes of files into a digest."""
    for path in paths:
        with path.open("rb") as file:
            while chunk := file.read(1 << 20):
                digest.update(chunk)
    return str(digest.hexdigest())
