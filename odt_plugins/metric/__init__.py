"""Metrics: what size and what shape cells should have, at every vertex.

A metric is a symmetric positive definite tensor M for every vertex; an edge e has the length
sqrt(e^T M e) in it, and cells should be regular with edges of length 1. M = h^-2 I is the size h.
Arrays are (n, d, d), or packed in the order of MEDIT, see :mod:`odt_plugins.engine.cells.tensors`,
where their arithmetic stands.

`metric_at_vertices` reads what a caller gives and refuses what is no metric; `implied_metric` is
the one that a mesh has; `grown_metric` and `bounded_metric` limit growth and anisotropy;
`recovered_hessians` are the second derivatives of a field, of which `hessians_to_metric` makes one.

References: A. Loseille, F. Alauzet, Continuous mesh framework, SIAM J. Numer. Anal. 49 (2011)
38-86; F. Alauzet, Size gradation control of anisotropic meshes, Finite Elem. Anal. Des. 46 (2010)
181-202.
"""
