"""From the caller's mesh to the engine, and back with all that is on it.

`run_engine` (in ``roundtrip``) reads as the way: an adapter takes arrays out of an object; what the
engine does not see is laid aside (``aside``, ``curved``), inverted cells are untangled
(``untangling``), an envelope around another mesh becomes one around this (``reference``); the
engine runs; and `follow` (in ``following``) gives arrays, sets and facets to the cells and vertices
that are there now.

``sources`` finds the cells of the input from which new cells and vertices take their data.
``conserve`` gives arrays the integrals that they had, and ``integrals`` tells by how much integrals
changed. ``textures`` finds where triangles lie on those of the input. ``bending`` puts nodes on
curved facets, ``onto`` on the geometry of a model. ``transfer`` carries arrays of the caller's own.

Source of integrals: P. E. Farrell et al., Conservative interpolation between unstructured meshes
via supermesh construction, CMAME 198 (2009) 2632-2642.
"""
