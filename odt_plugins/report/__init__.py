"""What is told about a run: figures before and after, what binds, pictures.

`make_report` measures input and result from outside (`odt_plugins.figures`) and makes a `Report`:
the figures, histograms of the radius ratio in 50 bins (`histogram`), energy, times, counts, and
why an earlier state was returned. `binding_cells` names the cells that bind the minimum and why
each stays; `best_quality_on` computes the largest radius ratio that a tetrahedron on a given
boundary triangle can have. `plot_report` draws histograms and energy, `plot_before_after` a mesh
cut open (`paint_mesh`); matplotlib is imported only there. `describe` tells what a run was
made on, and `fill_template` fills the templates of pages.

Source: histograms and energies as in Figs 5, 6 and 10 of Chen and Holst.

References
----------
L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007, Section 5.
"""
