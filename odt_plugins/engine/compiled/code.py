"""A compiled kernel as what a file holds, and back."""

from __future__ import annotations

from typing import Any

import llvmlite.binding as llvm
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompileResult

from odt_plugins.engine.compiled.library import Library


class Loaded(JITCodeLibrary):  # type: ignore[misc]
    """Machine code from disk.

    What other kernels would take in is only looked at where one that calls it is compiled.
    """

    def __init__(self, codegen: Any, name: str, code: bytes, symbols: set[str], linked: bytes):
        super().__init__(codegen, name)
        self._linked = linked
        self.enable_object_caching()
        self._set_compiled_object(code)
        self._finalize_final_module()
        codegen._engine._defined_symbols |= symbols

    def _get_module_for_linking(self) -> Any:
        if self._shared_module is None:
            self._shared_module = llvm.parse_bitcode(self._linked)
        return self._shared_module


def to_disk(result: Any) -> tuple[Any, ...]:
    """Give what a file holds of a kernel that was compiled."""
    if not isinstance(result.library, Library):
        return (result._reduce(),)
    library, about = result.library, result.fndesc
    about.typemap = about.calltypes = None
    module = library._final_module
    symbols = {symbol.name for kind in (module.functions, module.global_variables)
               for symbol in kind if not symbol.is_declaration}
    code = (library.name, library._get_compiled_object(), symbols,
            library._get_module_for_linking().as_bitcode())
    # One without constants is never read, and would import the module of its function.
    read = [each for each in result._find_referenced_environments() if each.consts]
    return code, about, result.environment, result.signature, result.reload_init, read


def from_disk(context: Any, held: tuple[Any, ...]) -> Any:
    """Make a kernel of what a file holds of it; the reverse of :func:`to_disk`."""
    if len(held) == 1:
        return CompileResult._rebuild(context, *held[0])
    code, about, environment, signature, starts, environments = held
    for start in starts:
        start()
    library = Loaded(context.codegen(), *code)
    known = {
        "target_context": context, "typing_context": context.typing_context, "library": library,
        "entry_point": context.get_executable(library, about, environment), "fndesc": about,
        "environment": environment, "signature": signature, "reload_init": starts,
        "referenced_envs": environments, "objectmode": False, "lifted": (), "type_annotation": "",
    }
    for each in environments:
        library.codegen.set_env(each.env_name, each)
    return CompileResult(**dict.fromkeys(CompileResult._fields) | known)
