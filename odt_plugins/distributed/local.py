"""Where blocks are worked on: in this process, in processes of this machine, or on a cluster."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any

from odt_plugins.distributed.apply import Apply
from odt_plugins.errors import WorkerError


@contextmanager
def executor(client: Any = None, workers: int = 0) -> Iterator[Apply]:
    """Give what applies a function to items.

    Parameters
    ----------
    client : distributed.Client or None    work on its cluster
    workers : int                          else in so many processes; 0 in this one

    Raises
    ------
    InvalidOptionError    a worker of the cluster has other packages than this process
    WorkerError           workers were lost
    """
    if client is not None:
        from odt_plugins.distributed.cluster import on_cluster

        yield on_cluster(client)
    elif workers:
        pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"))
        try:
            yield pool.map
        except BrokenProcessPool as exc:
            msg = ("a worker process ended before its work did; expected enough memory for "
                   f"{workers} blocks at a time, try fewer workers or more blocks")
            raise WorkerError(msg) from exc
        finally:
            pool.shutdown(cancel_futures=True)
    else:
        yield map
