"""Other sizes: vertices are added and removed until edges are as long as they are wanted.

A mesh here is its simplices of every dimension: tetrahedra with the label of their region, the
triangles of its boundary and interfaces with that of their patch, and the segments of its feature
lines. `split_edges` cuts all that hold a long edge, `collapse_edges` takes a vertex out of all that
hold it, `flip_patches` exchanges the diagonals of two triangles of a patch, `relax_surface` moves
the vertices of patches and lines. Collapses and moves ask one guard, `fits`. Rounds of these and of
ODT with rho = h^-(d + 2) follow each other, and the run of ``engine.run`` finishes. Sizes are
linear between vertices: `resolved` halves edges of the input first where they are not. Where cells
or a boundary of the input stay, `beside_whole` lets sizes fall from their edges. `spoiled_cells`
finds where of the input figures of a result fell, `gone_astray` where it left the envelope, and
`remedy` says what is tried then. Sides of a seam share their vertices for the work, by `sewn`, and
edges of a surface without length are contracted first, by `welded`; `chord_metric` bounds a metric
by what the envelope allows.

References
----------
M. Botsch, L. Kobbelt, A remeshing approach to multiresolution modeling, SGP 2004.
T. K. Dey et al., Topology preserving edge contraction, Publ. Inst. Math. 66 (1999) 23-45.
"""
