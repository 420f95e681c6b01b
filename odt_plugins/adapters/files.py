"""Mesh files by path, through meshio or VTK: read, check, and written so that none is seen half."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters import (
    apart,
    gmsh_files,
    meshio_mesh,
    reading,
    scene_files,
    trimesh_scene,
    vtk_files,
)
from odt_plugins.adapters.comparing import not_kept, other_types
from odt_plugins.adapters.fitting import FORMS, fitted, unheld
from odt_plugins.adapters.formats import (
    READERS,
    REWRITERS,
    WRITERS,
    gmsh_groups,
    gmsh_tables,
    settle,
)
from odt_plugins.adapters.formats.change import Change, NotRewritable, Origin, origin_of
from odt_plugins.adapters.formats.decks import DECK, UNREAD
from odt_plugins.adapters.formats.readers import readable
from odt_plugins.adapters.host import HostMesh, Result
from odt_plugins.adapters.legacy import widen
from odt_plugins.adapters.lengths import alike
from odt_plugins.adapters.recolouring import recoloured
from odt_plugins.adapters.set_labels import as_sets
from odt_plugins.adapters.stated import declares_no_cells, hope_of, meaning_of
from odt_plugins.adapters.symbolic import behind, expect_file, name_behind, with_companions
from odt_plugins.errors import (
    DataNotKeptWarning,
    InvalidMeshError,
    InvalidOptionError,
    MeshFileError,
    MissingDependencyError,
    warn,
    writing,
)

FILE_FORMATS = {"gmsh22": "gmsh22", "gmsh41": "gmsh"}
"""Versions of Gmsh's format that can be asked for, and their names in meshio."""

PLAIN: Any = {"legacy": "1.25"} if int(np.__version__.split(".")[0]) > 1 else {}
"""Options by which numbers are printed as plain ones, which they always are before NumPy 2."""

PREFERRED = {".msh": "gmsh"}
"""Format to take first where several share a suffix."""

REMARKS = 3
"""Most remarks of a reader that are passed on one by one."""

CELLS = r"(?:line|triangle|quad|tetra|pyramid|wedge|hexahedron)\d+"
"""What types of cells of higher order are called."""

PROBE = 1 << 16
"""Bytes added to a file that was not written, up to 20 times those of its points, to see whether
the system lets it grow."""


def matches(mesh: object) -> bool:
    """Say whether this is a path."""
    return isinstance(mesh, str | os.PathLike)


def read(mesh: Any, regions: str | Sequence[str] | None = None) -> HostMesh:
    """Read the file and take the arrays out as of any meshio.Mesh."""
    found = read_file(mesh)
    if trimesh_scene.matches(found):
        return trimesh_scene.read(found, regions, trimesh_scene.LOADED)
    return meshio_mesh.read(found, regions)


def write(result: Result, host: HostMesh) -> Any:
    """Give back a meshio.Mesh; :func:`write_file` is what writes it."""
    return meshio_mesh.write(result, host)


