"""How kernels become machine code, and how they are spread over threads.

A kernel is a function of scalars and arrays (`Kernel`): it allocates nothing in inner loops, and
its result does not depend on the number of threads. Python calls it as machine code of one shared
library, ``kernels.so``, which is built with the package and needs neither numba nor any Python
header (``library``): ctypes gives a function numbers and the addresses of NumPy's arrays. The
library holds every kernel of ``signatures.txt`` for each level of the processor in common use, of
which NUMBA_CPU_NAME may name a lower one, and goes with the sources of all kernels (`stamp`).

``building`` makes it, by public interfaces of numba and llvmlite: a kernel is compiled once for
the types it is called with, by itself; what it calls are functions that are somewhere else. What a
kernel of the library needs is put together and optimised as a whole, once for all levels.
``odt_plugins.ahead`` does so in processes side by side, which share what they compile, and links
the library: the same bytes for any number of processes.

Where there is no such library, for types that it has not, and where a user has chosen how numba
compiles (`CHOSEN`), ``plain`` gives the same kernels to ``numba.njit``, which keeps them in a
folder of the user. With NUMBA_BOUNDSCHECK=1 every index is checked that way. Results have the same
bits.

An index counts from the start of its array: a kernel asks whether a number is negative before it
takes it for one, and no index is written as a negative number.

`thread_pool` and `run_ranges` give parts of a range to threads, cut alike for any number of them;
`worth` leaves small meshes to one.

Source: numba, https://numba.readthedocs.io; LLVM, https://llvm.org/docs/LangRef.html.
"""
