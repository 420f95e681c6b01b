"""Stage 1, Optimal Delaunay Triangulation: energy, gradient, sweeps, global step, Delaunay."""
