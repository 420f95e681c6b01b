"""One file per toolkit; each imports its toolkit only when it is called.

An adapter is a module with three functions (`Adapter` of `adapters.host`): `matches` says whether
an object is its own, by the names of its classes alone (`is_instance`); `read` takes the arrays
out of the object as a `HostMesh`; `write` copies the object and puts a `Result` into the copy.
`find_adapter` asks the adapters of the table in `adapters.registry` from top to bottom.

`protect` keeps cells sound that lie beside the optimised ones, `with_mid_nodes` carries cells of
higher order, `carried` the texture coordinates of wedges, `renewed` computes normals anew.
`read_file` and `write_file` read and write files through meshio; a file appears only when it is
complete. The module docstring of each adapter says what survives and what is lost.

Source: the form follows narwhals, https://github.com/narwhals-dev/narwhals: one door in and out,
and no toolkit is imported to recognise an object.
"""
