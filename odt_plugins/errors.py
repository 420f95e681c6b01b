"""All exceptions and warnings of odt_plugins.

Every message says what was found, where (first offending index, how many), what was
expected and what to try.
"""

from __future__ import annotations

import contextlib
import inspect
import numbers
import os
import signal
import warnings
from contextlib import contextmanager
from importlib.util import find_spec
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from typing import Any


LONGEST = 200
"""Letters of the text of a value up to which a message has it."""

ROUNDING = 1e-15
"""Part of the extent of a mesh up to which a coordinate is 0."""

INSIDE = (os.path.dirname(os.path.abspath(__file__)) + os.sep, contextlib.__file__)
"""Where the files of the package begin, and what may stand between two of their functions."""


class ODTError(Exception):
    """Root of every error raised on purpose by odt_plugins."""


class InvalidMeshError(ODTError, ValueError):
    """The mesh itself is broken: shapes, indices, coordinates, orientation, topology."""


FacetPair = tuple[tuple[int, ...], tuple[int, ...]]
"""Vertices of two facets."""


class TangledMeshError(InvalidMeshError):
    """Some cells are inverted or flat, and were not to be, or could not be, untangled.

    Attributes
    ----------
    cells : tuple of int     their indices
    facets : tuple of pairs  facets of the boundary or of interfaces that make it impossible, each
                             with one that it crosses or lies on, by their vertices
    """

    def __init__(self, message: str, cells: Iterable[int] = (),
                 facets: Iterable[FacetPair] = ()) -> None:
        super().__init__(message)
        self.cells = tuple(int(cell) for cell in cells)
        self.facets = tuple(facets)


class CrashError(InvalidMeshError):
    """A process that worked on the mesh ended without a result.

    Attributes
    ----------
    code : int    its exit code; that of a signal is negative
    """

    code = 0


class EndlessWalkError(InvalidMeshError):
    """The triangles around a vertex lead on from one to the next and never back, nor to a rim.

    Attributes
    ----------
    vertex : int
    """

    vertex = -1


class UnsupportedMeshError(ODTError, TypeError):
    """The object or its cell types are nothing odt_plugins can optimise."""


class InvalidOptionError(ODTError, ValueError):
    """An option has an unknown name or a value outside its range."""


class MissingDependencyError(ODTError, ImportError):
    """An optional package is needed for what was asked and is not installed."""


class MeshFileError(ODTError, OSError):
    """A file could not be read or written."""


class WorkerError(ODTError, RuntimeError):
    """A cluster cannot be reached, or its workers were lost while they worked."""


def reworded(error: BaseException, text: str, kind: type[Any]) -> Any:
    """Give an error another text, or another kind, with all that it knows, such as `cells`."""
    said: Any = kind.__new__(kind, text)
    said.__dict__.update(error.__dict__)
    return said


class ODTWarning(UserWarning):
    """Root of every warning issued by odt_plugins."""


class DataNotKeptWarning(ODTWarning):
    """Some data of the caller's object could not be carried to the result."""


class NotConvergedWarning(ODTWarning):
    """An iterative solver stopped before it reached its tolerance."""


class NotFilledWarning(ODTWarning):
    """Part of a surface has no tetrahedra beside it, or their boundary is elsewhere."""


def warn(message: str, category: type[ODTWarning] = ODTWarning) -> None:
    """Warn of a line of the caller's: the first one outside of the package."""
    level, frame = 1, inspect.currentframe()
    while frame is not None and frame.f_code.co_filename.startswith(INSIDE):
        level, frame = level + 1, frame.f_back
    warnings.warn(message, category, stacklevel=level)


def is_number(value: object) -> bool:
    """Whether something is a real number, which True and False are not."""
    return isinstance(value, numbers.Real) and not isinstance(value, bool)


def expect(good: bool, name: str, value: object, expected: str) -> None:
    """Refuse the value of an option that is not good, by an InvalidOptionError.

    A value whose text is long or has several lines is told by its type.
    """
    if not good:
        text = repr(value)
        told = text if len(text) <= LONGEST and "\n" not in text else (
            f" of type {type(value).__name__}")
        msg = f"got {name}={told}; expected {expected}"
        raise InvalidOptionError(msg)


