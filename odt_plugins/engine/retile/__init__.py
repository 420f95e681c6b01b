"""Triangles on their ground that come and go, until edges are as long as wanted.

One shape of operation: the triangles that are to go and those that are to come are written into a
`Room`, the guards of the ground (`may_replace`) and of the tracks (`track_is_near`) are asked, and
`exchange` does it. `split_edges`, `collapse_edges`, `swap_edges` and `shift_vertices` are the
operations, `resize` runs rounds of them.

- An edge longer than 4/3 of its size is split, one shorter than 4/5 collapses.
- Flips lower 1 / q_1 + 1 / q_2; vertices move to the mean barycentre of their stars with the weight
  rho = h^-4, on feature lines to where both edges are as long, by their sizes.
- Feature lines, rims and borders between labels are tracks: edges on them are split and collapse
  along themselves, and stay close to what they stand for.
- At the end of the first round, without a metric, tracks get like edges (`even_lines`), and the
  vertices between them give way to others in rows (`place_rows`, `lay_in_rows`): most have six
  neighbours then.
- At last the phases of stage 2 lower F_p with compound moves (`polish`).
- No new triangle is worse, further from the input, or turned more than allowed, unless one of those
  in its place is: as they are before their vertices move (`standing`).

A surface in the plane is one with z = 0, where the tracks alone keep the shape. Curved tracks are
followed so closely there that regions keep their areas (`heights`).

References
----------
M. Botsch, L. Kobbelt, A remeshing approach to multiresolution modeling, SGP (2004) 189-196, for the
thresholds; T. K. Dey et al., Topology preserving edge contraction, Publ. Inst. Math. 66 (1999)
23-45, for the link condition; S. Rebay, J. Comput. Phys. 106 (1993) 125-138, for the rows.
"""
