"""CGAL's Mesh_3 optimisers on a stored Delaunay start, whose complex is built anew."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.compare.baselines.task import NotPossibleError, Settings, Task
from odt_plugins.compare.hull import hull_facets
from odt_plugins.compare.start import StartMesh

CONVERGENCE, FREEZE = 0.02, 0.01
"""CGAL's own defaults."""


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Insert the points of the start and mark its cells and facets as those of the complex.

    Settings: `steps`, some of "odt", "lloyd", "perturb", "exude"; `iterations` of the first two.

    Raises
    ------
    NotPossibleError    the start is not Delaunay, so it is no complex of CGAL's; or it has regions,
                        which the domain of a polyhedron does not know
    """
    from CGAL import CGAL_Mesh_3 as cgal

    if start.regions is not None:
        msg = ("CGAL would need the regions in its domain; the domain made of a stored surface has "
               "one region only")
        raise NotPossibleError(msg)
    _refuse_other_than_delaunay(start)
    domain, complex_ = _complex(cgal, start)

    def call() -> None:
        for step in settings["steps"]:
            if step == "perturb":
                cgal.perturb_mesh_3(complex_, domain, 0, 0)
            elif step == "exude":
                cgal.exude_mesh_3(complex_, 0, 0)
            else:
                if step == "lloyd":
                    # Its moves on the surface read facet centres, which a complex made of stored
                    # arrays gets from a pass of odt only; without them CGAL crashes.
                    cgal.odt_optimize_mesh_3(complex_, domain, 0, 1, CONVERGENCE, 0.0)
                optimise = getattr(cgal, f"{step}_optimize_mesh_3")
                optimise(complex_, domain, 0, settings["iterations"], CONVERGENCE, FREEZE)

    return Task(call, lambda _: _arrays(complex_))


def _complex(cgal: Any, start: StartMesh) -> tuple[Any, Any]:
    from CGAL.CGAL_Kernel import Point_3, Weighted_point_3

    facets = hull_facets(start)
    surface, local = np.unique(facets, return_inverse=True)
    polyhedron = polyhedron_of(start.points[surface], local.reshape(facets.shape))
    domain = cgal.Polyhedral_mesh_domain_3(polyhedron)
    result = cgal.Mesh_3_Complex_3_in_triangulation_3()
    triangulation = result.triangulation()
    on_surface = np.zeros(len(start.points), dtype=np.bool_)
    on_surface[surface] = True
    number = {}
    for i, x in enumerate(start.points.tolist()):
        vertex = triangulation.insert(Weighted_point_3(Point_3(*x), 0.0))
        vertex.set_dimension(2 if on_surface[i] else 3)
        number[tuple(x)] = i
    wanted = {tuple(row) for row in np.sort(start.cells, axis=1).tolist()}
    for cell in triangulation.finite_cells():
        if tuple(sorted(number[place(cell.vertex(k))] for k in range(4))) in wanted:
            result.add_to_complex(cell, 1)
    if result.number_of_cells() != len(start.cells):
        msg = "CGAL's Delaunay triangulation of the points lacks some cells of the start"
        raise NotPossibleError(msg)
    make_facet = cgal.Mesh_3_regular_triangulation_3_Facet
    patch = cgal.Mesh_3_Surface_index(0, 1)
    for cell in triangulation.finite_cells():
        for k in range(4):
            if result.is_in_complex(cell) and not result.is_in_complex(cell.neighbor(k)):
                result.add_to_complex(make_facet(cell, k), patch)
    return domain, result


def polyhedron_of(points: NDArray[Any], triangles: NDArray[Any]) -> Any:
    """Make CGAL's polyhedron of a closed surface.

    Raises
    ------
    NotPossibleError    the surface is not closed, or not two-manifold
    """
    from CGAL.CGAL_Polyhedron_3 import Polyhedron_3

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "surface.off"
        with path.open("w") as file:
            file.write(f"OFF\n{len(points)} {len(triangles)} 0\n")
            np.savetxt(file, points, fmt="%.17g")
            np.savetxt(file, np.column_stack([np.full(len(triangles), 3), triangles]), fmt="%d")
        polyhedron = Polyhedron_3(str(path))
    if not polyhedron.is_closed() or polyhedron.size_of_facets() != len(triangles):
        msg = "CGAL needs a closed two-manifold surface"
        raise NotPossibleError(msg)
    return polyhedron


def _refuse_other_than_delaunay(start: StartMesh) -> None:
    from scipy.spatial import Delaunay

    found = {tuple(row) for row in np.sort(Delaunay(start.points).simplices, axis=1).tolist()}
    wanted = {tuple(row) for row in np.sort(start.cells, axis=1).tolist()}
    if not wanted <= found:
        msg = (f"CGAL optimises Delaunay complexes only; {len(wanted - found)} of {len(wanted)} "
               f"cells are not Delaunay")
        raise NotPossibleError(msg)


def place(vertex: Any) -> tuple[float, float, float]:
    """Coordinates of a vertex of CGAL's."""
    point = vertex.point()
    return point.x(), point.y(), point.z()


def _arrays(complex_: Any) -> tuple[NDArray[Any], NDArray[Any]]:
    number: dict[tuple[float, float, float], int] = {}
    rows = [[number.setdefault(place(cell.vertex(k)), len(number)) for k in range(4)]
            for cell in complex_.cells()]
    return np.array(list(number)), np.array(rows, dtype=np.int32)
