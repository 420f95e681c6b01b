"""Stage 1, Optimal Delaunay Triangulation.

The energy of a mesh is the interpolation error of u = |x|^2, E = int |u_I - u| rho (1.1), which
is 1/((d + 1)(d + 2)) sum over cells tau of rho_tau |tau| times the sum of the squared edges of
tau (2.2). `smooth` alternates two steps towards lower E:

- connectivity (Section 3): `exchange` puts pieces of scipy's Delaunay triangulation in
  (`delaunay_exchange`), `local_flips` flips facets that are not locally Delaunay
  (`non_delaunay_facets`);
- positions (Section 4): `position_step` chooses among `gauss_seidel_sweep` and `jacobi_sweep`,
  which move x_i to sum |tau|_rho c_tau / sum |tau|_rho, c_tau circumcenters for ODT (4.13) or
  barycenters for CPT (4.20); `global_step`, p - alpha A^-1 grad E with a graph Laplacian A
  (4.27); `richardson_step`, p - alpha grad E (Section 4.1.1); `lbfgs_step`; and `cvt_step`,
  Lloyd's step, to compare (Remark 4.8).

`energy` is (2.2), `gradient` (4.5) and (4.11), `hessian_diagonal` (4.8). `make_density` makes rho
= h^-r of the sizes h of the input, or another density. `solve_amg` solves with A by conjugate
gradients and smoothed aggregation (Section 4.3).

References
----------
L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007.
"""
