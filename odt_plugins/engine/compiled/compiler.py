"""From the source of a kernel to its machine code: numba's compiler without what no kernel needs.

Kernels have no closures, generators, object mode or parallel loops: the passes that look for them,
and what numba tells listeners about each pass, are left out.  What a call of a function of the
language or of numba has for a type is looked up once for the same types of arguments.  Indices
count from the start of an array: none is tested for being negative, as numba's own are.
"""

from __future__ import annotations

import operator
import os
from collections.abc import Callable
from functools import cache, partial
from types import BuiltinFunctionType
from typing import Any

from numba import config, njit, typeof
from numba.core import typed_passes, types, untyped_passes
from numba.core.compiler import Compiler
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import PassManager, _pass_registry
from numba.core.cpu import CPUTargetOptions
from numba.core.postproc import PostProcessor
from numba.core.sigutils import normalize_signature
from numba.core.typing.context import Context

from odt_plugins.engine.compiled.library import Library, Part
from odt_plugins.engine.compiled.machine import MachineCode, tried

COMMON: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
"""What numba is told of every kernel."""

PASSES = (
    untyped_passes.TranslateByteCode,
    untyped_passes.FixupArgs,
    untyped_passes.IRProcessing,
    untyped_passes.RewriteSemanticConstants,
    untyped_passes.DeadBranchPrune,
    untyped_passes.GenericRewrites,
    untyped_passes.ReconstructSSA,
    typed_passes.NopythonTypeInference,
    typed_passes.PreLowerStripPhis,
    typed_passes.NopythonRewrites,
    typed_passes.IRLegalization,
    typed_passes.NativeLowering,
    typed_passes.NoPythonBackend,
)
"""What turns a kernel into code, in order."""


def from_start(array: Any, index: Any) -> Any:
    """Type of an index as numbers without a sign, which numba takes as they are.

    It takes others from the end where they are negative, and so tests each: slices, and indices of
    which one part is a negative literal.
    """
    parts: Any = index if isinstance(index, types.BaseTuple) else (index,)
    if not isinstance(array, types.Array) or not all(map(_counts, parts)):
        return index
    return types.UniTuple(types.uintp, len(parts)) if parts is index else types.uintp


def _counts(index: Any) -> bool:
    """Whether a number can be the place of an element, counted from the start."""
    return isinstance(index, types.Integer) and getattr(index, "literal_value", 0) >= 0


class Knowing(Context):  # type: ignore[misc]
    """What numba knows of types, and has found out about calls before.

    All is numba's own and stays one with it, so that the two count as the same.
    """

    def __init__(self, context: Context) -> None:
        self.__dict__ = context.__dict__
        self._context = context
        self._calls: dict[Any, Any] = {}

    def __eq__(self, other: object) -> bool:
        return other is self or other is self._context

    def __hash__(self) -> int:
        return hash(self._context)

    def resolve_function_type(self, func: Any, args: Any, kws: Any) -> Any:
        """Find the signature of a call of a function of the language or of numba."""
        if kws or not isinstance(func, types.Function | BuiltinFunctionType):
            return super().resolve_function_type(func, args, kws)
        if func is operator.getitem:
            args = args[0], from_start(*args)
        key = func, tuple(args)
        known = self._calls.get(key)
        if known is None:
            known = super().resolve_function_type(func, args, kws)
            self._calls[key] = known
        return known

    def resolve_setitem(self, target: Any, index: Any, value: Any) -> Any:
        """Find the signature of a write to an array."""
        return super().resolve_setitem(target, from_start(target, index), value)


@cache
def knowing(context: Context) -> Knowing:
    """Give what is known beside a context of numba."""
    return Knowing(context)


class Passes(PassManager):  # type: ignore[misc]
    """The passes of a kernel."""

    def run(self, state: Any) -> None:
        """Run them over a kernel."""
        for kind, _ in self.passes:
            step = _pass_registry.get(kind).pass_inst
            step.analysis = self._analysis
            step.run_initialization(state)
            step.run_pass(state)
            step.run_finalizer(state)
            if kind is untyped_passes.DeadBranchPrune:
                PostProcessor(state.func_ir).run()


@cache
def compiler_for(kind: type[Library]) -> type[Compiler]:
    """Make numba's compiler for one kind of library."""

    class KernelCompiler(Compiler):  # type: ignore[misc]
        def compile_extra(self, func: Callable[..., Any]) -> Any:
            self.state.library = kind(self.state.targetctx.codegen(), func.__qualname__)
            self.state.typingctx = knowing(self.state.typingctx)
            self.state.type_annotation = ""
            return super().compile_extra(func)

        def define_pipelines(self) -> list[PassManager]:
            passes = Passes("kernel")
            for step in PASSES:
                passes.add_pass(step)
            passes.finalize()
            return [passes]

    return KernelCompiler


def _options(kind: type[Library], options: dict[str, Any]) -> dict[str, Any]:
    """What numba is told of a kernel that becomes one kind of library."""
    known = {name: value for name, value in options.items() if hasattr(CPUTargetOptions, name)}
    return COMMON | known | ({"pipeline_class": compiler_for(kind)} if tried() else {})


def compile_whole(function: Callable[..., Any], options: dict[str, Any], args: Any) -> MachineCode:
    """Compile a kernel that Python calls, with all that it calls.

    Parameters
    ----------
    function : callable
    options : dict          what numba is told of it
    args : sequence         arguments of the types that it is compiled for
    """
    dispatcher: Any = njit(**_options(Library, options))(function)
    dispatcher.compile(tuple(map(typeof, args)))
    (result,) = dispatcher.overloads.values()
    library = result.library
    # One without constants is never read, but for that of the entry.
    used = [each for each in result._find_referenced_environments() if each.consts]
    constants = {each.env_name: list(each.consts) for each in (result.environment, *used)}
    needs = (each.name for each in library._final_module.functions if each.is_declaration)
    # A file of numba's may say otherwise, of which the names on disk know nothing.
    settings: Any = config
    ours = settings.CPU_NAME == (os.environ.get("NUMBA_CPU_NAME") or None)
    ours &= not settings.BOUNDSCHECK or "NUMBA_BOUNDSCHECK" in os.environ
    return MachineCode(
        library._get_compiled_object(), result.fndesc.llvm_cpython_wrapper_name, constants,
        tuple(name for name in needs if not name.startswith("llvm.")),
        ours and not library.has_dynamic_globals and not function.__closure__)


def part(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    """Give what numba compiles where a kernel calls another one.

    Parameters
    ----------
    function : callable
    options : dict          what numba is told of it
    """
    dispatcher: Any = njit(**_options(Part, options | {"no_cpython_wrapper": True}))(function)
    if tried():
        dispatcher.compile = partial(_compile_part, dispatcher)
    return dispatcher


def _compile_part(dispatcher: Any, signature: Any) -> Any:
    """Compile a kernel that only kernels call, where it is not for these types of arguments."""
    with global_compiler_lock:
        args, returned = normalize_signature(signature)
        known = dispatcher.overloads.get(tuple(args))
        if known is None:
            with dispatcher._compiling_counter:
                known = dispatcher._compiler.compile(args, returned)
            dispatcher.add_overload(known)
        return known.entry_point
