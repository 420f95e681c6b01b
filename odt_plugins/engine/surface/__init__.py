"""ODT on curved triangle meshes: vertices slide on the input surface, within an envelope.

What differs from meshes in the plane and in space stands here, the guards are those of
`engine.ground`. `run_surface` runs

- stage 1 (`smooth_surface`): `move_vertices` moves x_i to the mean centre of its star (4.13),
  (4.20) or (4.21), each centre taken in its triangle, the step in the tangent plane and back to
  the ground; `flip_edges` flips to intrinsic Delaunay: the angles opposite to an edge sum up to
  at most pi;
- stage 2 (`SurfaceDescent` in `finish_phase`): Newton steps on F_p = sum m^-p in the tangent plane
  (`smooth_on_ground`) and flips that lower F_p; compound moves (`compound_pass`), a
  flip that costs something and a descent without guards, of which only the outcome is held
  against the ground;
- the promise (`faults`): distances both ways (`measured`), folds and crossings (`outside`); where
  few places break it, what is around them goes back to the input and the rest stays (`mended`), or
  is run again.

`surface_density` makes a density from the sizes of the input; `curvature_density` makes one from
sqrt(kappa_1^2 + kappa_2^2) (`vertex_curvature`).

References
----------
L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007, Sections 3 and 4.
A. I. Bobenko, B. A. Springborn, A discrete Laplace-Beltrami operator for simplicial surfaces,
Discrete Comput. Geom. 38 (2007) 740-756, for intrinsic Delaunay.
"""
