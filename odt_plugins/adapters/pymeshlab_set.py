"""A pymeshlab.MeshSet as a whole: copied, emptied and filled again, and its filter script."""

from __future__ import annotations

import signal
import tempfile
import weakref
from pathlib import Path
from typing import Any

from odt_plugins.adapters.pymeshlab_copy import add_copy, muted, needs_file, one_point
from odt_plugins.errors import DataNotKeptWarning, ODTWarning, warn
from odt_plugins.processes import held_back


def copy_of_set(meshes: Any, current: Any) -> Any:
    """Copy a MeshSet: its meshes with their ids, visibility, filter script.

    Parameters
    ----------
    meshes : pymeshlab.MeshSet     not changed
    current : pymeshlab.MeshSet    its mesh takes the place of the current mesh

    Warns
    -----
    DataNotKeptWarning    it holds rasters
    """
    from pymeshlab import MeshSet

    out = MeshSet()
    fill(out, meshes, current)
    restore_script(out, saved_script(meshes))
    if rasters(meshes):
        msg = f"the copy of the MeshSet does not keep its {rasters(meshes)} rasters"
        warn(msg, DataNotKeptWarning)
    return out


def fill(out: Any, meshes: Any, current: Any) -> None:
    """Copy the meshes of a set, with their ids and visibility, into an empty one.

    Parameters
    ----------
    out : pymeshlab.MeshSet                changed
    meshes, current : pymeshlab.MeshSet    see :func:`copy_of_set`
    """
    unused = []
    found = next_id = 0
    while found < meshes.mesh_number():
        if meshes.mesh_id_exists(next_id):
            own = next_id == meshes.current_mesh_id()
            add_copy(out, current.current_mesh() if own else meshes.mesh(next_id))
            out.set_mesh_visibility(next_id, meshes.is_mesh_visible(next_id))
            found += 1
        else:
            out.add_mesh(one_point())
            unused.append(next_id)
        next_id += 1
    for spare in unused:
        out.set_current_mesh(spare)
        out.delete_current_mesh()
    out.set_current_mesh(meshes.current_mesh_id())


def rasters(meshes: Any) -> int:
    """Number of rasters of a MeshSet; newer releases of pymeshlab have none."""
    count = getattr(meshes, "raster_number", None)
    return int(count()) if count else 0


@held_back(signal.SIGINT)
def exchange(meshes: Any, new: Any) -> None:
    """Put a mesh in the place of the current one, with its id.

    MeshLab gives ids only to meshes that are added, so the whole set is emptied and filled again
    in its order. Where that would do harm, since the set holds rasters, or one of its meshes is
    still in use as a Mesh object, or another has several textures, the new mesh is added at the
    end, with a new id. A current mesh that is in use stays beside it: a Mesh object of a mesh
    that is gone would read freed memory.

    Parameters
    ----------
    meshes : pymeshlab.MeshSet    changed
    new : pymeshlab.MeshSet       of one mesh

    Warns
    -----
    ODTWarning                    the mesh has a new id
    """
    own, held = meshes.current_mesh_id(), weakref.ref(meshes.current_mesh())
    if held() is None and _may_be_emptied(meshes):
        copy = copy_of_set(meshes, new)
        meshes.clear()
        fill(meshes, copy, copy)
        return
    visible = meshes.is_current_mesh_visible()
    add_copy(meshes, new.current_mesh())
    added = meshes.current_mesh_id()
    meshes.set_current_mesh_visibility(visible)
    if held() is None:
        meshes.set_current_mesh(own)
        meshes.apply_filter("delete_current_mesh")
        meshes.set_current_mesh(added)
        msg = (f"mesh {own} of the MeshSet was built anew and is now mesh {added}, since another "
               f"mesh of the set is in use as a Mesh object or has several textures, or there are "
               f"rasters; to keep the id, delete those Mesh objects (del) before")
    else:
        msg = (f"mesh {own} of the MeshSet is in use as a Mesh object and stays as it was, since "
               f"MeshLab cannot change its faces in place; the result is mesh {added}, which is "
               f"current now; to replace mesh {own}, delete the Mesh object (del) before")
    warn(msg, ODTWarning)


def _may_be_emptied(meshes: Any) -> bool:
    """Say whether the other meshes of a set can be copied without loss and without harm."""
    if rasters(meshes):
        return False
    found = current = 0
    while found < meshes.mesh_number():
        if meshes.mesh_id_exists(current):
            found += 1
            if current != meshes.current_mesh_id() and (
                weakref.ref(meshes.mesh(current))() is not None
                or needs_file(meshes.mesh(current))
            ):
                return False
        current += 1
    return True


def saved_script(meshes: Any) -> bytes:
    """Filter script of a set, as a file."""
    with tempfile.TemporaryDirectory(prefix="odt-plugins-") as folder:
        file = Path(folder) / "script.mlx"
        meshes.save_filter_script(str(file))
        return file.read_bytes()


def restore_script(meshes: Any, script: bytes) -> None:
    """Make a file the filter script of a set."""
    meshes.clear_filter_script()
    if b"<filter" not in script and b"<xmlfilter" not in script:
        return
    with tempfile.TemporaryDirectory(prefix="odt-plugins-") as folder:
        file = Path(folder) / "script.mlx"
        file.write_bytes(script)
        with muted():
            meshes.load_filter_script(str(file))
