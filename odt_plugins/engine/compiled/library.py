"""Code of a kernel and of all kernels that it calls, optimised once.

numba optimises every kernel with copies of all that it calls, writes machine code of its own for
it, and does so again in every kernel that calls it.  Here callees
are kept as code that is not optimised; the kernel that Python calls links each once, and LLVM
optimises the whole.
"""

from __future__ import annotations

from typing import Any

import llvmlite.binding as llvm
from numba.core.codegen import JITCodeLibrary


def link_once(library: Any) -> Any:
    """Give the module of a library that may be linked into several others."""
    part = isinstance(library, Part)
    return library._linked_once() if part else library._get_module_for_linking()


class Library(JITCodeLibrary):  # type: ignore[misc]
    """Code of a kernel that Python calls: takes in all that it needs, each part once."""

    def __init__(self, codegen: Any, name: str) -> None:
        super().__init__(codegen, name)
        self.enable_object_caching()

    def _optimize_functions(self, ll_module: Any) -> None:
        """Leave it to the passes over the module."""
        ll_module.data_layout = self._codegen._data_layout

    def finalize(self) -> None:
        """Take in what is called, optimise all of it, and write machine code.

        What was taken in has no other callers: LLVM leaves out the arguments that it does not use.
        """
        self._raise_if_finalized()
        for library in self.needed():
            self._final_module.link_in(link_once(library), preserve=True)
        for function in self._final_module.functions:
            if function.linkage == llvm.Linkage.linkonce_odr and not function.is_declaration:
                function.linkage = "internal"
        self._optimize_final_module()
        self._finalize_final_module()

    def _optimize_final_module(self) -> None:
        """Run LLVM's passes once.

        numba has others before them, which bring together what it counts of references: few kernels
        count any.  It leaves out vectors of a few numbers side by side, such as coordinates.
        """
        passes, builder = self._codegen._module_pass_manager(slp_vectorize=True)
        passes.run(self._final_module, builder)

    def needed(self) -> list[Any]:
        """List the libraries of all that is called, directly or not, callers before callees.

        LLVM takes in only what is called by then.
        """
        found: dict[int, Any] = {}
        waiting: list[tuple[Any, bool]] = [(library, False) for library in self._linking_libraries]
        entered = set()
        while waiting:
            library, done = waiting.pop()
            if done:
                found[id(library)] = library
            elif id(library) not in entered:
                entered.add(id(library))
                waiting.append((library, True))
                if isinstance(library, Part):
                    waiting.extend((callee, False) for callee in library._linking_libraries)
        return list(found.values())[::-1]


class Part(Library):
    """Code of a kernel that another one calls, neither optimised nor translated by itself."""

    @property
    def codegen(self) -> Any:
        """What would be told the place of the constants, which has no address yet."""
        return self

    def set_env(self, name: str, environment: Any) -> None:
        """Leave it to the kernels that take this code in."""

    def finalize(self) -> None:
        """Leave the code as it is."""
        self._raise_if_finalized()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Tell that there is nothing that Python can call."""
        self._ensure_finalized()
        return 0

    def _linked_once(self) -> Any:
        if self._shared_module is None:
            self._shared_module = self._final_module.clone()
            for function in self._shared_module.functions:
                if not function.is_declaration and function.linkage == llvm.Linkage.external:
                    function.linkage = "linkonce_odr"
        return self._shared_module

    def _get_module_for_linking(self) -> Any:
        """Give this code and all that it needs, for code that numba compiles by itself."""
        self._ensure_finalized()
        whole = self._linked_once().clone()
        for library in self.needed():
            whole.link_in(link_once(library), preserve=True)
        return whole
