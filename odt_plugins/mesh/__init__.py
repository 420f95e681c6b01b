"""Meshes of simplices: the one type that the engine knows, surfaces, facets, numbers."""
