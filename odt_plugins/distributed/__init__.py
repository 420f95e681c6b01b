"""Beyond one machine: blocks of one mesh, and batches of many meshes, here or on a Dask cluster."""
