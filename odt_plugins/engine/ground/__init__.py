"""The input surface under a surface that moves, and the guards of every move.

The ground is the surface of the input (`Ground`, `make_ground`); the sheet is the surface that
lies on the ground, vertex by vertex, while it changes (`Sheet`, `make_sheet`). A move of a vertex
(`try_move`) goes x + alpha d, alpha = 1, 1/2, ..., back to the ground (`walk`,
`closest_on_triangle`), until every guard agrees; `smooth_on_ground` takes Newton steps so, by the
cells of a `Body`, whose volume has a budget (`swept_volume`, `spend`). A flip asks the same guards
(`edge_is_free`, `keeps_normals`):

- normals: the cosine between a triangle and the ground under it (`normal_cosine`);
- distance: every point of an edge or triangle within the envelope of the ground, and the ground
  under it within the envelope of the triangle (`edge_is_near`, `height_over`, `joined`);
- features: `find_features` finds edges at which the surface turns by more than an angle; their
  vertices slide along chains (`on_line`, `line_is_near`) or are locked.

`within`, `uncovered` and `distances` bound the distances of a whole surface both ways: a bound of
a triangle is certified by the triangles of the ground around it, and the triangle is cut until
the bound is sharp enough. `count_crossings` counts where a surface cuts through itself,
without rounding.

Source: the one-sided Hausdorff distance d(A, B) = max over a in A of min over b in B of |a - b|,
bounded by subdivision; nearest points by libigl, https://libigl.github.io.
"""
