"""What a run remembers and tells: figures of a state, best states, progress.

`figures` computes the named figures of a mesh by kernels: least, 1 % and mean radius ratio, and
the extreme angles as cosines (`Figures`; `cell_shapes` for every cell). `Memory` keeps the best
state whose figures in `keep` are no worse than those of the input, and the last state that lost
one, for the report. `until_insertion` and `in_turn` give the stages of a run, and runs that follow
each other, their part of the caller's `progress`. The figures that leave the package come from
`odt_plugins.figures` instead, which shares no code with this room.

Source: the radius ratio is (5.1) of Chen and Holst.

References
----------
L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007, Section 5.
"""
