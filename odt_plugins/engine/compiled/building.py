"""From the sources of kernels to the code of a library: what happens where the package is built.

Every kernel becomes code of LLVM by itself (`Units.unit`), and calls others as functions that are
somewhere else.  It lies in a folder, from which all processes take it that build a library.  What a
kernel needs that Python calls is put together and optimised as a whole, then made for each level of
the processor (`Units.machine_code`).
"""

from __future__ import annotations

import ast
import inspect
import os
import pickle
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from llvmlite import ir
from numba import cfunc, njit, types  # type: ignore[attr-defined]
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable

from odt_plugins.engine.compiled.kernel import Kernel

LEVELS = {"x86_64": ("x86-64-v2", "x86-64-v3")}
"""Processors that many share, by LLVM's name, the better last; elsewhere "generic" alone."""

NUMBERS = {"int64": types.int64, "float64": types.float64, "bool": types.boolean}
"""Types of numbers as a library spells them."""

WORD = ir.IntType(64)
"""What a slot holds."""

RESULTS = (types.Boolean, "bool"), (types.Integer, "int64"), (types.Float, "float64")
"""As what a library returns numbers."""

COUNTED = re.compile(r"^ *(?:tail )?call void @NRT_(?:in|de)cref\(.*\n", re.MULTILINE)
"""Where IR counts references to an array."""

WRAPPER = re.compile(r'^define [^@]*@"?(cfunc\.[^"(]+)"?\(', re.MULTILINE)
"""Where IR has the function that takes a kernel's arguments as they are."""

CALLED = re.compile(r'^declare [^@]*@"?(unit\.\w+)"?\(', re.MULTILINE)
"""Where IR refers to such a function of another kernel, by the name that it has here."""

APART = re.compile(r"^(attributes #\d+ = \{[^}]*)\bnoinline\b", re.MULTILINE)
"""Where IR forbids that a function becomes part of its caller."""

FROM_END = re.compile(
    r"^ *(%\S+) = icmp slt i64 (%\S+), 0\n"
    r" *(%\S+) = add i64 \2, \S+\n"
    r" *(%\S+) = select i1 \1, i64 \3, i64 \2\n", re.MULTILINE)
"""Where IR takes a negative index for one that counts from the end of an array."""

RAISING = re.compile(
    r'^declare (.*?)(ptr|void|i\d+) @"?((?:numba_|Py|NRT_Free)\w*)"?(\(.*\)).*$', re.MULTILINE)
"""Where IR declares a function by which numba raises exceptions in Python."""

RUNTIME = """
@full = private constant [40 x i8] c"odt_plugins: no memory left for kernels\\00"
declare ptr @malloc(i64)
declare void @free(ptr)
declare void @perror(ptr)
declare void @abort()
define ptr @NRT_MemInfo_alloc_aligned(i64 %size, i32 %align) {
  %all = add i64 %size, 128
  %held = call ptr @malloc(i64 %all)
  %none = icmp eq ptr %held, null
  br i1 %none, label %failed, label %got
failed:
  call void @perror(ptr @full)
  call void @abort()
  unreachable
got:
  store i64 1, ptr %held
  %number = ptrtoint ptr %held to i64
  %beyond = add i64 %number, 127
  %even = and i64 %beyond, -64
  %data = inttoptr i64 %even to ptr
  %place = getelementptr {i64, ptr, ptr, ptr, i64}, ptr %held, i32 0, i32 3
  store ptr %data, ptr %place
  %length = getelementptr {i64, ptr, ptr, ptr, i64}, ptr %held, i32 0, i32 4
  store i64 %size, ptr %length
  ret ptr %held
}
define void @NRT_MemInfo_call_dtor(ptr %held) {
  call void @free(ptr %held)
  ret void
}
"""
"""Arrays that a kernel makes, as numba's code expects them: how often they are referred to, where
they lie and how long they are, then the array itself, on a line of the cache.  They are scratch of
a few thousand numbers; a process that has no memory for them ends."""

