"""A process that works off cases, so that a hang or a crash is the end of a case and no more."""

from __future__ import annotations

import contextlib
import faulthandler
import importlib
import io
import multiprocessing
import os
import resource
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from odt_plugins.errors import ODTError, ODTWarning, exit_name

OK, REFUSED, FAILED = "ok", "refused", "FAILED"

MEMORY = 8 << 30
"""Bytes that a case may take."""

COMPILING = 900.0
"""Seconds that no case may take, the kernels it compiles included."""


class Verdict(NamedTuple):
    """What became of a case: OK, REFUSED or FAILED, a sentence, and what a replay shows."""

    outcome: str
    sentence: str = ""
    details: str = ""


def judge(module: str, seed: int) -> Verdict:
    """Do one case here; its files are in a folder of its own that is removed."""
    attack = importlib.import_module(module).attack
    printed, left = io.StringIO(), []
    home, hook = Path.cwd(), sys.unraisablehook
    folder = Path(tempfile.mkdtemp(prefix="odt-attack-"))
    try:
        os.chdir(folder)
        sys.unraisablehook = lambda args: left.append(args.exc_value)
        with warnings.catch_warnings(), contextlib.redirect_stdout(printed), \
                contextlib.redirect_stderr(printed):
            warnings.simplefilter("error")
            for category in (ODTWarning, DeprecationWarning, PendingDeprecationWarning):
                warnings.simplefilter("ignore", category)
            attack(np.random.default_rng(seed), folder)
    except ODTError as exc:
        return Verdict(REFUSED, one_line(exc), f"{type(exc).__name__}: {exc}")
    # Whatever else it is, it is what is looked for.
    except Exception as exc:
        return Verdict(FAILED, f"{type(exc).__name__}: {one_line(exc)} ({_place(exc)})",
                       "".join(traceback.format_exception(exc)))
    finally:
        os.chdir(home)
        sys.unraisablehook = hook
        shutil.rmtree(folder, ignore_errors=True)
    if left:
        return Verdict(FAILED, f"left behind: {one_line(repr(left[0]))}")
    if printed.getvalue():
        return Verdict(FAILED, f"it printed {one_line(printed.getvalue())[:200]!r}")
    return Verdict(OK)


def one_line(message: object) -> str:
    """A message on one line."""
    return " ".join(str(message).split())[:300]


def _place(exc: BaseException) -> str:
    """The innermost line of the package, or else of anything."""
    frames = traceback.extract_tb(exc.__traceback__)
    ours = [f for f in frames if "odt_plugins" in f.filename] or frames
    return f"{Path(ours[-1].filename).name}:{ours[-1].lineno}"


def serve(module: str, pipe: Connection, log: str, seconds: float) -> None:
    """Answer seeds with verdicts; a case that takes too long ends the process."""
    from odt_plugins.engine.compiled import threads
    from odt_plugins.progress import compiling_heard

    threads.THREADED_CELLS = 0
    # A group of its own: the signals of the terminal go to the parent alone, and what hangs is
    # ended with all that it started.
    os.setsid()
    with contextlib.suppress(ValueError):
        resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
    with open(log, "w") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    faulthandler.enable(file=2)

    def hear(begins: bool) -> None:
        """The time of compilers does not count: the clock starts anew after them."""
        faulthandler.dump_traceback_later(COMPILING if begins else seconds, exit=True, file=2)

    importlib.import_module(module)
    with compiling_heard(hear), contextlib.suppress(EOFError):
        while True:
            seed = pipe.recv()
            os.ftruncate(2, 0)
            faulthandler.dump_traceback_later(seconds, exit=True, file=2)
            verdict = judge(module, seed)
            faulthandler.cancel_dump_traceback_later()
            pipe.send(verdict)


@dataclass
class Worker:
    """The process of a module of attacks; started when it is needed and anew after its end."""

    module: str
    seconds: float
    process: Any = None
    pipe: Any = None
    log: str = ""

    def run(self, seed: int) -> Verdict:
        """The verdict on a case, whatever happens to the process."""
        if self.process is None:
            self._start()
        try:
            self.pipe.send(seed)
            if not self.pipe.poll(COMPILING + self.seconds):
                self.process.kill()
            verdict: Verdict = self.pipe.recv()
        except (EOFError, OSError):
            verdict = self._end_of_process()
            self.stop()
        return verdict

    def stop(self) -> None:
        """End the process and all that it started."""
        if self.process is None:
            return
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.kill()
        self.process.join()
        self.pipe.close()
        Path(self.log).unlink(missing_ok=True)
        self.process = None

    def _start(self) -> None:
        handle, self.log = tempfile.mkstemp(prefix="odt-attack-", suffix=".log")
        os.close(handle)
        spawn = multiprocessing.get_context("spawn")
        self.pipe, theirs = spawn.Pipe()
        self.process = spawn.Process(target=serve, daemon=False,
                                     args=(self.module, theirs, self.log, self.seconds))
        self.process.start()
        theirs.close()

    def _end_of_process(self) -> Verdict:
        self.process.join()
        log = Path(self.log).read_text(errors="replace")
        lines = [one_line(line) for line in log.splitlines()]
        places = [line for line in lines if line.startswith("File") and "attack/" not in line
                  and ("odt_plugins" in line or "meshio" in line)]
        where = f" ({places[0]})" if places else ""
        if any(line.startswith("Timeout (") for line in lines):
            return Verdict(FAILED, f"hang: no end after {self.seconds:g} s{where}", log)
        how = exit_name(self.process.exitcode)
        return Verdict(FAILED, f"crash: {how}{where}", log)
