"""Stage 2, finishing: descent of the summed costs of cells, phase after phase.

F_p is the sum over all cells of ((1 + s) / (m + s))^p for a measure m of one cell. A small p
serves the mean of m, a large p the worst cells. A `Phase` is one descent of F_p with one p and
one measure, from a share of the cells, worst first; `finish_phase` alternates flips and sweeps of
Newton steps there until both gain too little. It works on whatever does the steps of the protocol
`Descending`: tetrahedra, where `reconnections` and `compound_moves` go with it if the phase asks
for them, planar triangles, where `compound_pass_2d` goes before, and curved ones in
`engine.surface`; what the last two do alike is `TriangleDescent`.

The schedule is data: `bulk` for the mean, `tail` for the worst cells, `worst_cells` for these,
small angles and the very worst cells in turn, `polish` for the few small angles that are left
(`polish_small_angles`), `repair` for cells beyond the extremes of the input, `cautious` for meshes
that the other phases spoil, and `descents` for the order. `finish` runs phases in space, `finish2d`
in the plane; `within_bounds`, one for each dimension, brings back what no phase does.
`resample_in_rounds` adds and removes vertices on request, with phases after every round.

References
----------
L. A. Freitag, C. Ollivier-Gooch, Tetrahedral mesh improvement using swapping and smoothing, Int.
J. Numer. Meth. Engng 40 (1997) 3979-4002, for flips and smoothing in turn.
B. M. Klingner, J. R. Shewchuk, Aggressive tetrahedral mesh improvement, Proc. 16th International
Meshing Roundtable (2007) 3-23, for insertion.
"""