ASKS = """
define i32 @odt_level() {
  %one = call {i32, i32, i32, i32} asm "cpuid", "={ax},={bx},={cx},={dx},{ax},{cx}"(i32 1, i32 0)
  %c1 = extractvalue {i32, i32, i32, i32} %one, 2
  %older = and i32 %c1, 9970177
  %is_v2 = icmp eq i32 %older, 9970177
  br i1 %is_v2, label %v2, label %v1
v1:
  ret i32 0
v2:
  %newer = and i32 %c1, 943722496
  %may_be_v3 = icmp eq i32 %newer, 943722496
  br i1 %may_be_v3, label %ask, label %only_v2
only_v2:
  ret i32 1
ask:
  %seven = call {i32, i32, i32, i32} asm "cpuid", "={ax},={bx},={cx},={dx},{ax},{cx}"(i32 7, i32 0)
  %b7 = extractvalue {i32, i32, i32, i32} %seven, 1
  %far = call {i32, i32, i32, i32} asm "cpuid", "={ax},={bx},={cx},={dx},{ax},{cx}"(
    i32 -2147483647, i32 0)
  %c8 = extractvalue {i32, i32, i32, i32} %far, 2
  %system = call {i32, i32} asm "xgetbv", "={ax},={dx},{cx}"(i32 0)
  %saved = extractvalue {i32, i32} %system, 0
  %b7_has = and i32 %b7, 296
  %c8_has = and i32 %c8, 32
  %keeps = and i32 %saved, 6
  %b7_fits = icmp eq i32 %b7_has, 296
  %c8_fits = icmp eq i32 %c8_has, 32
  %keeps_all = icmp eq i32 %keeps, 6
  %both = and i1 %b7_fits, %c8_fits
  %is_v3 = and i1 %both, %keeps_all
  %more = zext i1 %is_v3 to i32
  %level = add i32 %more, 1
  ret i32 %level
}
"""
"""Best level of this processor: SSE3, SSSE3, CX16, SSE4.1, SSE4.2 and POPCNT make v2, and FMA,
MOVBE, OSXSAVE, AVX, F16C, BMI, AVX2, BMI2, LZCNT and a system that saves their registers v3.

Source: Intel 64 and IA-32 Architectures Software Developer's Manual, volume 2, CPUID."""


def named(name: ast.expr) -> Any:
    """Give what a dotted name stands for."""
    module, _, last = ast.unparse(name).rpartition(".")
    return getattr(import_module(module), last)


class Held(types.Array):
    """Array that whoever calls a kernel keeps alive, so that numba counts no references to it."""


@register_model(Held)
class HeldModel(models.StructModel):
    """Lay out such an array: as numba does others, but that what keeps them is a mere address."""

    def __init__(self, manager: Any, kind: Any) -> None:
        lengths = types.UniTuple(types.intp, kind.ndim)
        super().__init__(manager, kind, [
            ("meminfo", types.voidptr), ("parent", types.pyobject), ("nitems", types.intp),
            ("itemsize", types.intp), ("data", types.CPointer(kind.dtype)), ("shape", lengths),
            ("strides", lengths)])

    def traverse(self, builder: Any) -> list[Any]:
        """Nothing within is counted."""
        return []


