"""Mesh files whose unchanged parts stay as they are: one file a format, or a family of formats.

A format has a reader, which takes a path and gives a meshio.Mesh, or a rewriter, or both. A
rewriter makes the target out of the source: with the points, the optimised cells and the arrays
of the result, and all else as the source has it.

Sources
-------
Abaqus: Analysis User's Guide, Input syntax rules, Dassault Systemes; G. Dhondt, CalculiX
CrunchiX User's Manual.
AVS: Advanced Visual Systems, AVS user's guide, unstructured cell data (UCD).
CGNS: Standard Interface Data Structures, version 4, and its mapping to HDF5, cgns.org.
Fluent: ANSYS Fluent user's guide, appendix on mesh files.
DOLFIN: A. Logg, K.-A. Mardal, G. Wells, Automated Solution of Differential Equations by the Finite
Element Method (2012), chapter on DOLFIN.
FLAC3D: Itasca, FLAC3D user's guide, grid files.
Exodus: L. Schoof, V. Yarberry, EXODUS II: A Finite Element Data Model, SAND92-2137 (1994).
Gmsh: https://gmsh.info/doc/texinfo/gmsh.html#MSH-file-format
Kratos: https://kratosmultiphysics.github.io/Kratos, input data, .mdpa files.
MED: MED file format 4.1, EDF and CEA, documentation of the Salome platform.
MEDIT: P. Frey, Medit, an interactive mesh visualization software, INRIA RT-0253 (2001).
Nastran: MSC Nastran Quick Reference Guide, chapter on bulk data.
OBJ: Wavefront, Appendix B1, Object Files (1995). OFF: Geomview manual, chapter on its formats.
PLY: G. Turk, The PLY Polygon File Format (1994). STL: 3D Systems, StereoLithography Interface
Specification (1989). SU2: documentation of SU2 7, mesh files. Tecplot: Tecplot 360
Data Format Guide, chapter on ASCII data. TetGen: H. Si, TetGen user's
manual, chapter on file formats.
UGRID: D. Marcum, 3D Input/Output Grids, AFLR, Mississippi State University.
XDMF: XDMF model and format, version 3, xdmf.org.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from odt_plugins.adapters.formats import (
    abaqus,
    abaqus_copy,
    abaqus_write,
    avsucd,
    cgns_write,
    dolfin,
    exodus,
    exodus_copy,
    exodus_write,
    flac3d,
    fluent,
    gmsh,
    gmsh_read,
    hdf,
    mdpa,
    med,
    med_copy,
    medit,
    nastran,
    nastran_copy,
    nastran_write,
    obj,
    off,
    permas,
    ply,
    stl,
    su2,
    tecplot,
    tetgen,
    ugrid,
    vol,
    xdmf,
    xdmf_copy,
)
from odt_plugins.adapters.formats.change import Change
from odt_plugins.adapters.formats.named_files import with_named

READERS: dict[str, Callable[[Path], Any]] = {
    "abaqus": abaqus.read, "avsucd": avsucd.read, "cgns": hdf.cgns,
    "dolfin-xml": dolfin.read, "exodus": exodus.read,
    "gmsh": gmsh_read.read, "h5m": hdf.h5m, "mdpa": mdpa.read, "med": med.read,
    "medit": medit.read,
    "nastran": nastran.read, "obj": obj.read, "off": off.read, "ply": ply.read, "stl": stl.read,
    "su2": su2.read, "tecplot": tecplot.read, "tetgen": tetgen.read, "ugrid": ugrid.read,
    "xdmf": xdmf.read,
}
"""Readers that take the place of meshio's, by the name of the format in meshio."""

COMPLETED: dict[str, Callable[[Path, Any], Any]] = {
    "ansys": fluent.completed, "flac3d": flac3d.completed, "netgen": vol.completed,
    "permas": permas.completed,
}
"""What is added to a mesh that meshio read: its path, the mesh, and the mesh that there is then."""

REWRITERS: dict[str, Callable[[Path, Path, Change], list[str]]] = {
    "abaqus": abaqus_copy.rewrite, "exodus": exodus_copy.rewrite, "gmsh": gmsh.rewrite,
    "mdpa": mdpa.rewrite, "med": med_copy.rewrite, "medit": medit.rewrite,
    "nastran": nastran_copy.rewrite, "netgen": vol.rewrite, "obj": with_named(obj.rewrite),
    "off": off.rewrite, "ply": with_named(ply.rewrite), "stl": stl.rewrite, "su2": su2.rewrite,
    "tecplot": tecplot.rewrite, "tetgen": tetgen.rewrite, "xdmf": xdmf_copy.rewrite,
}
"""Rewriters by the name of the format in meshio: source, target and change, to what is lost."""

WRITERS: dict[str, Callable[[Path, Any, bool | None], list[str]]] = {
    "abaqus": abaqus_write.write, "avsucd": avsucd.write, "cgns": cgns_write.write,
    "exodus": exodus_write.write,
    "flac3d": flac3d.write, "med": med.write, "medit": medit.write, "nastran": nastran_write.write,
    "netgen": vol.write, "obj": obj.write, "off": off.write, "permas": permas.write,
    "ply": ply.write,
    "stl": stl.write, "su2": su2.write, "tetgen": tetgen.write, "ugrid": ugrid.write,
}
"""Writers that take the place of meshio's: path, mesh and whether binary, to what is lost."""

COMPANIONS = {"tetgen": tuple(tetgen.BESIDE)}
"""Suffixes of files that are read beside the file of a mesh, and are there or not."""

BESIDE = {"medit": (".sol", ".solb")}
"""Suffixes of files that are read beside the file of a mesh, and may be those of others."""


def settle(made: Path, folder: Path, name: str) -> list[str]:
    """Take away what was beside a mesh file that is replaced; tell of what may be others'.

    Parameters
    ----------
    made : path      of the file that will be in `folder`, with others beside it that were made
    folder : path
    name : str       of the format
    """
    for suffix in COMPANIONS.get(name, ()):
        if not made.with_suffix(suffix).exists():
            (folder / made.name).with_suffix(suffix).unlink(missing_ok=True)
    beside = BESIDE.get(name, ())
    if any(made.with_suffix(suffix).exists() for suffix in beside):
        return []
    there = [(folder / made.name).with_suffix(suffix) for suffix in beside]
    return [f"{other.name} beside it stays, and is read with it though it is no part of it; try "
            f"another name, or remove it" for other in there if other.is_file()]
