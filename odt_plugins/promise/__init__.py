"""The promise: what every output must keep, checked in numpy alone.

`broken_promises` compares a result with its input and returns one sentence for each part of the
promise that does not hold: positive volumes, finite coordinates, vertices that must stay bit for
bit (`held_vertices`), boundary and interface facets with their labels (`locked_facets`), a
conforming mesh (`facet_census`), the volume of every region, and the figures in `keep`
(`worse_figures`). `broken_surface_promises` does the same for curved surfaces: topology, rims,
feature lines, folds (`new_folds`); the distances are measured by `engine.ground`.
`broken_by_remeshing` and `broken_by_retiling` look at meshes whose boundary has other vertices, and
`broken_lines` at lines with labels. Crossings that the input does not have are found by
`engine.surface.judge` in every run.

This room shares no code with the engine: its determinants and its facets are its own, so that a
fault there cannot hide itself here.
"""
