"""What changes a mesh in place: flips, reconnection, Newton steps, compound moves, insertion.

All moves lower the same sum over the cells, F_p = sum ((1 + s) / (m + s))^p of a measure m, so no
move undoes another one. A move is taken only if every new cell stays within the extremes of the
run.

- Flips: `remove_edge` fills the ring around an edge anew, best by dynamic programming
  (`triangulate_ring`, after Klincsek); `flip_facet` is the 2-3 flip; `flip_pass` tries them at
  all cells that wait. In the plane `lawson_flips` goes to Delaunay and `quality_flips` lowers
  F_p.
- Reconnection: up to two dozen cells around a bad one are filled anew at least cost, by branch and
  bound over all fillings between their vertices: `reconnection_pass`, `grow_polyhedron`,
  `fill_polyhedron`.
- Newton steps: x -= (H + s I)^-1 g for one vertex, halved until F_p falls: `newton_vertex` and
  `smooth_vertices` in space, `newton_step_2d` and `smooth_vertices_2d` in the plane or a tangent
  plane, `plane_step`.
- Compound moves: a flip that costs something, a descent around it, and all taken back if it did
  not pay: `compound_pass`, `descend_around` in space, `compound_pass_2d` in the plane; on a surface
  `force` and `take_back` without guards.
- Insertion and removal of vertices: `propose_vertex` grows a star-shaped cavity (`grow_cavity`),
  `propose_removal` collapses the best edge (`best_collapse`), `insertion_pass` keeps what pays by
  the share of every cell in the figures of the whole mesh (`worth_of`).

References
----------
J. Liu, B. Chen, S. Sun, Small polyhedron reconnection for mesh improvement and its implementation
based on advancing front technique, Int. J. Numer. Meth. Engng 79 (2009) 1004-1018.
L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007, Section 3.1, for
flips.
G. T. Klincsek, Minimal triangulations of polygonal domains, Ann. Discrete Math. 9 (1980) 121-123.
B. M. Klingner, J. R. Shewchuk, Aggressive tetrahedral mesh improvement, Proc. 16th International
Meshing Roundtable (2007) 3-23, for compound moves and insertion.
"""
