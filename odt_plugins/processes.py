"""Processes and signals, also on systems that have no groups of processes and no limits on them."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import Any

from odt_plugins.errors import InvalidOptionError

GROUP: dict[str, Any] = (
    {"start_new_session": True} if hasattr(os, "setsid")
    else {"creationflags": getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)})
"""Keywords of :class:`subprocess.Popen` for a process that :func:`end_group` ends with all that it
started."""

ENDED = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGKILL") if hasattr(signal, name))
"""Signals that come from the user or from a system short of memory."""


@contextmanager
def handling(
    number: signal.Signals, handler: Callable[[int, FrameType | None], Any] | signal.Handlers
) -> Iterator[None]:
    """Answer a signal so; where that is not possible, outside the main thread, as before."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    old = signal.signal(number, handler)
    try:
        yield
    finally:
        signal.signal(number, old)


@contextmanager
def held_back(number: signal.Signals) -> Iterator[None]:
    """Let a signal wait for the end of this, as of changes that are nothing by halves."""
    came: list[int] = []
    with handling(number, lambda number, _: came.append(number)):
        yield
    if came:
        signal.raise_signal(number)


def end_group(process: subprocess.Popen[Any]) -> None:
    """End a process that was started with GROUP, with everything it started, and wait for that."""
    with contextlib.suppress(OSError):
        _end_all(process.pid)
    process.wait()


def end_own_group() -> None:
    """End this process, which was started with GROUP, with everything it started."""
    with contextlib.suppress(OSError):
        _end_all(os.getpid())
    os._exit(1)


def _end_all(pid: int) -> None:
    """End a process with everything it started."""
    if hasattr(os, "killpg"):
        os.killpg(pid, signal.SIGKILL)
    elif tool := shutil.which("taskkill"):
        subprocess.run([tool, "/F", "/T", "/PID", str(pid)], check=False, capture_output=True)
    else:
        os.kill(pid, signal.SIGTERM)


def is_gone(pid: int) -> bool:
    """Whether a process is known to have ended; where a system cannot tell, it has not."""
    # Without killpg a signal of number 0 ends the process that it only asks for elsewhere.
    if not hasattr(os, "killpg"):
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    except OSError:
        return False
    return False


def limit_memory(most: int) -> None:
    """Let the system refuse this process more private memory than so many bytes.

    Raises
    ------
    InvalidOptionError    the system has no such limit
    """
    expect_limits()
    import resource

    resource.setrlimit(resource.RLIMIT_DATA, (most, most))


def expect_limits() -> None:
    """Refuse limits of memory on a system that has none."""
    if find_spec("resource") is None:
        msg = "got a limit of memory, which this system cannot set; try it without one"
        raise InvalidOptionError(msg)


def cpu_seconds() -> float:
    """Processor time of this process and of the programs that it ran to their end."""
    ended = os.times()
    return time.process_time() + ended.children_user + ended.children_system


def peak_memory() -> int:
    """Bytes, the largest resident size of this process so far; 0 where the system keeps none.

    Linux's ru_maxrss begins with the size of the process that started this one; VmHWM does not.
    """
    if sys.platform == "linux":
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    if find_spec("resource") is None:
        return 0
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
