"""Meshes some of whose cells are inverted or flat: made valid with what must stay where it is.

`untangled_places` moves the free vertices: from `harmonic` places, or those of the input where
fewer cells are inverted there, `lbfgs` lowers the regularised distortion of all cells
(`Distortion`), whose eps follows the worst cell down to 0. First the vertices around the inverted
cells move, at last all of them. What no places mend is `reconnected` by flips, or filled anew
around `inserted` vertices, and placed again; `untangled` does all of this.

References
----------
V. Garanzha, I. Kaporin, L. Kudryavtseva, F. Protais, N. Ray, D. Sokolov, Foldover-free maps in 50
lines of code, ACM Trans. Graph. 40 (2021), doi:10.1145/3450626.3459847.
"""
