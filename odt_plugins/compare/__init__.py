"""Comparison with other tools: the same start, the same surface, one measure for everybody.

`suite` makes the start meshes; `choose` picks contestants from one table, and each stands in a
file of `compare.baselines` with one function `prepare`. `run_contestant` runs one in a process of
its own with a time limit; `compare_on` measures every result with `measure_mesh`: quality,
boundary and interfaces (`compare_boundaries`), volume, and a Poisson problem (`solve_poisson`). A
contestant that fails is a row that says so, as is a tool that takes no such mesh (`refusals`). Rows
that beat ours stay and are marked (`mark`), and `scores` counts them. `write_all` writes CSV, JSON,
one page (`to_page`), Markdown (`to_markdown`), LaTeX (`to_latex`) and BibTeX (`to_bibtex`).

`run_hard` holds the promise against hard meshes (`hard_meshes`). `run_scaling` measures how time,
memory and iterations grow: `stages_part`, `surface_part`, `forty_sweeps_part`, `multigrid_part`,
`bandwidth_part`, `threads_part`, `blocks_part`, `generation_part`.

Source: local against global methods as in Section 5.2 and Figs 7 and 8 of Chen and Holst.

References
----------
L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007, Section 5.2.
"""
