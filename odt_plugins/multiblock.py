"""Optimise the blocks of a pyvista.MultiBlock one by one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from odt_plugins.adapters import pyvista_blocks
from odt_plugins.errors import InvalidOptionError, ODTError
from odt_plugins.progress import part, telling


def run_blocks(
    mesh: Any, options: Mapping[str, Any], one: Callable[..., tuple[Any, Any]]
) -> tuple[Any, list[Any]]:
    """Optimise every block of a pyvista.MultiBlock by itself.

    Parameters
    ----------
    mesh : pyvista.MultiBlock
    options : dict
    one : callable     optimises a block with options: its result and report

    Returns
    -------
    result : pyvista.MultiBlock
    reports : list     of every block that was optimised

    Raises
    ------
    InvalidOptionError    boundaries shall slide where blocks touch
    ODTError              what one block raises, with its name
    """
    names = pyvista_blocks.chosen(mesh)
    blocks = [pyvista_blocks.block_at(mesh, path) for path in names]
    if options.get("boundary") == "slide" and pyvista_blocks.touching(blocks):
        msg = ("got boundary='slide' for blocks that touch, which would come apart; expected "
               "'fixed', try mesh.combine(merge_points=True) with an array of labels")
        raise InvalidOptionError(msg)
    results, reports = [], []
    with telling(options.get("progress"), "preparing") as progress:
        for i, (name, block) in enumerate(zip(names.values(), blocks, strict=True)):
            share = part(progress, i / len(blocks), (i + 1) / len(blocks))
            told = {"progress": share} if options.get("progress") else {}
            try:
                result, report = one(block, **{**options, **told})
            except ODTError as exc:
                msg = f"block {name!r}: {exc}"
                raise type(exc)(msg) from exc
            results.append(result)
            reports.append(report)
    return pyvista_blocks.replaced(mesh, dict(zip(names, results, strict=True))), reports
