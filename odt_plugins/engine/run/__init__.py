"""From mesh to mesh: both stages in turn, the best state, the promise.

`run` takes a valid mesh and options to an `Outcome` that keeps the promise, at worst
the input; `follow_plan` in the same file reads as the algorithm:

1. `begin` numbers and scales the cells that may change, says what does not move
   (`locked_vertices`) and which shapes no new cell may pass (`extremes`): a `Work`, which all
   stages share.
2. `in_cycles` alternates stage 1 (`smooth`) and stage 2 (`settle`) until the mean settles;
   `worst_cells` follows.
3. Where the mesh stays poor or hardly a vertex may move, `finish_alone` tries stage 2 on the
   input, at last by moves of vertices alone.
4. On request `insert` adds and removes vertices.
5. `best_state` judges the remembered states as they leave, the best one first: `faults` asks
   `broken_promises` of `odt_plugins.promise` about one, and bounds with `measure_slide` how far a
   boundary slid. A boundary that is spoiled slides again with the vertices at that place left
   alone (`run_sliding`), and stays in the end.

A mesh that was cut from a larger one is told of it (`Within`). Curved surfaces take `make_start`,
`alternate`, `repaired` and `best_state` from here.

Source: the outer loop is that of Sections 3 to 5 of Chen and Holst, with the second stage added.

References
----------
L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007.
"""
