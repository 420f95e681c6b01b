"""How kernels are compiled, kept on disk and spread over threads.

A kernel is a function of scalars and arrays that numba compiles (`Kernel`): it holds no lock of
Python, allocates nothing in inner loops, and its result does not depend on the number of threads.
A call goes by the types of its arguments to machine code (`function_of`), which needs neither
numba's modules nor the third of a second that they take to import.  It is kept on disk
(`load`, `save`) under a name with the hash of the sources of all kernels (`source_stamp`), so that
no kernel runs with the code of an older one that it calls. What usual runs need is compiled while
the package is installed (`AHEAD`, `common_machine`; `odt_plugins.ahead` says what that is): a run
only loads it. Everything else is compiled by the first run that needs it (`compile_whole`) and kept
for the next.
`thread_pool` and `run_ranges` give parts of a range to threads, cut alike for any number
of them; `worth` leaves small meshes to one.

numba's front end runs without the passes that no kernel needs (`compiler_for`).  A kernel that
another one calls is typed once and has no machine code there: the code of all that a kernel needs
is put together and optimised once, where Python calls it (`Library`).  An index that is no literal
counts from the start of its array (`from_start`): a kernel asks whether a number is negative before
it takes it for one.  With NUMBA_BOUNDSCHECK=1 every index is checked, by kernels compiled for that.

Source: numba, https://numba.readthedocs.io.
"""
