"""Meshes of simplices: the one type that the engine knows, surfaces, facets, numbers.

`simplex_mesh` checks arrays of points and cells and makes a `SimplexMesh`: finite coordinates,
indices in range, positive volumes, every facet with one or two cells, one on each side
(`uneven_facets`). `surface_mesh` does the same for triangles in space, `surface_edges` lists
their edges, and `plane_frame` finds the plane of triangles that lie in one. `freeze` adds cells
that must stay, `vertex_mask` reads masks and lists of indices, `compact_labels` numbers region
labels. Where vertices were added and removed, `old_numbers` and `new_numbers` go from one
numbering to the other. `same_places` finds the vertices that a soup has several times, and
`at_copies` gives the corners of new cells one of them. `CellGeometry` holds edges, normals and
determinants in numpy, for the figures that leave the package. `quantile` computes what that of
numpy does, faster. `layer_cells` finds the cells that are stretched alike with their neighbours,
and `keep_layers` freezes them; `periodic_triangles` finds opposite faces that match; `eigen` and
`logarithms` are of small symmetric matrices. `of_bodies` takes back that regions were parted.

`Faces` are lines and triangles with labels, which `followed` finds again after flips.

Source: d-simplices in R^d as in Section 2 of Chen and Holst.

References
----------
L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007, Section 2.
"""
