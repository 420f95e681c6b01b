"""Readers of meshio and VTK, run so that each of them comes to an end whatever the file holds."""

from __future__ import annotations

import ctypes
import io
import re
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import numpy as np

from odt_plugins.adapters import apart, gmsh_files, netgen_files, vtk_files
from odt_plugins.adapters.formats import COMPLETED, READERS, flac3d, fluent, vol
from odt_plugins.adapters.formats.decks import REMARKS
from odt_plugins.adapters.formats.readers import readable, reader_of
from odt_plugins.adapters.formats.vol_tables import content
from odt_plugins.adapters.kinds import nodes_of
from odt_plugins.adapters.legacy import expect_whole
from odt_plugins.adapters.stated import expect_counts
from odt_plugins.errors import InvalidMeshError, MeshFileError

LEAST = 20.0
"""Seconds that the reading of any file may take."""

RATE = 50_000
"""Bytes for which it may take a second more. The slowest reader of meshio, that of PERMAS files,
takes 2.7 MB in a second, and 1.4 MB of a packed Netgen file."""

READ_ON = ("ansys",)
"""Formats whose readers go on at the end of the file."""

PATIENCE = 1000
"""How often a reader may come to the end of a file."""

TEXT = ("flac3d", "netgen", "permas")
"""Formats of text that meshio reads."""

FORTRAN = rb"(?<![\w.])([+-]?(?:\d+\.\d*|\.\d+))[dD]([+-]?\d+)(?!\w)"
"""A number with an exponent as Fortran writes it."""

NUMBER = r"[+-]?(?:\d++\.?+\d*+|\.\d++)(?:[eE][+-]?\d++)?+"
POINT = rf"{NUMBER}(?:\s++{NUMBER}){{2,3}}+"
TRIANGLE = rf"\(\s*+\(\s*+{POINT}(?:\s*+,\s*+{POINT}){{3}}+\s*+\)\s*+\)"
TIN = rf"\s*+TIN\s*+\((?:\s*+{TRIANGLE}\s*+,?+)*+\s*+\)"
"""Triangles in well-known text, without any second way to match what matched once."""

ALONE = threading.RLock()
"""Held while the streams and the warnings of the process are caught: they are there once."""


HEARD: ContextVar[io.StringIO | None] = ContextVar("HEARD", default=None)
"""Where a thread that reads a file keeps what is printed."""


