"""From mesh to mesh: both stages in turn, the best state, the promise.

`run` takes a valid mesh and options to an `Outcome` that keeps the promise, at worst the input:

1. `make_start` numbers and scales the cells that may change, `locked_vertices` says what does not
   move, `extremes` which shapes no new cell may pass.
2. `run_cycles` alternates stage 1 (`smooth`) and stage 2 (`settle`) until the mean settles
   (`alternate`, `settled`), then improves the worst cells.
3. Where the mesh stays poor or hardly a vertex may move, `finish_alone` tries stage 2 on the
   input, at last by moves of vertices alone.
4. On request `resample_in_rounds` adds and removes vertices.
5. `best_state` judges the remembered states as they leave, the best one first: `faults` asks
   `broken_promises` of `odt_plugins.promise` about one, and bounds with `measure_slide` how far a
   boundary slid. A boundary that is spoiled slides again with the
   vertices at that place left alone (`cut_vertices`), and stays in the end.

A mesh that was cut from a larger one is told of it (`Within`). Curved surfaces take `make_start`,
`alternate`, `repaired` and `best_state` from here.

Source: the outer loop is that of Sections 3 to 5 of Chen and Holst, with the second stage added.

References
----------
L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007.
"""
