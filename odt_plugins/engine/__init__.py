"""The engine: arrays in, arrays out; no toolkit is known here.

A mesh walks through the rooms of this package in this order:

1. `engine.topology` numbers the mesh along a curve, scales the mesh to unit size (`make_frame`),
   and builds its adjacency (`make_complex`).
2. `engine.odt` lowers the ODT energy (1.1) by position steps and flips (`smooth`): stage 1.
3. `engine.finish` lowers F_p, the sum of q^-p over the cells, by the moves of `engine.moves`
   (`finish`): stage 2. Where the boundary may move, `engine.sliding` moves it over the input
   surface that `engine.ground` keeps.
4. `engine.record` remembers the best state (`Memory`).
5. `engine.run` runs the stages in cycles and asks `odt_plugins.promise` about the result (`run`,
   `follow_plan`).

`engine.surface` walks curved triangle meshes through its own form of the stages (`run_surface`).
`engine.cells` measures one cell, and `engine.compiled` compiles the kernels; `engine.policy` holds
the numbers that decide when a stage begins and ends. Each room imports
only the rooms before it: compiled, topology, cells, record, moves, ground, odt, sliding, finish,
run, surface.

References
----------
L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007.
"""