class Ending(io.FileIO):
    """A file that breaks a reader off which comes to its end again and again."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.met = 0

    def readinto(self, buffer: Any, /) -> int:
        """Read as any file does.

        Raises
        ------
        EOFError    the end was met too often
        """
        count = super().readinto(buffer) or 0
        self.met += not count
        if self.met > PATIENCE:
            msg = "it ends too early"
            raise EOFError(msg)
        return count


def read(path: Path, name: str) -> tuple[Any, list[str]]:
    """Read a file by one reader of meshio; files of VTK by its own, where VTK is installed.

    Parameters
    ----------
    path : path
    name : str    of the format in meshio

    Returns
    -------
    mesh : meshio.Mesh
    remarks : list of str    what the reader and NumPy say about it, one sentence an entry

    Raises
    ------
    TimeoutError    it took longer than a file of this size may
    Exception       anything at all, on a file that is broken
    """
    size = expect_counts(path, name)
    if name == "vtk":
        expect_whole(path)
    if name == "netgen":
        vol.expect_end(path)
    if name == "flac3d":
        flac3d.expect_whole(path)
    seconds = LEAST + size / RATE
    try:
        if name in apart.VTK and apart.vtk_installed():
            mesh, said = _read_vtk(path, name, seconds)
        else:
            mesh, said = _read_meshio(path, name, seconds)
    except TimeoutError as exc:
        msg = f"it takes longer than {seconds:.3g} s, the limit for {size} bytes"
        raise TimeoutError(msg) from exc
    if not len(mesh.points):
        mesh.points = np.zeros((0, 3))
    for block in mesh.cells:
        if not len(block.data) and np.ndim(block.data) == 1:
            block.data = np.zeros((0, nodes_of(block.type) or 0), dtype=np.int64)
    if name in COMPLETED:
        mesh = COMPLETED[name](path, mesh)
    return mesh, [*said, *getattr(mesh, REMARKS, ())]


def _read_vtk(path: Path, name: str, seconds: float) -> tuple[Any, list[str]]:
    """Read a file by VTK; what VTK does not read, meshio may: that is said."""
    try:
        mesh, said = vtk_files.as_mesh(
            apart.call(vtk_files.read, path.absolute(), name, seconds=seconds))
    except (TimeoutError, InvalidMeshError):
        raise
    # VTK refuses, or has crashed.
    except Exception as exc:
        if not readable(name):
            raise
        try:
            mesh, said = _read_meshio(path, name, seconds)
        except TimeoutError:
            raise
        except Exception:
            raise exc from None
        return mesh, [f"VTK cannot read it, meshio can ({' '.join(str(exc).split())[:200]})", *said]
    return mesh, said


MORE: dict[str, tuple[Callable[[], bool], Callable[..., Any], str]] = {
    "gmsh": (gmsh_files.installed, gmsh_files.translate, "$^"),
    "netgen": (netgen_files.installed, netgen_files.read, "Unknown Netgen mesh token"),
}
"""Toolkits that read more files of a format than meshio: whether they are there, how they read, and
what meshio says of those files."""


def _read_meshio(path: Path, name: str, seconds: float) -> tuple[Any, list[str]]:
    """Read a file by meshio; by the toolkit that wrote it what meshio does not know."""
    try:
        return _read_alone(path, name, seconds)
    except Exception as exc:
        there, reader, unknown = MORE.get(name, (bool, vtk_files.read, "$^"))
        old = name == "gmsh" and re.match(rb"\$MeshFormat\s+4(\.0)?\s", path.read_bytes()[:40])
        if not (old or re.search(unknown, str(exc))) or not there():
            raise
        return apart.call(reader, path.absolute(), seconds=seconds,
                          modules=(reader.__module__,)), []


def _read_alone(path: Path, name: str, seconds: float) -> tuple[Any, list[str]]:
    if name in apart.HDF5:
        mesh, said = apart.call(_read_heard, path.absolute(), name, seconds=seconds, modules=())
    else:
        with remarks() as said:
            mesh = within(seconds, lambda: _read(path, name))
    return mesh, said


def _read_heard(path: Path, name: str) -> tuple[Any, list[str]]:
    with remarks() as said:
        return _read(path, name), said


def _read(path: Path, name: str) -> Any:
    if name in READERS:
        return READERS[name](path)
    if name == "ansys" and fluent.has_faces(path):
        return fluent.read(path)
    reader = reader_of(name)
    # A number that is none would become an index.
    with np.errstate(all="raise", under="ignore"), _opened(path, name) as source:
        return reader(source)


@contextmanager
def _opened(path: Path, name: str) -> Iterator[Any]:
    """What a reader is given: the path, or a file that ends."""
    if name == "wkt":
        yield io.StringIO(_without_exponents(path.read_text()))
    elif _written_otherwise(path, name):
        with tempfile.TemporaryDirectory() as folder:
            plain = Path(folder) / (path.stem if path.suffix.lower() == ".gz" else path.name)
            plain.write_bytes(_as_read(content(path), name))
            with _opened(plain, name) as source:
                yield source
    elif name in READ_ON:
        with io.BufferedReader(Ending(path)) as file:
            yield file
    else:
        yield str(path)


def _written_otherwise(path: Path, name: str) -> bool:
    """Whether a file of text is packed, or has ends of lines, exponents or groups that meshio does
    not know.
    """
    raw = path.read_bytes() if name in TEXT else b""
    data = content(path) if raw else raw
    return b"\0" not in data and _as_read(data, name) != raw


def _as_read(data: bytes, name: str) -> bytes:
    """The same text with plain ends of lines, exponents as in 1.5e3, and slots of groups."""
    text = re.sub(FORTRAN, rb"\1e\2", re.sub(rb"\r\n?", b"\n", data))
    return flac3d.with_slots(text) if name == "flac3d" else text


def _without_exponents(text: str) -> str:
    """Well-known text that meshio reads: its patterns know no exponents, and do not end otherwise.

    Raises
    ------
    MeshFileError    it is not one of triangles, or has a number beyond all floats
    """
    whole = re.match(TIN, text)
    if whole is None:
        msg = "it is not TIN (...) of closed triangles with three coordinates"
        raise MeshFileError(msg)
    return re.sub(r"[^\s(),]+[eE][^\s(),]+", _positional, whole[0])


def _positional(found: re.Match[str]) -> str:
    number = float(found[0])
    if not np.isfinite(number):
        msg = f"it has the coordinate {found[0]}"
        raise MeshFileError(msg)
    return np.format_float_positional(number, trim="-")


def within(seconds: float, work: Callable[[], Any]) -> Any:
    """Do work in a thread that is broken off after some time, and give what it returns.

    Raises
    ------
    TimeoutError    it was not done
    Exception       what the work raises
    """
    done: list[Any] = []
    failed: list[BaseException] = []
    heard = HEARD.get()

    def run() -> None:
        HEARD.set(heard)
        try:
            done.append(work())
        except BaseException as exc:
            failed.append(exc)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        thread.join(seconds)
    finally:
        if thread.is_alive():
            ctypes.pythonapi.PyThreadState_SetAsyncExc(
                ctypes.c_ulong(thread.ident or 0), ctypes.py_object(SystemExit))
    if failed:
        raise failed.pop()
    if not done:
        raise TimeoutError
    return done[0]


@contextmanager
def remarks() -> Iterator[list[str]]:
    """Collect what meshio prints and NumPy warns of, one sentence an entry, filled at the end.

    What other threads print and warn of goes where it did before.
    """
    text, caught = io.StringIO(), list[str]()
    found: list[str] = []
    before: Any = warnings.showwarning

    def heard(message: Any, *more: Any) -> None:
        if HEARD.get() is text:
            caught.append(str(message))
        else:
            before(message, *more)

    with (
        ALONE, redirect_stdout(_Apart(sys.stdout, text)), redirect_stderr(_Apart(sys.stderr, text)),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", UserWarning)
        # Where that is no error yet, arrays are shorter than what the file states.
        warnings.filterwarnings("error", "string or file could not be read to its end")
        warnings.showwarning = heard  # type: ignore[assignment]
        own = HEARD.set(text)
        try:
            yield found
        finally:
            HEARD.reset(own)
    found += sentences(text.getvalue())
    found += dict.fromkeys(re.split(r"\.\s", said)[0] for said in caught)


class _Apart:
    """A stream of the process that keeps what the thread prints that hears to itself as a text."""

    def __init__(self, stream: Any, text: io.StringIO) -> None:
        self._stream, self._text = stream or io.StringIO(), text

    def __getattr__(self, name: str) -> Any:
        return getattr(self._text if HEARD.get() is self._text else self._stream, name)


def sentences(text: str) -> list[str]:
    """Take what meshio prints apart."""
    parts = re.split(r"^(?:Warning|Error|Info):", text, flags=re.MULTILINE)
    return [" ".join(part.split()) for part in parts if part.strip()]
