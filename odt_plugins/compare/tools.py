"""The tools behind the contestants: their names, and which meshes they cannot take, and why."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from odt_plugins.compare.contestants import OURS, Contestant
from odt_plugins.compare.start import Kind

KINDS: dict[Kind, str] = {
    "tets": "tetrahedra", "planar": "triangles in the plane", "surface": "surfaces",
}
"""Kinds of start mesh as sentences call them."""


class Tool(NamedTuple):
    """A family of contestants.

    Attributes
    ----------
    name : str        as its makers write it
    refuses : dict    why no contestant of it takes a kind of mesh
    """

    name: str
    refuses: dict[Kind, str]


MMG = "mmg3d and mmgs, the parts of Mmg that are compared, take no mesh in the plane"
CGAL = "CGAL's optimisers of Mesh_3 and its remeshing of surfaces take no mesh in the plane"
STELLAR = "Stellar takes tetrahedra only"
TETWILD = "TetWild fills a surface with tetrahedra; the mesh has none"

TOOLS: dict[str, Tool] = {
    OURS: Tool("odt-plugins", {}),
    "laplacian": Tool("Laplacian", {
        "surface": "averaging in space shrinks a surface; MeshLab and Open3D have filters for it"}),
    "gmsh": Tool("Gmsh", {
        "surface": "Gmsh moves vertices of a surface only where it has a parametrisation of it"}),
    "netgen": Tool("Netgen", {
        "planar": "Netgen optimises triangles only on a geometry of its own, not on a stored mesh",
        "surface": "Netgen optimises triangles only on a geometry of its own, not on a stored mesh",
    }),
    "mmg": Tool("Mmg", {"planar": MMG}),
    "cgal": Tool("CGAL", {"planar": CGAL}),
    "stellar": Tool("Stellar", {"planar": STELLAR, "surface": STELLAR}),
    "tetwild": Tool("TetWild", {"planar": TETWILD, "surface": TETWILD}),
    "pymeshlab": Tool("MeshLab", {"tets": "MeshLab has no tetrahedra"}),
    "open3d": Tool("Open3D", {
        "tets": "Open3D's filters smooth triangles only",
        "planar": "Open3D's filters have no vertices that stay, so the boundary would shrink"}),
}
"""Every family of contestants."""


def refusals(kind: Kind, contestants: Sequence[Contestant]) -> dict[str, tuple[str, str]]:
    """Name the families of which no contestant takes a kind of mesh.

    Returns
    -------
    dict    family -> (name of its row, why)
    """
    found = {}
    for family in dict.fromkeys(c.family for c in contestants):
        names = [c.name for c in contestants if c.family == family]
        if not any(c.family == family and kind in c.kinds for c in contestants):
            tool = TOOLS.get(family, Tool(family, {}))
            name = names[0] if len(names) == 1 else tool.name
            found[family] = name, tool.refuses.get(kind, f"does not take {KINDS[kind]}")
    return found