def counted(count: int, noun: str, plural: str | None = None) -> str:
    """Say how many there are: "1 cell", "2 cells"."""
    return f"{count} {noun if count == 1 else plural or noun + 's'}"


def change(first: float, last: float) -> str:
    """Say from which number to which, with six digits or as many more as tell them apart."""
    digits = next((k for k in range(6, 17) if f"{first:.{k}g}" != f"{last:.{k}g}"), 6)
    return f"from {first:.{digits}g} to {last:.{digits}g}"


def place_within(extent: float, place: Iterable[float], digits: int = 4) -> str:
    """Say where a place in a mesh is, "1.2, 0, 3.4": with more digits where it is far from the
    origin, as many as say as much of the mesh, which has this extent, as near the origin; and 0
    for less than rounding leaves of the extent.
    """
    return ", ".join(
        f"{x:.{next((k for k in range(digits, 17) if abs(x) <= extent * 10 ** (k - digits)), 17)}g}"
        for x in (0.0 if abs(x) <= ROUNDING * extent else x for x in place))


def endless_walk(vertex: int) -> EndlessWalkError:
    """Make the error of a walk around a vertex that did not end."""
    error = EndlessWalkError(
        f"got triangles around vertex {vertex} that lead on without an end, expected fans of "
        f"triangles that agree about the outside, try removing those that overlap there"
    )
    error.vertex = vertex
    return error


def plain_values(name: str, values: Any, error: type[ODTError] = InvalidOptionError) -> Any:
    """Give a tensor of open3d or another library as an array of numpy, a number or a truth of
    numpy or a fraction as one of Python, which does not overflow, and anything else as it is.

    Raises
    ------
    InvalidOptionError    or another `error`: some values of a masked array are masked, or a number
                          is too large
    """
    mask: Any = getattr(values, "mask", None)
    if str(getattr(mask, "dtype", "")) == "bool" and mask.any():
        bad = mask.nonzero()
        first = bad[0][0] if len(bad) else 0
        what = counted(len(bad[0]) if len(bad) else 1, "masked value")
        msg = (f"{name} has {what} (first: at index {first}); expected none, try "
               f"its method filled(...), or leave out what is masked")
        raise error(msg)
    if is_number(values):
        try:
            number = float(values)
        except OverflowError as exc:
            msg = f"got {name} of a number with more than 308 digits; expected a smaller one"
            raise error(msg) from exc
        return int(values) if isinstance(values, numbers.Integral) else number
    if type(values).__module__ == "numpy" and type(values).__name__ in ("bool", "bool_"):
        return bool(values)
    if not callable(getattr(values, "numpy", None)):
        return values
    return (values.cpu() if hasattr(values, "cpu") else values).numpy().copy()


def exit_name(code: int) -> str:
    """Say how a process ended: by an exit code, or by the name of a signal."""
    if code >= 0:
        return f"exit code {code}"
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"


def require(what: str, extra: str, *packages: str) -> None:
    """Refuse at once when packages are not there that something needs.

    Parameters
    ----------
    what : str        that needs them, the start of the sentence
    extra : str       of odt-plugins that brings them
    *packages : str   names to import

    Raises
    ------
    MissingDependencyError
    """
    missing = [name for name in packages if find_spec(name) is None]
    if missing:
        msg = (f"{what} needs {' and '.join(missing)}, not installed here; try "
               f'pip install "odt-plugins[{extra}]"')
        raise MissingDependencyError(msg)


@contextmanager
def writing(what: object, instead: str) -> Iterator[None]:
    """Say what could not be written, why, and what to try instead.

    Raises
    ------
    MeshFileError    the system refused; an error that is one already passes as it is
    """
    try:
        yield
    except MeshFileError:
        raise
    except OSError as exc:
        msg = f"cannot write {what}: {exc.strerror or exc}; try {instead}"
        raise MeshFileError(msg) from exc
