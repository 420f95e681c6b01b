"""Who touches whom: stars, adjacency, colours, numbering, and the mesh while it changes."""
