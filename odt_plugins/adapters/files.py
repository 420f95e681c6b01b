"""Mesh files by path, through meshio or VTK: read, check, and written so that none is seen half."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import warnings
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters import apart, meshio_mesh, reading, vtk_files
from odt_plugins.adapters.host import HostMesh, Result
from odt_plugins.adapters.stated import declares_no_cells
from odt_plugins.errors import (
    DataNotKeptWarning,
    InvalidMeshError,
    MeshFileError,
    MissingDependencyError,
    writing,
)

PREFERRED = {".msh": "gmsh"}
"""Format to take first where several share a suffix."""

PROBE = 1 << 16
"""Bytes added to a file that was not written, to see whether the system lets it grow."""


def matches(mesh: object) -> bool:
    """Say whether this is a path."""
    return isinstance(mesh, str | os.PathLike)


def read(mesh: Any, regions: str | None = None) -> HostMesh:
    """Read the file and take the arrays out as of any meshio.Mesh."""
    return meshio_mesh.read(read_file(mesh), regions)


def write(result: Result, host: HostMesh) -> Any:
    """Give back a meshio.Mesh; :func:`write_file` is what writes it."""
    return meshio_mesh.write(result, host)


def read_file(path: str | os.PathLike[str]) -> Any:
    """Read a mesh file of any format that meshio or, where it is there, VTK knows, by its suffix.

    Returns
    -------
    meshio.Mesh

    Raises
    ------
    MeshFileError             there is no such file, its suffix is unknown, or it cannot be read:
                              it is broken, states more than it has bytes for, or takes longer
                              than 20 s and a second for every 50 kB
    InvalidMeshError          a .vtu file without cells
    MissingDependencyError    meshio needs another package for this format

    Warns
    -----
    DataNotKeptWarning        what meshio and NumPy say about a file that is read

    Notes
    -----
    A file that ends too early is refused where that can be seen. Abaqus .inp files do not say
    how many nodes and elements they have: one cut off after a whole line, or within the last
    number of an element, is a valid file of fewer elements, unless a node is gone that an
    element refers to. An .su2 file cut off right before NMARK is one without markers.
    """
    path = Path(path)
    formats = _formats(path)
    if not path.is_file():
        kind = "a directory" if path.is_dir() else "missing"
        msg = f"cannot read {path}: it is {kind}; expected a mesh file"
        raise MeshFileError(msg)
    mesh, remarks = _read_as(path, formats)
    for remark in remarks:
        warnings.warn(f"{path}: {remark}", DataNotKeptWarning, stacklevel=3)
    return mesh


def check_output(path: str | os.PathLike[str]) -> None:
    """See whether a mesh file could be written there, before any work is done.

    Raises
    ------
    MeshFileError    the suffix is unknown, or the directory is missing or not writable
    """
    path = Path(path)
    _formats(path)
    folder = path.parent
    if not folder.is_dir():
        msg = f"cannot write {path}: {folder} is not a directory; expected an existing one"
        raise MeshFileError(msg)
    if path.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        what = f"{path} is a directory" if path.is_dir() else f"{folder} is not writable"
        msg = f"cannot write {path}: {what}; expected a path for a new file, try another one"
        raise MeshFileError(msg)


def write_file(path: str | os.PathLike[str], mesh: Any) -> None:
    """Write a meshio.Mesh; the format is that of the suffix.

    The file is written in a directory beside the target, read back and compared, and renamed
    only then: whatever happens, the target is either as it was before or complete.

    Parameters
    ----------
    path : path            target
    mesh : meshio.Mesh     not changed

    Raises
    ------
    MeshFileError             it cannot be written, or the format does not hold such a mesh
    MissingDependencyError    meshio needs another package for this format

    Warns
    -----
    DataNotKeptWarning     the format holds the mesh but drops or renames data or rounds
                           coordinates; or what meshio says when nothing is lost
    """
    path = Path(path)
    check_output(path)
    with writing(path, "another directory"):
        beside = Path(tempfile.mkdtemp(prefix=f".{path.stem}-", dir=path.parent))
    try:
        with writing(path, "another path"):
            lost, remarks = _write_and_compare(beside / path.name, mesh)
            # Formats such as xdmf write companions; the file that refers to them comes last.
            for part in sorted(beside.iterdir(), key=lambda part: part.name == path.name):
                os.replace(part, path.parent / part.name)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    if lost:
        msg = f"{path} does not keep {', '.join(lost)}; try a .vtu file or another format"
        warnings.warn(msg, DataNotKeptWarning, stacklevel=3)
        return
    for remark in remarks:
        warnings.warn(f"{path}: {remark}", DataNotKeptWarning, stacklevel=3)


def _formats(path: Path) -> list[str]:
    """Formats of meshio, and of VTK where it is there, for a suffix, the most likely first."""
    from meshio import extension_to_filetypes

    known = dict(extension_to_filetypes)
    if vtk_files.installed():
        known[".vtp"] = ["vtp"]
    for count in range(len(path.suffixes)):
        suffix = "".join(path.suffixes[count:]).lower()
        if suffix in known:
            first = PREFERRED.get(suffix)
            return sorted(known[suffix], key=lambda name: name != first)
    if path.suffix.lower() == ".vtp":
        msg = f'{path} needs the package pyvista, which is not installed; try "pip install pyvista"'
        raise MissingDependencyError(msg)
    msg = f"{path} has no suffix of a mesh file; expected one of {' '.join(sorted(known))}"
    raise MeshFileError(msg)


def write_arrays(path: str | os.PathLike[str], points: NDArray[Any], cells: NDArray[Any]) -> None:
    """Write triangles or tetrahedra given as arrays; points in the plane get a third coordinate 0.

    Parameters
    ----------
    path : path                       as for :func:`write_file`, which says what may be raised
    points : (n, 2) or (n, 3) float
    cells : (m, 3) or (m, 4) int
    """
    import meshio

    space = np.zeros((len(points), 3))
    space[:, : points.shape[1]] = points
    kind = "triangle" if cells.shape[1] == 3 else "tetra"
    write_file(path, meshio.Mesh(space, [(kind, cells)]))


def _read_as(path: Path, formats: list[str]) -> tuple[Any, list[str]]:
    """Read as the first of some formats that goes; also what meshio says about it."""
    from meshio._helpers import reader_map

    cause: Exception | None = None
    for name in formats:
        if name not in reader_map and name not in vtk_files.FORMATS:
            continue
        try:
            return reading.read(path, name)
        except ImportError as exc:
            raise _missing(path, exc) from exc
        except TimeoutError as exc:
            cause = exc
            break
        # A parser may raise anything at all on a broken file.
        except Exception as exc:
            cause = cause or exc
    if declares_no_cells(path, formats):
        msg = f"the mesh has no cells in {path}; expected tetra or triangle"
        raise InvalidMeshError(msg) from cause
    kinds = " or ".join(formats)
    reason = "meshio only writes it" if cause is None else _reason(cause)
    if cause is not None and reason == type(cause).__name__:
        reason = f"it is incomplete or no {kinds} file"
        if isinstance(cause, MemoryError):
            reason = "it needs more memory than there is"
    elif isinstance(cause, KeyError):
        reason = f"it refers to {cause.args[0]}, which is not there"
    msg = f"cannot read {path} as {kinds}: {reason}; expected a complete file"
    raise MeshFileError(msg) from cause


def _missing(path: Path, exc: ImportError) -> MissingDependencyError:
    msg = (
        f"{path.suffix} files need the package {exc.name}, which is not installed; try "
        f'"pip install {exc.name}" or another format such as .vtu'
    )
    return MissingDependencyError(msg)


def _write_and_compare(path: Path, mesh: Any) -> tuple[list[str], list[str]]:
    """Write a file, read it again and name the data that are gone; also what meshio says."""
    name = _formats(path)[0]
    # What meshio writes as Gmsh 4.1 is complete with these three arrays only.
    tags = {"gmsh:physical", "gmsh:geometrical"} <= set(mesh.cell_data)
    if name == "gmsh" and not (tags and "gmsh:dim_tags" in mesh.point_data):
        name = "gmsh22"
    said: list[str] = []
    differs = ""
    try:
        if name in vtk_files.FORMATS and vtk_files.installed():
            back, differs = apart.call(vtk_files.write_and_read, path, mesh, name)
        else:
            heard = partial(apart.call, _write_heard) if name in apart.HDF5 else _write_heard
            said = heard(path, mesh, name)
            back, _ = _read_as(path, _formats(path))
    except MissingDependencyError:
        raise
    except ImportError as exc:
        raise _missing(path, exc) from exc
    except MeshFileError as exc:
        reason = f"what meshio writes cannot be read again ({_reason(exc.__cause__)})"
        raise _not_written(path, name, reason) from exc
    # A writer may raise anything at all on a mesh that its format does not hold.
    except Exception as exc:
        refused = _refused(exc, path)
        if refused is not None:
            raise refused from exc
        if isinstance(exc, OSError):
            raise
        raise _not_written(path, name, _reason(exc)) from exc
    if differs:
        raise _not_written(path, name, f"meshio and VTK read {differs} of the file differently")
    if _sizes(back) != _sizes(mesh) or len(back.points) != len(mesh.points):
        reason = f"it does not hold {len(mesh.points)} points with cells {_sizes(mesh)}"
        raise _not_written(path, name, reason)
    lost = _lost(mesh, back)
    if name in vtk_files.FORMATS:
        lost += _other_types(mesh, back)
    return lost, said


def _write_heard(path: Path, mesh: Any, name: str) -> list[str]:
    import meshio

    mesh = mesh.copy()
    if name == "vtk":
        _widen(mesh)
    # Flat triangles of STL files have no normals.
    with reading.remarks() as said, np.errstate(all="ignore"):
        meshio.write(path, mesh, file_format=name)
    return said


def _widen(mesh: Any) -> None:
    """Exchange integers of less than eight bytes, which meshio writes in words VTK lacks."""

    def wide(values: Any) -> NDArray[Any]:
        array = np.asarray(values)
        return array.astype(np.int64) if array.dtype.kind in "biu" and array.itemsize < 8 else array

    mesh.point_data = {name: wide(values) for name, values in mesh.point_data.items()}
    mesh.cell_data = {name: [*map(wide, values)] for name, values in mesh.cell_data.items()}
    mesh.field_data = {name: wide(values) for name, values in mesh.field_data.items()}


def _refused(exc: Exception, path: Path) -> OSError | None:
    """What the system said: HDF5 tells it amid addresses, NumPy and netCDF do not at all."""
    told = re.search(r"errno = (\d+)", str(exc))
    number = getattr(exc, "errno", None) or (told and int(told[1]))
    if number:
        return OSError(number, os.strerror(number))
    try:
        with path.open("ab") as file:
            file.write(bytes(PROBE))
    except OSError as system:
        return system
    return None


def _not_written(path: Path, name: str, reason: str) -> MeshFileError:
    msg = f"cannot write {path.name} as {name}: {reason}; try another format such as .vtu"
    return MeshFileError(msg)


def _reason(exc: BaseException | None) -> str:
    """One line that says what went wrong in a parser or writer."""
    return " ".join(str(exc).split())[:200] or type(exc).__name__


def _sizes(mesh: Any) -> dict[str, int]:
    """Number of cells by type."""
    sizes: dict[str, int] = {}
    for block in mesh.cells:
        if len(block.data):
            sizes[block.type] = sizes.get(block.type, 0) + len(block.data)
    return dict(sorted(sizes.items()))


def _lost(mesh: Any, back: Any) -> list[str]:
    """Name the data that did not come back, and those that did under another name.

    Formats may put the points in another order: .msh has those of one entity together.
    """
    lost = []
    renamed = []
    d = min(mesh.points.shape[1], back.points.shape[1])
    old, new = mesh.points[:, :d], back.points[:, :d]
    if not np.array_equal(old, new) and not np.array_equal(
        np.unique(old, axis=0), np.unique(new, axis=0)
    ):
        lost.append("the last digits of the coordinates")
    for kind in ("point_data", "cell_data", "field_data", "point_sets", "cell_sets"):
        old, new = getattr(mesh, kind), getattr(back, kind)
        what = kind.replace("_", " ")
        gone = sorted(set(old) - set(new))
        if kind in ("point_data", "cell_data"):
            names = {name: _same_values(old[name], new, set(new) - set(old)) for name in gone}
            renamed += [f"the name of {what} {name!r} (there {other!r})"
                        for name, other in names.items() if other]
            gone = [name for name in gone if not names[name]]
        if gone:
            lost.append(f"{what} {', '.join(map(repr, gone))}")
    return lost + renamed


def _other_types(mesh: Any, back: Any) -> list[str]:
    """Name the arrays that came back with values of another type."""
    other = []
    for kind in ("point_data", "cell_data"):
        old, new = getattr(mesh, kind), getattr(back, kind)
        for name in sorted(set(old) & set(new)):
            was, now = _one_array(old[name]).dtype, _one_array(new[name]).dtype
            if now.newbyteorder("=") != was.newbyteorder("=") and was.kind not in "US":
                what = kind.replace("_", " ")
                other.append(f"the type of {what} {name!r} ({was}, there {now})")
    return other


def _same_values(values: Any, data: Any, names: set[str]) -> str | None:
    """Name under which a point or cell array came back."""
    flat = _one_array(values)
    return next((n for n in sorted(names) if np.array_equal(_one_array(data[n]), flat)), None)


def _one_array(values: Any) -> NDArray[Any]:
    """Point data, or the cell data of all blocks one after another."""
    return np.concatenate(values) if isinstance(values, list) and values else np.asarray(values)
