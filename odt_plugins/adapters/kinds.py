"""Kinds of cells by meshio's names: numbers in VTK, how many nodes, and in which order.

Numbers and orders are those of VTK's `vtkCellType.h` and of the manual of Gmsh.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

VTK = {
    0: "empty", 1: "vertex", 3: "line", 5: "triangle", 7: "polygon", 8: "pixel", 9: "quad",
    10: "tetra", 12: "hexahedron", 13: "wedge", 14: "pyramid", 15: "penta_prism", 16: "hexa_prism",
    21: "line3", 22: "triangle6", 23: "quad8", 24: "tetra10", 25: "hexahedron20", 26: "wedge15",
    27: "pyramid13", 28: "quad9", 29: "hexahedron27", 30: "quad6", 31: "wedge12", 32: "wedge18",
    33: "hexahedron24", 34: "triangle7", 35: "line4", 42: "polyhedron",
    68: "VTK_LAGRANGE_CURVE", 69: "VTK_LAGRANGE_TRIANGLE", 70: "VTK_LAGRANGE_QUADRILATERAL",
    71: "VTK_LAGRANGE_TETRAHEDRON", 72: "VTK_LAGRANGE_HEXAHEDRON", 73: "VTK_LAGRANGE_WEDGE",
    74: "VTK_LAGRANGE_PYRAMID", 75: "VTK_BEZIER_CURVE", 76: "VTK_BEZIER_TRIANGLE",
    77: "VTK_BEZIER_QUADRILATERAL", 78: "VTK_BEZIER_TETRAHEDRON", 79: "VTK_BEZIER_HEXAHEDRON",
    80: "VTK_BEZIER_WEDGE", 81: "VTK_BEZIER_PYRAMID",
}
"""Names by the numbers of VTK's types."""

IN_VTK = {name: number for number, name in VTK.items()}
"""Numbers of VTK's types by names."""

WEDGE = [0, 2, 1, 3, 5, 4]
"""Order of the nodes of VTK's wedges, which are turned inside out, both ways."""

LINEAR = {"vertex": 1, "line": 2, "triangle": 3, "quad": 4, "pixel": 4, "tetra": 4, "pyramid": 5,
          "wedge": 6, "hexahedron": 8, "penta_prism": 10, "hexa_prism": 12}
"""Numbers of nodes of the cells whose names do not end with them."""

OF_GMSH = {
    "tetra10": [0, 1, 2, 3, 4, 5, 6, 7, 9, 8],
    "hexahedron20": [0, 1, 2, 3, 4, 5, 6, 7, 8, 11, 13, 9, 16, 18, 19, 17, 10, 12, 14, 15],
    "hexahedron27": [0, 1, 2, 3, 4, 5, 6, 7, 8, 11, 13, 9, 16, 18, 19, 17, 10, 12, 14, 15,
                     22, 23, 21, 24, 20, 25, 26],
    "wedge15": [0, 1, 2, 3, 4, 5, 6, 9, 7, 12, 14, 13, 8, 10, 11],
    "pyramid13": [0, 1, 2, 3, 4, 5, 8, 10, 6, 7, 9, 11, 12],
}
"""Nodes of Gmsh's elements in the order of meshio, where it is another one."""


def nodes_of(name: str) -> int | None:
    """How many nodes a cell has; None of those that may have any number."""
    digits = re.search(r"\d+$", name)
    return LINEAR.get(name) if digits is None else int(digits[0])


def from_gmsh(name: str, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Nodes (m, k) of elements of Gmsh in the order of meshio."""
    return rows[:, OF_GMSH[name]] if name in OF_GMSH else rows
