"""Stage 2, finishing: descent of the summed costs of cells, phase after phase."""
