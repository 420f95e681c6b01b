"""The boundary of a tetrahedral mesh on its way along the input surface.

`make_skin` lays the boundary out as a sheet on its ground (`engine.ground`). `slide` moves its
vertices by `smooth_on_ground`: a Newton step on F_p, the sum of the costs of the tetrahedra
around the vertex, in the tangent plane of the ground; the change of the volume stays within a
budget that the vertices share (`affordable`). `flip_skin` flips edges
of the boundary together with the tetrahedra of the open ring around the edge (`flip_boundary`,
`walk_open_ring`). Both ask the guards of `engine.ground` and the extremes of the run.
`measure_slide` of `engine.run` bounds the distances of the result from the input, both ways.

Source: the Newton step is that of `engine.moves`, restricted to two directions.
"""
