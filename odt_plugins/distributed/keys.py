"""What decides the result of an input of a batch, as one name."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from odt_plugins.adapters.files import chosen_format
from odt_plugins.adapters.stated import parts_of
from odt_plugins.distributed.job import WRITTEN
from odt_plugins.distributed.named import MASKS
from odt_plugins.distributed.versions import versions_here
from odt_plugins.errors import MeshFileError, MissingDependencyError
from odt_plugins.report.machine import installed_version

OF_FILES = ("reference", *MASKS)
"""Options that may be the path of a file."""

BESIDE = {".mesh": (".sol", ".solb"), ".meshb": (".solb", ".sol"),
          ".ele": (".node", ".face", ".edge"), ".node": (".ele", ".face", ".edge")}
"""Suffixes of files that are read beside one of a suffix, where they are there."""

REFERRING = {".inp": "abaqus", ".bdf": "nastran", ".fem": "nastran", ".nas": "nastran",
             ".dat": "nastran", ".xdmf": "xdmf", ".xmf": "xdmf"}
"""Formats of suffixes of files that name others, which are read with them."""


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
    digest = hashlib.sha256()
    _add(digest, _read_with(Path(job.source)))
    options = {name: value for name, value in job.options.items() if name != "threads"}
    for name in OF_FILES:
        if _is_path(name, value := options.get(name)):
            options[name] = _add(hashlib.sha256(), _read_with(Path(str(value))))
    versions = versions_here()
    if job.tetrahedralize:
        versions["pytetwild"] = installed_version("pytetwild")
    rest = [options, job.name, job.tetrahedralize, job.edge_length, job.levels, job.sizes, versions]
    digest.update(json.dumps(rest, sort_keys=True).encode())
    return digest.hexdigest()


def drop_earlier(place: Path, target: Path, row: Mapping[str, Any]) -> None:
    """Take away the row of an earlier run, and what it wrote beside a result that is replaced.

    Parameters
    ----------
    place : path      of the row, which need not be there
    target : path     of the result
    row : dict        of this run, with what it writes, and whether it does
    """
    files = row["files"] if row["status"] in WRITTEN else ()
    try:
        earlier = json.loads(place.read_text(encoding="utf-8")).get("files", []) if files else []
    except (OSError, ValueError):
        earlier = []
    place.unlink(missing_ok=True)
    for name in {*earlier} - {*files}:
        if Path(name).stem == target.stem:
            (target.parent / name).unlink(missing_ok=True)


def read_alone(paths: list[str]) -> list[str]:
    """Leave out files that are read with another one of them, and are no meshes by their suffix."""
    others = {os.path.abspath(path) for path in paths if not _may_be_mesh(path)}
    if others:
        others &= {os.path.abspath(other) for path in paths
                   if _may_be_mesh(path) and os.access(path, os.R_OK)
                   for other in _read_with(Path(path))}
    return [path for path in paths if os.path.abspath(path) not in others]


def _may_be_mesh(path: str) -> bool:
    """Whether a suffix is one of mesh files."""
    try:
        chosen_format(Path(path))
    except MeshFileError:
        return False
    except MissingDependencyError:
        pass
    return True


def _read_with(path: Path) -> list[Path]:
    """A file, those beside it, and those that it includes, which are read with it."""
    suffix = path.suffix.lower()
    name = REFERRING.get(suffix)
    beside = [path.with_suffix(other) for other in BESIDE.get(suffix, ())]
    return [*(parts_of(path, name) if name else [path]),
            *(other for other in beside if other.is_file())]


def _is_path(name: str, value: Any) -> bool:
    return name in OF_FILES and isinstance(value, str) and os.path.isfile(value)


def _add(digest: Any, paths: Iterable[Path]) -> str:
    """Take the bytes of files into a digest."""
    for path in paths:
        with path.open("rb") as file:
            while chunk := file.read(1 << 20):
                digest.update(chunk)
    return str(digest.hexdigest())
