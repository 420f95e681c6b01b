"""Comparison with other tools: the same start, the same surface, one measure for everybody.

`suite` makes the start meshes; `choose` picks contestants from one table, and each stands in a
file of `compare.baselines` with one function `prepare`. `run_contestant` runs one in a process of
its own with a time limit; `compare_on` measures every result with `measure_mesh`: quality,
boundary and interfaces (`compare_boundaries`), volume, and a Poisson problem (`solve_poisson`). A
contestant that fails is a row that says so, as is a tool that takes no such mesh (`refusals`). Rows
that beat ours stay and are marked (`mark`), and `scores` counts them. `write_all` writes CSV, JSON,
one page (`to_page`), Markdown (`to_markdown`), LaTeX (`to_latex`) and BibTeX (`to_bibtex`).

Source: each tool is cited in ``templates/comparison.bib``.
"""
