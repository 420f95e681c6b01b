"""Who touches whom: stars, adjacency, colours, numbering, and the mesh while it changes.

- The star omega_i of a vertex is the set of its cells: `vertex_stars`, `star_sum` and
  `star_average`, which computes sum_tau w_tau c_tau / sum_tau w_tau.
- `cell_neighbors` finds the cell across every facet.
- `Complex` (`make_complex`) is the mesh while flips change it: cells in slots, adjacency, and
  which cells wait for a flip.
- `make_frame` numbers vertices along a Morton curve (`curve_order`), leaves frozen cells out, and
  scales the mesh to unit size by a power of two.
- `vertex_coloring` colours blocks of vertices: blocks of one colour have no cell in common, and a
  Gauss-Seidel sweep visits them side by side (`run_chunks`). `make_slabs` and `side_by_side` do
  the same for flips.
- `grown_along` bounds values by those of the vertices around: they grow along edges at a rate.
- `overlaps` integrates over what cells of one mesh have in common with those of another.
- `Part` is a part of a mesh that is worked on alone (`away_from`, `around`, `joined`).
- `Topology` (`make_topology`) is what a position step needs, built once for a connectivity.

Source: G. M. Morton, A computer oriented geodetic data base, IBM (1966), for the curve; Section
4.1 of Chen and Holst (below) for the order of Gauss-Seidel.

References
----------
L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007, Section 4.1.
"""
