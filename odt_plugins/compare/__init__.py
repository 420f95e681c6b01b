"""Comparison with other tools: the same start, the same surface, one measure for everybody."""
