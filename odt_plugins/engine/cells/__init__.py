"""One simplex: its measures, their derivatives, and arrays of them.

A measure m is 1 for the regular simplex and 0 for a flat one; its cost in the sum F_p is about
m^-p (`quality_cost`). Three measures of a tetrahedron (`tet_measure`, `tet_cost`):

- the radius ratio q = 3 r / R (5.1) of inscribed and circumscribed sphere, `tet_quality`;
- the softened smallest squared sine of its dihedral angles, `tet_dihedral`, with gradient and
  Hessian of its logarithm, `dihedral_terms`;
- the cube of the mean ratio, which falls as the AMIPS energy of TetWild grows, `tet_mean_ratio`
  and `mean_ratio_terms`.

A fourth, `tet_step` with `step_terms`, is a power of the time step for which explicit dynamics is
stable on the cell; it has no best cell.

`tet_energy` is the ODT energy (2.2) of one tetrahedron, `triangle_shape` and `triangle_measure`
are the measures of a triangle. `circumcenters` (4.6), `barycenters` and `signed_volumes` treat
all cells of a mesh at once; `inside_sphere` asks whether a facet is locally Delaunay (Definition
2.1). `quality_rows`, `shape_rows` and `add_star_terms` take several tetrahedra side by side.
`Extremes` and `Bounds` are what new cells may not pass unless those they replace do
(`worse`, `keeps`).

References
----------
L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007, Sections 2, 4 and 5.
Y. Hu et al., Tetrahedral meshing in the wild, ACM TOG 37 (2018), for the AMIPS energy.
"""
