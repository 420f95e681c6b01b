"""Where blocks are worked on: in this process, in processes of this machine, or on a cluster."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.pool import Pool
from multiprocessing.process import BaseProcess
from multiprocessing.synchronize import Event
from typing import Any

from odt_plugins.distributed.apply import Apply
from odt_plugins.errors import WorkerError
from odt_plugins.processes import handling

LOOKED = 0.2
"""Seconds between two looks at whether the parent of a process is there."""

NOT_BEGUN = ("worker processes ended while they imported the script of this one; expected a script "
             'whose work stands under `if __name__ == "__main__":`, try that or workers=0')
"""What is said where no process came as far as its work."""


def end_with(parent: int, begun: Event) -> None:
    """Tell that this process has begun, and let it end once its parent is gone."""
    begun.set()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(LOOKED)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _begun(started: set[BaseProcess]) -> Iterator[None]:
    """Let processes that begin meanwhile leave Ctrl-C to this one, and add them."""
    others = set(multiprocessing.active_children())
    with handling(signal.SIGINT, signal.SIG_IGN):
        yield
    started |= set(multiprocessing.active_children()) - others


@contextmanager
def pool_of(workers: int) -> Iterator[Pool]:
    """Give processes that leave Ctrl-C to this one, and end with it and with the context.

    Raises
    ------
    WorkerError    all of them ended before they began
    """
    context = multiprocessing.get_context("spawn")
    begun, started = context.Event(), set[BaseProcess]()
    with _begun(started):
        pool = context.Pool(workers, end_with, (os.getpid(), begun))
    with pool:
        while not begun.wait(LOOKED):
            if all(process.exitcode is not None for process in started):
                raise WorkerError(NOT_BEGUN)
        yield pool


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
        context = multiprocessing.get_context("spawn")
        begun, started = context.Event(), set[BaseProcess]()
        pool = ProcessPoolExecutor(workers, context, end_with, (os.getpid(), begun))

        def apply(function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
            with _begun(started):
                return pool.map(function, items)

        try:
            yield apply
        except BrokenProcessPool as exc:
            msg = ("a worker process ended before its work did; expected enough memory for "
                   f"{workers} blocks at a time, try fewer workers or more blocks")
            raise WorkerError(msg if begun.is_set() else NOT_BEGUN) from exc
        except BaseException:
            for process in started:
                process.terminate()
            raise
        finally:
            pool.shutdown(cancel_futures=True)
    else:
        yield map
