"""Dask clusters: connecting, checking the workers, and giving them work.

Scheduling, transport, and what happens when a worker is lost are Dask's own.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from typing import Any

from odt_plugins.distributed.apply import Apply
from odt_plugins.distributed.versions import PACKAGES, expect_versions, versions_here
from odt_plugins.errors import WorkerError, expect, require

PATIENCE = 30.0
"""Seconds to wait for a scheduler, and for its first worker."""


@contextmanager
def connected(scheduler: str) -> Iterator[Any]:
    """Connect to a scheduler as a distributed.Client.

    Parameters
    ----------
    scheduler : str    address, such as tcp://host:8786

    Raises
    ------
    WorkerError        nobody answers at that address
    """
    require("a cluster", "dask", "dask", "distributed")
    from distributed import Client

    try:
        client = Client(scheduler, timeout=PATIENCE)
    except (OSError, TimeoutError, ValueError) as exc:
        msg = (f"no scheduler answers at {scheduler} ({exc}); expected the address that "
               "`dask scheduler` prints, such as tcp://host:8786")
        raise WorkerError(msg) from exc
    with _quiet(), client:
        yield client


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep what Dask says of a lost scheduler off the terminal: a sentence tells it."""
    logger = logging.getLogger("distributed.client")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)


def check_workers(client: Any) -> int:
    """Compare the packages of all workers with those of this process, before any work.

    Returns
    -------
    int                   how many workers there are

    Raises
    ------
    WorkerError           there is no worker
    InvalidOptionError    one has other packages
    """
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except TimeoutError as exc:
        msg = (f"the scheduler {client.scheduler.address} has no worker after {PATIENCE:.0f} s; "
               "try starting one with `dask worker`")
        raise WorkerError(msg) from exc
    wanted = versions_here()
    found: dict[str, dict[str, str]] = {}
    for name in PACKAGES:
        # A function of the standard library: workers without this package can tell so.
        for worker, value in client.run(version, name, on_error="return").items():
            found.setdefault(worker, {})[name] = (
                value if isinstance(value, str) else "not installed"
            )
    for worker in sorted(found):
        expect_versions(wanted, found[worker], f"the worker {worker}")
    return len(found)


def on_cluster(client: Any) -> Apply:
    """Give what applies a function to items on the workers, after :func:`check_workers`.

    Raises
    ------
    InvalidOptionError, WorkerError
    """
    require("a cluster", "dask", "dask", "distributed")
    expect(hasattr(client, "wait_for_workers"), "client", client, "a distributed.Client")
    check_workers(client)

    def apply(function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
        futures = submit(client, function, items)
        try:
            while futures:
                yield _result(client, futures.pop(0))
        finally:
            for future in futures:
                future.cancel()

    return apply


def submit(client: Any, function: Callable[[Any], Any], items: Iterable[Any]) -> list[Any]:
    """Give the work for every item to the cluster: one future each.

    The items travel with the tasks, so that Dask can repeat one on another worker.
    """
    import dask

    with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 TB"}):
        return [client.submit(function, item, pure=False) for item in items]


def _result(client: Any, future: Any) -> Any:
    """Wait for the result of a future, for as long as some worker may work on it."""
    from distributed import CancelledError, KilledWorker, TimeoutError

    paused = False
    while True:
        try:
            return future.result(timeout=PATIENCE)
        except TimeoutError:
            if future.done():
                raise
            was, paused = paused, _all_paused(client)
            if was and paused:
                msg = ("all workers of the cluster are paused, more of their memory is in use than "
                       "Dask allows; try more memory for them, or more blocks")
                raise WorkerError(msg) from None
        except (KilledWorker, CancelledError, OSError) as exc:
            raise WorkerError(_lost(client, exc)) from exc


def _all_paused(client: Any) -> bool:
    """Whether no worker does anything, for want of memory."""
    workers = client.scheduler_info(n_workers=-1)["workers"].values()
    paused = bool(workers) and all(worker["status"] == "paused" for worker in workers)
    return paused and not any(client.call_stack().values())


def _lost(client: Any, exc: BaseException) -> str:
    """Say why there is no result of a future."""
    if client.status != "running":
        return (f"the connection to the scheduler {client.scheduler.address} was lost; expected it "
                "to be there until the end, try the run again")
    return (f"the cluster lost the work ({type(exc).__name__}: {exc}); try more memory for its "
            "workers, or more blocks")


def as_they_finish(
    client: Any, function: Callable[[Any], Any], items: Iterable[Any]
) -> Iterator[tuple[int, Any]]:
    """Apply a function to items on the workers.

    Yields
    ------
    index, result    in the order in which they finish; an exception in the place of a result
    """
    from distributed import as_completed

    futures = submit(client, function, items)
    place = {future.key: index for index, future in enumerate(futures)}
    try:
        for future in as_completed(futures):
            error = future.exception()
            yield place[future.key], future.result() if error is None else error
    finally:
        for future in futures:
            if not future.done():
                future.cancel()