class Slots:
    """Code that reads the arguments of an entry from its slots, in turn, and leaves results there.

    Parameters
    ----------
    context, builder    numba's and LLVM's, of the code of the entry
    words               address of the slots; the first holds the length of the head of an object
    """

    def __init__(self, context: Any, builder: Any, words: Any) -> None:
        self.context, self.builder, self.count = context, builder, 1
        self.words = builder.bitcast(words, WORD.as_pointer())

    def word(self, words: Any, place: int) -> Any:
        """Read a number from those at an address."""
        return self.builder.load(self.builder.gep(words, [WORD(place)]))

    def words_at(self, number: Any) -> Any:
        """Give the numbers that lie where a number says."""
        return self.builder.inttoptr(number, WORD.as_pointer())

    def read(self, kind: Any) -> Any:
        """Read an argument."""
        made, inner = self.context.get_value_type(kind), getattr(kind, "types", None)
        if inner is not None:
            return self.struct(made, map(self.read, inner))
        word, self.count = self.word(self.words, self.count), self.count + 1
        if isinstance(kind, Held):
            return self.array(kind, word)
        if kind is types.boolean:
            return self.builder.icmp_unsigned("!=", word, WORD(0))
        return self.builder.bitcast(word, made)

    def array(self, kind: Any, number: Any) -> Any:
        """Array by the place where NumPy's object lies: after its head place, axes, shape."""
        builder = self.builder
        held = self.words_at(builder.add(number, self.word(self.words, 0)))
        shape = [self.word(self.words_at(self.word(held, 2)), axis) for axis in range(kind.ndim)]
        strides = [WORD(np.dtype(str(kind.dtype)).itemsize)]
        for length in reversed(shape):
            strides.insert(0, builder.mul(strides[0], length))
        item, count = strides[-1], builder.udiv(strides[0], strides[-1])
        made = self.context.get_value_type(kind)
        nothing, data = (made.elements[place](None) for place in (0, 1)), self.word(held, 0)
        return self.struct(made, [
            *nothing, count, item, builder.inttoptr(data, made.elements[4]),
            self.struct(made.elements[5], shape), self.struct(made.elements[6], strides[1:])])

    def struct(self, kind: Any, values: Iterable[Any]) -> Any:
        """Put values together."""
        whole = ir.Constant(kind, ir.Undefined)
        for place, value in enumerate(values):
            whole = self.builder.insert_value(whole, value, place)
        return whole

    def keep(self, place: int, kind: str, value: Any) -> None:
        """Leave a result."""
        held = self.builder.gep(self.words, [WORD(place)])
        if kind == "float64":
            held = self.builder.bitcast(held, value.type.as_pointer())
        elif value.type.width < WORD.width:
            value = self.builder.zext(value, WORD)
        self.builder.store(value, held)


def kind_of(spelled: ast.expr) -> Any:
    """Type of an argument for numba, by the way that a library spells types."""
    if isinstance(spelled, ast.Call):
        kinds = tuple(map(kind_of, spelled.args))
        name = ast.unparse(spelled.func)
        return types.Tuple(kinds) if name == "tuple" else (
            types.BaseTuple.from_types(kinds, named(spelled.func)))
    if not isinstance(spelled, ast.Subscript):
        return NUMBERS[ast.unparse(spelled)]
    name, axes = np.dtype(ast.unparse(spelled.value)).name, int(ast.unparse(spelled.slice))
    return Held(NUMBERS.get(name) or getattr(types, name), axes, "C")


def name_of(kernel: Kernel, args: Sequence[Any]) -> str:
    """Name in IR of a kernel compiled for some types, the same in all processes."""
    def told(kind: Any) -> str:
        return f"{getattr(kind, 'instance_class', None)} {kind}" + "".join(
            map(told, getattr(kind, "types", ())))

    text = " ".join(
        [kernel.py_func.__module__, kernel.py_func.__qualname__, *map(told, args)])
    return f"unit.{sha256(text.encode()).hexdigest()[:16]}"


def wide(kind: Any) -> Any:
    """Type as which a kernel takes a number: those of four bytes become ones of eight."""
    return types.int64 if types.unliteral(kind) is types.int32 else types.unliteral(kind)