def read_file(path: str | os.PathLike[str]) -> Any:
    """Read a mesh file of any format that meshio or, where it is there, VTK knows, by its suffix.

    Returns
    -------
    meshio.Mesh      or trimesh.Scene of files of glTF

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
    path = with_companions(Path(path))
    formats = _formats(path)
    expect_file(path)
    if path.suffix.lower() in scene_files.SUFFIXES:
        return _read_scene(path)
    mesh, remarks, name = _read_as(path, formats)
    vars(mesh).pop(DECK, None)
    setattr(mesh, meshio_mesh.ORIGIN, origin_of(path, name, mesh))
    told = list(dict.fromkeys(remarks))
    if len(told) > REMARKS:
        told = [f"{told[0]} (and {len(told) - 1} more remarks of its reader)"]
    for remark in told:
        warn(f"{path}: {remark}", DataNotKeptWarning)
    return mesh


def _read_scene(path: Path) -> Any:
    """Read a file of glTF by trimesh."""
    try:
        with reading.remarks():
            return scene_files.read(path)
    # A parser may raise anything at all on a broken file.
    except Exception as exc:
        reason = meaning_of(_reason(exc))
        if reason == type(exc).__name__ or isinstance(exc, KeyError):
            reason = "it is incomplete or no glTF file"
        msg = f"cannot read {path} as glTF: {reason}; expected a complete file"
        raise MeshFileError(msg) from exc


def expect_same_kind(mesh: Any, target: str | os.PathLike[str]) -> None:
    """See whether a scene, or a path of one, goes into a file of scenes and a mesh into another.

    Raises
    ------
    MeshFileError    it is the other way round, or the format does not hold the cells of the mesh
    """
    scene = (Path(mesh).suffix.lower() in scene_files.SUFFIXES if matches(mesh)
             else trimesh_scene.matches(mesh))
    if scene != (Path(target).suffix.lower() in scene_files.SUFFIXES):
        what, other = ("a scene", ".glb") if scene else ("a single mesh", ".ply or .vtu")
        msg = f"cannot write {what} to {target}; try a {other} file"
        raise MeshFileError(msg)
    name = chosen_format(Path(target))[0]
    copied = scene or matches(mesh) or _source(Path(target), mesh) is not None
    kinds = "" if copied else unheld(mesh, name)
    if kinds:
        raise _not_written(Path(target), name, f"it holds no cells of type {kinds}")


def check_output(
    path: str | os.PathLike[str], file_format: str | None = None, binary: bool | None = None
) -> None:
    """See whether a mesh file could be written there, before any work is done.

    Raises
    ------
    InvalidOptionError    as for :func:`write_file`
    MeshFileError    the suffix is unknown, or the directory is missing or not writable
    """
    path = Path(path)
    chosen_format(path, None, file_format, binary)
    check_place(path)


def check_place(path: Path) -> None:
    """See whether a file of any format could be written there."""
    folder = behind(path).parent
    if not folder.is_dir():
        msg = f"cannot write {path}: {folder} is not a directory; expected an existing one"
        raise MeshFileError(msg)
    if path.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        what = f"{path} is a directory" if path.is_dir() else f"{folder} is not writable"
        msg = f"cannot write {path}: {what}; expected a path for a new file, try another one"
        raise MeshFileError(msg)


def write_file(
    path: str | os.PathLike[str], mesh: Any, file_format: str | None = None,
    binary: bool | None = None,
) -> None:
    """Write a meshio.Mesh; the format is that of the suffix.

    A mesh that was read from a file of the same format is written into a copy of that file, whose
    other parts stay as they are; files of formats that have no such rewriter are written anew.
    Either way this is done in a directory beside the target, read back and compared, and renamed
    only then: whatever happens, the target is either as it was before or complete. A link stays,
    and the file behind it is written.

    Parameters
    ----------
    path : path            target
    mesh : meshio.Mesh     not changed
    file_format : str      one of FILE_FORMATS, where the suffix leaves a choice; None takes
                           version 4.1 for meshes that were read from such files, and for arrays of
                           cells of several types, which meshio does not take from version 2.2
    binary : bool          or as text; None takes what the file is that the mesh was read from, if
                           it is of the same format, or else binary

    Raises
    ------
    InvalidOptionError        the suffix is not one of that format, or has no such choice
    MeshFileError             it cannot be written, or the format does not hold such a mesh
    MissingDependencyError    meshio needs another package for this format

    Warns
    -----
    DataNotKeptWarning     the format holds the mesh but drops or renames data or rounds
                           coordinates; or what meshio says when nothing is lost; or a file
                           beside it will be read with it that does not belong to it
    """
    path = Path(path)
    check_output(path)
    expect_same_kind(mesh, path)
    mesh = mesh if trimesh_scene.matches(mesh) else alike(mesh)
    source = _source(path, mesh) if file_format is None and binary is None else None
    name, binary = chosen_format(path, mesh, file_format, binary)
    with writing(path, "another directory"):
        real = behind(path)
        beside = Path(tempfile.mkdtemp(prefix=f".{path.stem}-", dir=real.parent))
        made = beside / name_behind(path)
    try:
        with writing(path, "another path"):
            lost, remarks = _rewritten(made, mesh, source)
            if trimesh_scene.matches(mesh):
                lost = scene_files.write(made, mesh)
            elif lost is None:
                labelled, renamed = as_sets(mesh, name)
                lost, more = _write_and_compare(
                    made, recoloured(labelled, name), name, binary)
                lost += renamed
                remarks += more
                lost += mesh.info.get(UNREAD, []) if isinstance(mesh.info, dict) else []
            beside_it = settle(made, real.parent, name)
            # Formats such as xdmf write companions; the file that refers to them comes last.
            for part in sorted(beside.iterdir(), key=lambda part: part == made):
                os.replace(part, real if part == made else real.parent / part.name)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    if lost:
        other = "another format" if name in apart.VTK else "a .vtu file or another format"
        hint = "" if trimesh_scene.matches(mesh) else f"; try {other}"
        msg = f"{path} does not keep {', '.join(lost)}{hint}"
        warn(msg, DataNotKeptWarning)
        remarks = []
    for remark in remarks + beside_it:
        warn(f"{path}: {remark}", DataNotKeptWarning)


def _formats(path: Path) -> list[str]:
    """Formats of meshio, and of VTK where it is there, for a suffix, the most likely first."""
    from meshio import extension_to_filetypes

    known = {suffix: names for suffix, names in extension_to_filetypes.items() if names != ["svg"]}
    known[".dat"] = [*known.get(".dat", ()), "nastran"]
    if apart.vtk_installed():
        known[".vtp"] = ["vtp"]
    if scene_files.installed():
        known |= {suffix: [name] for suffix, name in scene_files.SUFFIXES.items()}
    for count in range(len(path.suffixes)):
        suffix = "".join(path.suffixes[count:]).lower()
        if suffix in known:
            first = PREFERRED.get(suffix)
            return sorted(known[suffix], key=lambda name: name != first)
    needed = {".vtp": "pyvista"} | dict.fromkeys(scene_files.SUFFIXES, "trimesh")
    package = needed.get(path.suffix.lower())
    if package is not None:
        msg = (f'{path} needs the package {package}, which is not installed; try '
               f'"pip install {package}"')
        raise MissingDependencyError(msg)
    msg = f"{path} has no suffix of a mesh file; expected one of {' '.join(sorted(known))}"
    raise MeshFileError(msg + apart.hint(path))


def write_arrays(
    path: str | os.PathLike[str], points: NDArray[Any], cells: NDArray[Any],
    regions: NDArray[Any] | None = None,
) -> None:
    """Write triangles or tetrahedra given as arrays; points in the plane get a third coordinate 0.

    Parameters
    ----------
    path : path                       as for :func:`write_file`, which says what may be raised
    points : (n, 2) or (n, 3) float
    cells : (m, 3) or (m, 4) int
    regions : (m,) int, optional      labels, as the cell array "region"
    """
    import meshio

    space = np.zeros((len(points), 3))
    space[:, : points.shape[1]] = points
    kind = "triangle" if cells.shape[1] == 3 else "tetra"
    data: Any = {} if regions is None else {"region": [regions]}
    write_file(path, meshio.Mesh(space, [(kind, cells)], cell_data=data))


def _read_as(path: Path, formats: list[str]) -> tuple[Any, list[str], str]:
    """Read as the first of some formats that goes; also what meshio says, and the format."""
    cause: Exception | None = None
    if "ansys" in formats:
        with path.open("rb") as file:
            formats = ["ansys"] if file.read(1) == b"(" else formats
    for name in formats:
        if not readable(name) and name not in apart.VTK:
            continue
        try:
            return *reading.read(path, name), name
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
    reason = "meshio only writes it" if cause is None else meaning_of(_reason(cause))
    if cause is not None and reason == type(cause).__name__:
        reason = f"it is incomplete or no {kinds} file"
        if isinstance(cause, MemoryError):
            reason = "it needs more memory than there is"
    elif isinstance(cause, KeyError):
        key = cause.args[0]
        reason = (f"it has cells of type {key}, which meshio does not know"
                  if re.fullmatch(CELLS, str(key)) else f"it refers to {key}, which is not there")
    cut = isinstance(cause, EOFError) or not READERS.keys() & set(formats)
    msg = f"cannot read {path} as {kinds}: {reason}{hope_of(reason, kinds, cut=cut)}"
    raise MeshFileError(msg) from cause


def _missing(path: Path, exc: ImportError) -> MissingDependencyError:
    msg = (
        f"{path.suffix} files need the package {exc.name}, which is not installed; try "
        f'"pip install {exc.name}" or another format such as .vtu'
    )
    return MissingDependencyError(msg)


def chosen_format(
    path: Path, mesh: Any = None, file_format: str | None = None, binary: bool | None = None
) -> tuple[str, bool | None]:
    """Name in meshio of the format to write, and whether binary: None where there is no choice.

    Raises
    ------
    InvalidOptionError    the suffix is not one of that format, or has no such choice
    """
    name = _formats(path)[0]
    if file_format is not None and (name != "gmsh" or file_format not in FILE_FORMATS):
        msg = (f"got file_format={file_format!r} for {path.name}; expected one of "
               f"{', '.join(FILE_FORMATS)}, for .msh files alone")
        raise InvalidOptionError(msg)
    if name == "gmsh" and mesh is not None:
        tags = {gmsh_tables.PHYSICAL, gmsh_tables.ENTITY} & set(mesh.cell_data)
        whole = tags and gmsh_tables.NODE_ENTITY in mesh.point_data
        whole = whole or (gmsh_tables.PHYSICAL not in mesh.cell_data and mesh.cell_sets)
        whole = whole or _has_views_of_blocks(mesh)
        name = FILE_FORMATS[file_format or ("gmsh41" if whole else "gmsh22")]
        if binary is None:
            binary = not (isinstance(mesh.info, dict) and mesh.info.get("text"))
    if binary is not None and not (name in FORMS and FORMS[name].text):
        kind = "binary" if binary else "text"
        msg = f"got {kind} files for {path.name}; expected no choice, the format has only one kind"
        raise InvalidOptionError(msg)
    return name, binary


def _has_views_of_blocks(mesh: Any) -> bool:
    """Whether cells of several types have arrays, and no file of Gmsh is where they come from.

    meshio takes such arrays from files of version 4.1 alone.
    """
    origin = getattr(mesh, meshio_mesh.ORIGIN, None)
    own = {gmsh_tables.PHYSICAL, gmsh_tables.ENTITY}
    return (not (origin and origin.format == "gmsh") and bool(set(mesh.cell_data) - own)
            and len({block.type for block in mesh.cells}) > 1)


def _write_and_compare(
    path: Path, mesh: Any, name: str, binary: bool | None
) -> tuple[list[str], list[str]]:
    """Write a file, read it again and name the data that are gone; also what meshio says."""
    said: list[str] = []
    differs = ""
    try:
        fit, lost = fitted(mesh, name)
        if name in apart.VTK and apart.vtk_installed():
            back, differs = apart.call(vtk_files.write_and_read, path.absolute(), fit, name, binary)
        else:
            said = _alone(_write_heard, name)(path.absolute(), fit, name, binary)
            back, _, _ = _read_as(path, _formats(path))
    except MissingDependencyError:
        raise
    except ImportError as exc:
        raise _missing(path, exc) from exc
    except MeshFileError as exc:
        if (refused := _refused(exc, path, mesh)) is not None:
            raise refused from exc
        reason = f"what meshio writes cannot be read again ({_reason(exc.__cause__)})"
        raise _not_written(path, name, reason) from exc
    # A writer may raise anything at all on a mesh that its format does not hold.
    except Exception as exc:
        refused = _refused(exc, path, mesh)
        if refused is not None:
            raise refused from exc
        if isinstance(exc, OSError):
            raise
        kind, reason = str(*exc.args[:1]), _reason(exc)
        if isinstance(exc, KeyError) and re.fullmatch(CELLS, kind):
            reason = f"it holds no cells of type {kind}"
        raise _not_written(path, name, reason) from exc
    if differs:
        raise _not_written(path, name, f"meshio and VTK read {differs} of the file differently")
    if _sizes(back) != _sizes(fit) or (name != "stl" and len(back.points) != len(fit.points)):
        reason = f"it does not hold {len(fit.points)} points with cells {_sizes(fit)}"
        raise _not_written(path, name, reason)
    lost += not_kept(mesh, back)
    if name in apart.VTK:
        lost += other_types(mesh, back)
    return lost, said


def _source(path: Path, mesh: Any) -> Origin | None:
    """The file into a copy of which a mesh is written, if there is one of the same format."""
    origin: Origin | None = getattr(mesh, meshio_mesh.ORIGIN, None)
    if origin is None or origin.format not in REWRITERS or origin.format not in _formats(path):
        return None
    # Suffixes such as those of .inp and .msh belong to several formats.
    same = origin.path.suffix.lower() == path.suffix.lower() or _formats(path)[0] == origin.format
    return origin if same else None


def _rewritten(path: Path, mesh: Any, origin: Origin | None) -> tuple[list[str] | None, list[str]]:
    """Write a mesh into a copy of the file it was read from: what is lost, None of none written."""
    if origin is None:
        return None, []
    try:
        if not origin.unchanged:
            msg = "the file that was read is another one by now"
            raise NotRewritable(msg)
        before, _ = reading.read(origin.path, origin.format)
        blocks = [(block.type, len(block.data)) for block in mesh.cells]
        if [block.type for block in before.cells] != [kind for kind, _ in blocks] or [
                size for _, size in blocks] != [len(rows) for rows in origin.cells]:
            msg = "the mesh has other blocks of cells than the file that was read"
            raise NotRewritable(msg)
        lost = _alone(REWRITERS[origin.format], origin.format)(
            origin.path, path.absolute(), Change(before, mesh, origin.points, origin.cells))
        back, _, _ = _read_as(path, [origin.format])
    except NotRewritable as exc:
        said = f"written anew, with what the format's writer keeps: {exc}"
        return None, [said] if str(exc) else []
    except MeshFileError as exc:
        reason = f"the copy of {origin.path} cannot be read again ({_reason(exc.__cause__ or exc)})"
        raise _not_written(path, origin.format, reason) from exc
    # That is what netCDF4 and h5py say of a disk that is full.
    except RuntimeError as exc:
        raise _not_written(path, origin.format, _reason(exc)) from exc
    if _sizes(back) != _sizes(mesh) or len(back.points) != len(mesh.points):
        msg = f"it does not hold {len(mesh.points)} points with cells {_sizes(mesh)}"
        raise _not_written(path, origin.format, msg)
    return lost + not_kept(mesh, back), []


def _alone(writer: Callable[..., list[str]], name: str) -> Callable[..., list[str]]:
    """A writer of a format, in a process of its own where HDF5 writes it."""
    return partial(apart.call, writer, modules=()) if name in apart.HDF5 else writer


def _write_heard(path: Path, mesh: Any, name: str, binary: bool | None) -> list[str]:
    import meshio

    if name == "vtk":
        widen(mesh)
    # Flat triangles of STL files have no normals. Some writers print numbers as they are written
    # in Python.
    with reading.remarks() as said, np.errstate(all="ignore"), np.printoptions(**PLAIN):
        if name == "gmsh":
            gmsh_files.write(path, mesh, binary is not False)
            gmsh_files.restore_names(path, mesh.field_data)
        elif name == "gmsh22":
            meshio.write(path, gmsh_groups.with_copies(mesh), name, binary=binary is not False)
            gmsh_files.restore_names(path, mesh.field_data)
        elif name in WRITERS:
            WRITERS[name](path, mesh, binary)
        elif binary is None:
            meshio.write(path, mesh, file_format=name)
        else:
            meshio.write(path, mesh, file_format=name, binary=binary)
    return said


def _refused(exc: Exception, path: Path, mesh: Any) -> OSError | None:
    """What the system said: HDF5 tells it amid addresses, NumPy, netCDF and VTK do not at all."""
    told = re.search(r"errno = (\d+)", str(exc))
    number = getattr(exc, "errno", None) or (told and int(told[1]))
    if number:
        return OSError(number, os.strerror(number))
    try:
        with path.open("ab") as file:
            for _ in range(1 + 20 * mesh.points.nbytes // PROBE):
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
