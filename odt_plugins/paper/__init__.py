"""Forms and loops of Chen and Holst that only the reproduction of their paper calls.

- Energy: `energy_by_stars` is (4.2), `energy_by_patches` (4.14), `energy_p1` (4.9) with a linear
  density, `energy_tilde_p1` (4.15), `lower_bounds` (2.7) to (2.9) with `energy_constant`. The
  form of the engine is `energy` of `engine.odt.energy`, (2.2).
- Gradient: `gradient_by_norms` is (4.3), `gradient_by_edges` (4.4), `gradient_p1` (4.10),
  `approximate_gradient` (4.19) and (4.23); `optimality_residual` measures (4.7).
- Loops: `iterate` runs the loop of Section 5 or of Section 5.2 as printed, `flip_once` is its
  pass of flips.

The tests hold these forms against each other and against differences of the energy; the scripts
of `examples/paper` reach the figures of the paper with them.

References
----------
L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007.
"""
