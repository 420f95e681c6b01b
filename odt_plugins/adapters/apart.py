"""Work in a process of its own, which may crash or never end: ``python -m`` this module.

HDF5 needs that: a file that it could not write to its end, because the disk is full, stays half
open, and crashes the process when its handle is collected, or at its exit; and it reads some
damaged files for ever, while no other thread runs. VTK and HDF5 need most of a second to start:
the process stays for the next file, that of HDF5 until a file cannot be read or written.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import gc
import importlib
import os
import pickle
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from odt_plugins.errors import exit_name

HDF5 = ("cgns", "exodus", "h5m", "hmf", "med", "xdmf")
"""Formats of meshio that HDF5 reads and writes, that of Exodus through netCDF."""

VTK = {"vtk": "legacy", "vtu": "UnstructuredGrid", "vtp": "PolyData"}
"""Formats that VTK reads and writes, by their name in meshio, which knows no .vtp, and what VTK
calls them."""

PIECES = (".vtm", ".vtmb", ".pvtu", ".pvtp", ".vtkhdf")
"""Suffixes of files of VTK that pyvista alone reads."""

PARTITIONED = (".pvtu", ".pvtp")
"""Those of them that hold one mesh in pieces."""

BEFOREHAND = ("odt_plugins.adapters.vtk_files", "vtkmodules.vtkIOXML", "vtkmodules.vtkIOLegacy",
              "vtkmodules.util.numpy_support", "meshio")
"""Modules that the process which stays imports while nobody asks it, the first needed first; the
last one, with which it writes and does not read, when it has answered or waited."""

PAUSE = 0.2
"""Seconds that it waits."""

LENGTH = 8
"""Bytes of the length of a message."""

KEPT = threading.Lock()
"""Held while the process that stays is at work."""


class _Process:
    """A process that calls functions of modules, one after the other."""

    def __init__(self, *modules: str) -> None:
        paths = os.pathsep.join(map(os.path.abspath, sys.path))
        self.owner = os.getpid()
        self.said = tempfile.TemporaryFile()
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-m", "odt_plugins.adapters.apart", *modules],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.said,
            env=dict(os.environ) | {"PYTHONPATH": paths},
        )

    @property
    def usable(self) -> bool:
        """Whether it waits for work of this process, and not of one that forked from it."""
        return self.owner == os.getpid() and self.process.poll() is None

    def ask(self, function: Callable[..., Any], arguments: Any, seconds: float | None) -> Any:
        """As :func:`call`."""
        late = threading.Event()

        def stop() -> None:
            late.set()
            self.process.kill()

        timer = None if seconds is None else threading.Timer(seconds, stop)
        try:
            if timer:
                timer.daemon = True
                timer.start()
            answer = self._answer(pickle.dumps((function, arguments)))
        except BaseException:
            self.end()
            raise
        finally:
            if timer:
                timer.cancel()
        if answer is not None:
            result, error = pickle.loads(answer)
            if error is not None:
                raise error
            return result
        self.process.kill() if late.is_set() else None
        code = self.process.wait()
        self.said.seek(0)
        said = self.said.read().decode("utf-8", "replace").strip().splitlines()
        self.end()
        if late.is_set():
            msg = f"no answer within {seconds} s"
            raise TimeoutError(msg)
        msg = f"its process was ended by {exit_name(code)}"
        raise ChildProcessError(f"{msg}: {said[-1]}" if said else msg)

    def _answer(self, message: bytes) -> bytes | None:
        """What the process answers, None if it ended before."""
        stdin: Any = self.process.stdin
        try:
            stdin.write(len(message).to_bytes(LENGTH, "big") + message)
            stdin.flush()
        except BrokenPipeError:
            return None
        return _message(self.process.stdout)

    def end(self) -> None:
        """Let the process end."""
        if self.owner != os.getpid():
            return
        self.process.kill()
        self.process.wait()
        for stream in (self.process.stdin, self.process.stdout, self.said):
            try:
                if stream is not None:
                    stream.close()
            except BrokenPipeError:
                continue


def _message(stream: Any) -> bytes | None:
    """The next message, None where the stream ends before."""
    head = stream.read(LENGTH)
    if len(head) < LENGTH:
        return None
    size = int.from_bytes(head, "big")
    body: bytes = stream.read(size)
    return body if len(body) == size else None


@functools.cache
def _staying() -> dict[tuple[str, ...], _Process]:
    """Processes that live as long as this one, by the modules that they import beforehand."""
    return {}


def _ready(modules: tuple[str, ...]) -> _Process:
    """Give the process that stays with these modules, made if there is none."""
    process = _staying().get(modules)
    if process is None or not process.usable:
        if process is not None:
            atexit.unregister(process.end)
        process = _staying()[modules] = _Process(*modules)
        atexit.register(process.end)
    return process


def hint(path: Path) -> str:
    """What to try with files of VTK that pyvista alone reads, of several meshes or pieces.

    Pieces of one mesh do not share the vertices between them when they are read.
    """
    suffix = path.suffix.lower()
    if suffix not in PIECES or not vtk_installed() or not path.exists():
        return ""
    if suffix not in PARTITIONED:
        return ", try pyvista.read and odt_plugins.optimize of what it gives"
    more = ", or optimize with an OUTPUT or target that ends in .pvtu" * (suffix == ".pvtu")
    return f", try pyvista.read and odt_plugins.optimize of what its clean() gives{more}"


def vtk_installed() -> bool:
    """Say whether VTK is there; it comes with pyvista."""
    return find_spec("vtkmodules") is not None


def make_ready_for(paths: Iterable[str]) -> None:
    """Start the process that stays where VTK will read or write one of these files.

    It imports VTK while this one goes on.
    """
    suffixes = tuple(f".{name}" for name in VTK)
    if any(path.lower().endswith(suffixes) for path in paths) and vtk_installed():
        with contextlib.suppress(OSError), KEPT:
            _ready(BEFOREHAND)


def call(function: Callable[..., Any], *arguments: Any, seconds: float | None = None,
         modules: tuple[str, ...] = BEFOREHAND) -> Any:
    """Call a function of a module in a process that stays for the next call, until this one ends.

    It stays in the folder in which it began: the arguments name files from the root.

    Parameters
    ----------
    function : callable
    *arguments : anything        that pickle takes
    seconds : float, optional    after which the process is ended
    modules : tuple of str       what it imports beforehand; without any, it ends when the function
                                 fails, too

    Raises
    ------
    TimeoutError            it was not done
    ChildProcessError       the process ended without an answer
    Exception               what the function raises, or the collection of what it left
    """
    with KEPT:
        process = _ready(modules)
        try:
            return process.ask(function, arguments, seconds)
        except BaseException:
            if not modules:
                process.end()
            raise


def _import(modules: list[str], answered: threading.Event) -> None:
    """Import modules, the last one after an answer or a pause."""
    for module in modules:
        if module is modules[-1]:
            answered.wait(PAUSE)
        # A module may raise anything at all; who needs it will hear of it.
        with contextlib.suppress(Exception):
            importlib.import_module(module)


def _answered(result: Any, error: BaseException | None) -> bytes:
    """What a task gave or raised as a message; an error that pickle does not take by its text."""
    try:
        answer = pickle.dumps((result, error))
        pickle.loads(answer)
    except Exception:
        return pickle.dumps((None, RuntimeError(f"{type(error).__name__}: {error}")))
    return answer


def main() -> None:
    """Do the work that standard input names, and write its results or errors to standard output."""
    stream = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    left: list[BaseException] = []

    def note(told: Any) -> None:
        # The other thread imports what nobody has asked for yet.
        if threading.current_thread() is threading.main_thread():
            left.append(told.exc_value or RuntimeError(told.err_msg))

    sys.unraisablehook = note
    answered = threading.Event()
    threading.Thread(target=_import, args=(sys.argv[1:], answered), daemon=True).start()
    # Garbage is collected after every task, and looked for among what that made.
    gc.disable()
    while True:
        message = _message(sys.stdin.buffer)
        if message is None:
            # What is left open would crash the process on its way out.
            os._exit(0)
        result: Any = None
        error: BaseException | None = None
        # A reader or writer may raise anything at all.
        try:
            gc.freeze()
            function, arguments = pickle.loads(message)
            result = function(*arguments)
        except Exception as exc:
            error = exc
        answer, failed = _answered(result, error), error is not None
        function = arguments = message = result = error = None
        gc.collect()
        if left and not failed:
            answer = _answered(None, left[0])
        left.clear()
        stream.write(len(answer).to_bytes(LENGTH, "big") + answer)
        stream.flush()
        answered.set()


if __name__ == "__main__":
    main()
