"""Where blocks are worked on: in this process, in processes of this machine, or on a cluster."""

from __future__ import annotations

import multiprocessing
import os
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any

from odt_plugins.distributed.apply import Apply
from odt_plugins.errors import WorkerError

LOOKED = 0.2
"""Seconds between two looks at whether the parent of a process is there."""


def end_with(parent: int) -> None:
    """Let this process end once its parent is gone, whatever it does then."""
    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(LOOKED)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


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
        pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"),
                                   end_with, (os.getpid(),))
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