class Units:
    """Kernels as IR, each compiled once for some types of arguments.

    Parameters
    ----------
    folder : path    holds what is compiled, for other processes as well
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._parts: dict[str, tuple[bytes, list[str]]] = {}
        self._known: dict[Any, tuple[str, Any]] = {}
        self._told: set[Kernel] = set()

    def tell(self) -> None:
        """Tell numba how kernels call the kernels of all modules that are imported."""
        for module in tuple(sys.modules.values()):
            for value in tuple(getattr(module, "__dict__", {}).values()):
                if isinstance(value, Kernel) and value not in self._told:
                    self._told.add(value)
                    self._tell(value)

    def _tell(self, kernel: Kernel) -> None:
        bare = inspect.signature(kernel.py_func).replace(return_annotation=inspect.Signature.empty)

        @type_callable(kernel)
        def typed(context: Any) -> Any:
            def typer(*args: Any) -> Any:
                return self.unit(kernel, args)[1](*map(wide, args))

            typer.__signature__ = bare  # type: ignore[attr-defined]
            return typer

        @lower_builtin(kernel, types.VarArg(types.Any))
        def lowered(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            name, result = self.unit(kernel, signature.args)
            kind = ir.FunctionType(
                context.get_value_type(result), [context.get_value_type(t) for t in signature.args])
            known = builder.module.globals.get(name)
            return builder.call(known or ir.Function(builder.module, kind, name), args)

    def unit(self, kernel: Kernel, args: Sequence[Any]) -> tuple[str, Any]:
        """Compile a kernel for some types; gives its name in IR and the type of its result."""
        key = kernel, tuple(map(wide, args))
        if key not in self._known:
            name = name_of(*key)
            # numba asks for all addresses, though nothing is run here.
            llvm.add_symbol(name, 1)
            file = self._folder / name
            if not file.exists():
                part, result = self._compiled(name, *key)
                own = Path(f"{file}.{os.getpid()}")
                own.write_bytes(pickle.dumps((part, result)))
                os.replace(own, file)
            self._parts[name], result = pickle.loads(file.read_bytes())
            self._known[key] = name, result
        return self._known[key]

    def _compiled(self, name: str, kernel: Kernel, args: tuple[Any, ...]) -> tuple[Any, Any]:
        made = njit(  # type: ignore[call-overload]
            error_model="numpy", forceinline=kernel.inlined, no_cpython_wrapper=True,
            no_rewrites=True,
        )(kernel.py_func)
        made.compile(args)
        text = made.inspect_llvm(args)
        (wrapper,) = WRAPPER.findall(text)
        text = re.sub(f'@"?{re.escape(wrapper)}"?(?=\\()', f"@{name}", text)
        text = text if kernel.allocates else COUNTED.sub("", text)
        mark = "noinline" if kernel.apart else "alwaysinline"
        return linkable(text, name, mark), made.nopython_signatures[0].return_type

    def entry(self, line: str) -> tuple[str, str]:
        """Compile what Python calls of a kernel: reads slots, and leaves results there.

        Parameters
        ----------
        line : str    ``module.kernel(types)``, types as :func:`..kernel.spelled` has them

        Returns
        -------
        its name in IR, and the types of the results
        """
        call: Any = ast.parse(line, mode="eval").body
        kernel, kinds = named(call.func), list(map(kind_of, call.args))
        self.tell()
        unit, result = self.unit(kernel, kinds)
        several = isinstance(result, types.BaseTuple)
        results = result if several else () if result is types.none else (result,)
        made = [next(name for kind, name in RESULTS if isinstance(each, kind)) for each in results]

        def typed(typing: Any, words: Any) -> Any:
            def code(context: Any, builder: Any, signature: Any, args: Any) -> None:
                slots = Slots(context, builder, *args)
                given = list(map(slots.read, kinds))
                kind = ir.FunctionType(
                    context.get_value_type(result), [each.type for each in given])
                out = builder.call(ir.Function(builder.module, kind, unit), given)
                for place, name in enumerate(made):
                    slots.keep(place, name, builder.extract_value(out, place) if several else out)
            return types.void(types.voidptr), code

        called: Any = intrinsic(typed)
        whole = cfunc(types.void(types.voidptr), error_model="numpy")(lambda slots: called(slots))
        name: str = whole.native_name
        self._parts[name] = linkable(whole.inspect_llvm(), name, "nounwind")
        return name, f"({', '.join(made)})" if several else ", ".join(made)

    def machine_code(self, entry: str, names: Sequence[str]) -> Iterator[bytes]:
        """Optimise an entry with all that it needs; gives an object file for each level.

        LLVM's passes run for the best level alone, and the code of all is made of their result.

        Parameters
        ----------
        entry : str            its name in IR
        names : list of str    what it is called in the files, in the order of :func:`levels`
        """
        whole, waiting, taken = llvm.parse_assembly(RUNTIME), [entry], {entry}
        for part in waiting:
            code, called = self._part(part)
            whole.link_in(llvm.parse_bitcode(code))
            waiting += [name for name in called if name not in taken]
            taken |= {*called}
        for function in whole.functions:
            if function.name != entry and not function.is_declaration:
                function.linkage = "internal"
        targets = [machine(processor, 3) for processor in levels()]
        optimised(whole, targets[-1], 3)
        for name, target in zip(names, targets, strict=True):
            own = whole.clone()
            own.get_function(entry).name = name
            yield _emitted(own, target)

    def _part(self, name: str) -> tuple[bytes, list[str]]:
        if name not in self._parts:
            self._parts[name], _ = pickle.loads((self._folder / name).read_bytes())
        return self._parts[name]


def table(lines: Iterable[str]) -> bytes:
    """Object file of a library's table of contents, and of what asks for the processor.

    The first line has the stamp of the sources and the names of the levels.
    """
    text = "\n".join(lines).encode() + b"\0"
    letters = "".join(f"\\{byte:02x}" for byte in text)
    asks = ASKS if len(levels()) > 1 else "define i32 @odt_level() { ret i32 1 }"
    return _emitted(llvm.parse_assembly(
        f'@odt_kernels = constant [{len(text)} x i8] c"{letters}"\n{asks}'), machine("", 0))


def levels() -> tuple[str, ...]:
    """Processors of this family for which a library has kernels, LLVM's names."""
    return LEVELS.get(llvm.get_process_triple().partition("-")[0], ("generic",))


