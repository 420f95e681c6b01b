"""One simplex: its measures, their derivatives, and arrays of them.

A measure m is 1 for the regular simplex and 0 for a flat one; its cost in the sum F_p is about
m^-p (`quality_cost`). Value, gradient and Hessian of all stand in one table, ``measures``, which
everybody calls: `tet_measure`, `tet_cost`, `star_terms` of tetrahedra, `triangle_measure`,
`star_terms_2d` of triangles in the plane and in tangent planes. Its measures are

- the radius ratio q = d r / R (5.1) of inscribed and circumscribed sphere, `tet_quality`;
- the softened smallest squared sine of the (dihedral) angles, `tet_dihedral`;
- a power of the mean ratio, which falls as the AMIPS energy of TetWild grows, `tet_mean_ratio`;
- a power of the time step for which explicit dynamics is stable on the cell, `tet_step`, which
  has no best cell.

They are functions of the edges of a cell as they are seen through a metric, if there is one
(`seen_edges`, `squares`, `moving_triangle`, and `gather_edges` for several cells side by side; see
``metric``). `tet_energy` is the ODT energy (2.2) of one tetrahedron.
`circumcenters` (4.6), `barycenters` and `signed_volumes` treat all cells of a mesh at once;
`inside_sphere` asks whether a facet is locally Delaunay (Definition 2.1). `Extremes` and `Bounds`
are what new cells may not pass unless those they replace do (`worse`, `keeps`).

References
----------
L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007, Sections 2, 4 and 5.
Y. Hu et al., Tetrahedral meshing in the wild, ACM TOG 37 (2018), for the AMIPS energy.
"""
