"""Beyond one machine: blocks of one mesh, and batches of many meshes, here or on a Dask cluster.

- `block_engine` cuts a mesh into blocks of equal numbers of cells (`bricks`), fixes the
  rim of each (`cut_out`), improves each block with the engine (`improve`), and glues
  (`one_round`). The next rounds cut elsewhere: around the vertices that were held in every round
  yet (`seams`, `grown`). The figures of the whole come from those of its parts (`total`,
  `total`), and the result is a state that keeps the promise for the whole, at
  worst the input.
- `optimize_pieces` does the same for pieces on disk; the driver holds only their interfaces.
- `run_batch` works on many files, each in a process of its own (`run_job`); its end is a row of
  the summary (`write_summary`).

`executor` says where the work is done: in this process, in processes of this machine, or on the
workers of a Dask cluster (`connected`, `on_cluster`), whose package versions `check_workers`
compares. The bits of a result do not depend on where.

Source: alternating over overlapping subdomains, after Schwarz; bricks by recursive bisection of
coordinates.
"""