def machine(processor: str, effort: int) -> Any:
    """What LLVM compiles for."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    llvm.initialize_native_asmparser()
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=processor, opt=effort, reloc="pic", codemodel="default")


def optimised(module: Any, target: Any, effort: int) -> Any:
    """Run LLVM's passes over a module."""
    choice = llvm.create_pipeline_tuning_options(speed_level=effort)
    choice.loop_vectorization = choice.slp_vectorization = effort > 1
    builder = llvm.create_pass_builder(target, choice)
    builder.getModulePassManager().run(module, builder)
    return module


def linkable(text: str, name: str, mark: str) -> tuple[bytes, list[str]]:
    """Code in LLVM's bits that needs nothing of Python, and the names of the units it calls.

    Nothing raises, arrays are of RUNTIME, and others see of it one function alone, ``name``. It is
    made shorter at once: numba takes tuples of many arrays apart and together at every use.
    """
    def empty(found: re.Match[str]) -> str:
        kind = found[2]
        value = "" if kind == "void" else "null" if kind == "ptr" else "0"
        head = f"define linkonce_odr {found[1]}{kind} @{found[3]}{found[4]}"
        return f"{head} {{ ret {kind} {value} }}"

    text = FROM_END.sub(r"  \4 = add i64 \2, 0\n", APART.sub(r"\1nounwind", text))
    text = re.sub(rf'^(define .*@"?{re.escape(name)}"?\(.*) \{{$', rf"\1 {mark} {{", text,
                  flags=re.MULTILINE)
    module = optimised(llvm.parse_assembly(RAISING.sub(empty, text)), machine("", 1), 1)
    for value in (*module.functions, *module.global_variables):
        if value.name != name and not value.is_declaration:
            value.linkage = "internal"
    code: bytes = module.as_bitcode()
    return code, sorted({*CALLED.findall(text)})


def _emitted(module: Any, target: Any) -> bytes:
    code: bytes = target.emit_object(module)
    return code
