"""The rooms of the package: who may import whom, what an import costs, what is public."""

from __future__ import annotations

import ast
import inspect
import re
import subprocess
import sys
from collections import namedtuple as tuple_of
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import odt_plugins
from odt_plugins import errors

PACKAGE = Path(odt_plugins.__file__).parent
MODULES = sorted(PACKAGE.rglob("*.py"))

BASE = {"errors", "keywords", "mesh", "objectives", "options", "promise", "figures"}
MAY_IMPORT = {
    "errors": set(),
    "hints": set(),
    "objectives": set(),
    "keywords": {"objectives", "options"},
    "options": {"errors", "hints", "objectives"},
    "processes": {"errors"},
    "progress": {"options"},
    "table": set(),
    "words": set(),
    "mesh": {"errors"},
    "figures": {"errors", "mesh", "table"},
    "promise": {"errors", "mesh", "options", "figures"},
    "engine": {"progress", *BASE},
    "paper": {"engine", "mesh"},
    "adapters": {"errors", "mesh", "processes"},
    "carrying": {"adapters", "engine", "metric", "progress", *BASE},
    "report": {"carrying", "engine", "table", *BASE},
    "metric": {"adapters", "carrying", "engine", "errors", "mesh", "options"},
    "multiblock": {"adapters", "progress", *BASE},
    "api": {"adapters", "carrying", "distributed", "engine", "multiblock", "report", *BASE},
    "remeshing": {"carrying", "engine", "metric", "multiblock", "report", *BASE},
    "tetwild": {"api", "generate", "progress", "remeshing", "report", *BASE},
    "hosts": {"adapters", "api", "metric", "remeshing", "report", "tetwild", *BASE},
    "generate": {"adapters", "api", "carrying", "engine", "progress", "remeshing", "report",
                 "table", "tetwild", *BASE},
    "compare": {"adapters", "api", "engine", "generate", "processes", "remeshing", "report", *BASE},
    "ahead": {"api", "carrying", "engine", "generate", "mesh", "remeshing"},
    "distributed": {"adapters", "api", "carrying", "engine", "generate", "processes", "progress",
                    "remeshing", "report", "table", "tetwild", *BASE},
    "cli": {"adapters", "ahead", "api", "compare", "distributed", "generate", "hints", "hosts",
            "metric", "processes", "progress", "remeshing", "report", "table", "tetwild", "words",
            *BASE},
    "pages": {"cli", *BASE},
    "__main__": {"adapters", "cli"},
    "__init__": {"api", "distributed", "generate", "hosts", "metric", "remeshing", "report",
                 "tetwild", *BASE},
}
"""Rooms that a room may import."""

ENGINE = ("compiled", "topology", "cells", "record", "moves", "ground", "odt", "sliding", "finish",
          "run", "surface", "untangle", "retile", "remesh")
"""Rooms of the engine; each imports only itself and those before it."""

TOOLKITS = {
    "pyvista": {"adapters/pyvista_mesh.py", "hosts/pyvista_accessor.py", "report/plotting.py",
                "cli/demo.py", "compare/hull.py", "compare/baselines/pyacvd_cluster.py"},
    "vtkmodules": {"adapters/pyvista_mesh.py", "adapters/vtk_files.py", "adapters/vtk_mesh.py",
                   "hosts/paraview_plugin.py",
                   "report/plotting.py"},
    "meshio": {"adapters/meshio_mesh.py", "adapters/files.py", "adapters/reading.py",
               "adapters/vtk_files.py", "adapters/fitting.py", "adapters/gmsh_files.py",
               "adapters/netgen_files.py", "adapters/formats/abaqus.py",
               "adapters/formats/avsucd.py", "adapters/formats/exodus.py",
               "adapters/formats/gmsh_groups.py", "adapters/formats/gmsh_read.py",
               "adapters/formats/med.py", "adapters/formats/medit.py",
               "adapters/formats/nastran.py", "adapters/formats/obj.py", "adapters/formats/ply.py",
               "adapters/formats/polygons.py", "adapters/formats/readers.py",
               "adapters/formats/stl.py",
               "adapters/formats/su2.py", "adapters/formats/tetgen.py",
               "adapters/formats/dolfin.py", "adapters/formats/ugrid.py",
               "adapters/formats/tecplot.py", "adapters/formats/hdf.py",
               "adapters/formats/fluent.py", "adapters/formats/permas.py",
               "adapters/formats/mdpa.py", "adapters/formats/vol.py",
               "adapters/formats/xdmf.py", "cli/demo.py",
               "distributed/store.py", "generate/fill.py", "hosts/script.py"},
    "gmsh": {"adapters/gmsh_files.py", "adapters/gmsh_parts.py", "hosts/gmsh_methods.py",
             "compare/baselines/gmsh_optimize.py", "compare/baselines/gmsh_remesh.py"},
    "netCDF4": {"adapters/formats/exodus.py", "adapters/formats/exodus_copy.py",
                "adapters/formats/exodus_write.py"},
    "h5py": {"adapters/formats/cgns_write.py", "adapters/formats/hdf.py", "adapters/formats/med.py",
             "adapters/formats/med_copy.py",
             "adapters/formats/xdmf_copy.py", "adapters/formats/xdmf_items.py"},
    "mfem": {"compare/baselines/mfem_tmop.py"},
    "netgen": {"adapters/netgen_files.py", "adapters/netgen_mesh.py",
               "compare/baselines/netgen_optimize.py"},
    "matplotlib": {"report/plotting.py", "compare/charts.py", "compare/pictures.py"},
    "pytetwild": {"compare/baselines/tetwild.py"},
    "pymeshlab": {"adapters/pymeshlab_copy.py", "adapters/pymeshlab_faces.py",
                  "adapters/pymeshlab_mesh.py", "adapters/pymeshlab_set.py",
                  "hosts/pymeshlab_apply.py", "hosts/pymeshlab_filters.py",
                  "hosts/pymeshlab_work.py", "hosts/script.py", "compare/baselines/meshlab.py"},
    "open3d": {"adapters/open3d_mesh.py", "hosts/open3d_filters.py",
               "compare/baselines/open3d_smooth.py"},
    "trimesh": {"adapters/scene_files.py"},
    "skfem": {"compare/poisson.py", "report/worth.py"},
    "ngsolve": set(),
    "torch": set(),
    "cupy": set(),
    "dask": {"distributed/cluster.py"},
    "distributed": {"distributed/cluster.py"},
    "igl": {"compare/sized.py", "engine/ground/reference.py", "engine/odt/cholesky.py",
            "generate/bodies.py"},
}
"""Files that may import a toolkit, inside a function."""

MOST_PARAMETERS = {"kernel": 10, "function": 8}
"""Parameters that a kernel and any other function of the engine may take."""

SLOW = ("numba", "scipy", "pyamg", "click", "rich", "dask", "distributed", *TOOLKITS)


TESTS = Path(__file__).parent
NAMES = {".".join(path.relative_to(PACKAGE).with_suffix("").parts): path for path in MODULES}


def room(path: Path) -> str:
    return room_of(path.relative_to(PACKAGE).as_posix())


def room_of(file: str) -> str:
    return file.partition("/")[0].removesuffix(".py")


def imports(node: ast.AST) -> list[str]:
    """Full names that one import statement may load; relative ones are an error elsewhere."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom) and node.module:
        return [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return []


def nodes(path: Path) -> list[ast.AST]:
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


@pytest.fixture(scope="module")
def held():
    """What every file of the package holds, by its path in the package."""
    return {path.relative_to(PACKAGE).as_posix(): nodes(path) for path in MODULES}


def imported(held):
    """Every import of the package: the file, the node and a name that it may load."""
    return [(file, node, name) for file, inside in held.items() for node in inside
            for name in imports(node)]


def test_rooms_import_only_what_the_table_allows(held):
    assert [f"{file}:{node.lineno}" for file, inside in held.items() for node in inside
            if isinstance(node, ast.ImportFrom) and node.level] == []
    wrong = []
    for file, node, name in imported(held):
        parts = name.split(".")
        if parts[0] == "odt_plugins" and len(parts) > 1 and parts[1] in MAY_IMPORT and (
                parts[1] not in MAY_IMPORT[room_of(file)] | {room_of(file)}):
            wrong.append(f"{file}:{node.lineno} imports {name}")
    assert wrong == []


def test_nobody_imports_the_comparison_but_its_command(held):
    assert [(file, name) for file, _, name in imported(held)
            if name.startswith("odt_plugins.compare")
            and file != "cli/compare.py" and room_of(file) != "compare"] == []


def test_toolkits_are_imported_in_their_place_and_inside_functions(held):
    functions = ast.FunctionDef | ast.AsyncFunctionDef
    inside = {id(inner) for nodes in held.values() for outer in nodes
              if isinstance(outer, functions) for inner in ast.walk(outer)}
    assert [f"{file}:{node.lineno} imports {name}" for file, node, name in imported(held)
            if (toolkit := name.partition(".")[0]) in TOOLKITS
            and (file not in TOOLKITS[toolkit] or id(node) not in inside)] == []


def test_no_private_part_of_a_library_is_used(held):
    private = []
    nodes = [node for inside in held.values() for node in inside]
    own = {node.name for node in nodes if isinstance(node, (ast.FunctionDef, ast.ClassDef))}
    own |= {node.attr for node in nodes
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)}
    of_tuples = {name for name in dir(tuple_of("It", "one")) if name.startswith("_")}
    for file, inside in held.items():
        private += [(file, ast.unparse(node)) for node in inside if isinstance(node, ast.Attribute)
                    and node.attr.startswith("_") and not node.attr.endswith("__")
                    and node.attr not in own | of_tuples and ast.unparse(node) != "os._exit"]
        for node in inside:
            names = imports(node)
            if isinstance(node, ast.ImportFrom):
                names = [f"{node.module}.{name.name}" for name in node.names]
            for name in names:
                first, *rest = name.split(".")
                if first not in ("odt_plugins", "__future__") and any(
                        part.startswith("_") for part in rest):
                    private.append((file, name))
    assert private == []


def test_the_tables_name_the_rooms_that_exist():
    assert {room(path) for path in MODULES} == set(MAY_IMPORT)
    inside = {path.parent.name for path in MODULES if room(path) == "engine"} - {"engine"}
    assert inside == set(ENGINE)


def test_the_page_of_the_package_names_all_rooms():
    page = (PACKAGE / "README.md").read_text()
    table = page.partition("A mesh takes this way")[0]
    names = {name.rstrip("/").removesuffix(".py") for name in re.findall(r"`([\w/.]+)`", table)}
    assert set(MAY_IMPORT) - {"__init__", "__main__"} - names == set()


def test_no_import_of_the_engine_runs_upward(held):
    upward = []
    for file, _, name in imported(held):
        parts = file.split("/")
        if (parts[0] == "engine" and len(parts) > 2 and name.startswith("odt_plugins.engine.")
                and name.split(".")[2] in ENGINE
                and ENGINE.index(name.split(".")[2]) > ENGINE.index(parts[1])):
            upward.append((file, name))
    assert upward == []


def test_no_imports_run_in_a_circle(held):
    graph = {file.removesuffix(".py").replace("/", "."): {
        other.removeprefix("odt_plugins.") for node in inside for other in imports(node)}
        & set(NAMES) for file, inside in held.items()}
    assert {*graph} == {*NAMES}
    TopologicalSorter(graph).prepare()


def test_files_hold_one_idea_and_print_nothing(held):
    assert [path for path in MODULES if path.stat().st_size >= 24_000] == []
    assert [file for file, inside in held.items() if not ast.get_docstring(inside[0])] == []
    wrong = []
    for file, inside in held.items():
        for node in inside:
            called = isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and (
                node.func.id in {"print", "exit", "input"}) and room_of(file) != "cli"
            bare = isinstance(node, ast.ExceptHandler) and node.type is None
            if called or bare or isinstance(node, ast.Assert):
                wrong.append(f"{file}:{node.lineno}")
    assert wrong == []


def long_lists(inside: list[ast.AST]) -> set[str]:
    """Functions with too many parameters whose first line does not say why they have so many."""
    found = set()
    for node in inside:
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        given = node.args
        count = len([*given.posonlyargs, *given.args, *given.kwonlyargs,
                     *filter(None, (given.vararg, given.kwarg))])
        kernel = any("kernel" in ast.unparse(decorator) for decorator in node.decorator_list)
        why = "parameters" in (ast.get_docstring(node) or "").partition("\n")[0]
        if count > MOST_PARAMETERS["kernel" if kernel else "function"] and not why:
            found.add(node.name)
    return found


def test_no_function_of_the_engine_takes_a_long_list_of_parameters(held):
    found = {file: long_lists(inside) for file, inside in held.items()
             if room_of(file) == "engine"}
    assert {name: functions for name, functions in found.items() if functions} == {}


def test_the_top_level_holds_what_it_shall_and_nothing_else():
    root = PACKAGE.parent
    listed = [path.name for path in root.iterdir()]
    if (root / ".git").exists():
        listed = subprocess.run(["git", "ls-files"], cwd=root, capture_output=True, text=True,
                                check=True).stdout.splitlines()
    made = {"PKG-INFO", "setup.cfg", "odt_plugins.egg-info", ".venv", ".pytest_cache",
            ".mypy_cache", ".ruff_cache", ".hypothesis"}
    assert {path.split("/")[0] for path in listed} - made == {
        ".ci", ".gitignore", "LICENSE", "README.md", "examples", "odt_plugins", "pyproject.toml",
        "setup.py", "tests"}


def test_no_test_imports_from_a_test():
    # Few files name what an import may stand for; the others need not be parsed.
    named = re.compile(r"\b(from|import)\b[^\n]*(\btest_|\\\n)")
    for path in TESTS.rglob("*.py"):
        for node in nodes(path) if named.search(path.read_text(encoding="utf-8")) else []:
            assert not [name for name in imports(node) if name.startswith("test_")], path


def run(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_importing_is_quick_and_loads_no_toolkit():
    code = f"""
import sys, time
start = time.perf_counter()
import odt_plugins
took = time.perf_counter() - start
first = [name for name in {SLOW!r} if name in sys.modules]
odt_plugins.optimize, odt_plugins.Options, odt_plugins.quality
second = [name for name in {SLOW!r} if name in sys.modules]
print(took, first, second)
"""
    took, loaded = run(code).split(maxsplit=1)
    assert loaded.strip() == "[] []"
    assert float(took) < 1.0


def test_workers_load_numba_and_scipy_only_when_they_need_them():
    code = """
import sys
import odt_plugins.distributed.block
loaded = [f"scipy.{name}" in sys.modules for name in ("sparse", "spatial", "optimize")]
print("numba" in sys.modules, any(loaded))
"""
    assert run(code).split() == ["False", "False"]


def test_arrays_need_no_toolkit():
    blocked = [name for name in TOOLKITS if name != "meshio"]
    code = f"""
import sys
for name in {blocked!r}:
    sys.modules[name] = None
import numpy as np
import odt_plugins
points = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [.8, .7]])
cells = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
out, report = odt_plugins.optimize_with_report((points, cells))
print(report.after.min_quality > report.before.min_quality)
print("meshio" in sys.modules)
"""
    assert run(code).split() == ["True", "False"]


def test_all_public_names_are_there_and_no_others():
    assert list(odt_plugins.__all__) == sorted(odt_plugins.__all__)
    for name in odt_plugins.__all__:
        assert getattr(odt_plugins, name) is not None
    assert set(odt_plugins.__all__) <= set(dir(odt_plugins))
    assert {n for n in dir(odt_plugins) if n[:2] != "__"} <= set(odt_plugins.__all__)
    in_errors = {name for name, value in vars(errors).items() if inspect.isclass(value)}
    assert in_errors <= set(odt_plugins.__all__)
    with pytest.raises(AttributeError, match="no attribute 'optimise'"):
        odt_plugins.optimise  # noqa: B018
    from importlib.metadata import version

    assert odt_plugins.__version__ == version("odt-plugins")


def test_type_checkers_see_the_public_names_and_their_homes():
    """What `import a as a` names under TYPE_CHECKING is what is public, from the same module."""
    tree = ast.parse((PACKAGE / "__init__.py").read_text(encoding="utf-8"))
    seen = {alias.asname: node.module.removeprefix("odt_plugins.")
            for block in tree.body if isinstance(block, ast.If)
            for node in block.body if isinstance(node, ast.ImportFrom)
            for alias in node.names if alias.name == alias.asname}
    assert seen == odt_plugins._HOMES
    assert odt_plugins.__all__ == sorted([*seen, "__version__"])


@pytest.mark.parametrize("name", [n for n in odt_plugins.__all__ if n != "__version__"])
def test_public_names_are_documented_and_typed(name):
    value = getattr(odt_plugins, name)
    assert inspect.getdoc(value)
    if inspect.isfunction(value):
        signature = inspect.signature(value)
        assert signature.return_annotation is not inspect.Signature.empty
        for parameter in signature.parameters.values():
            assert parameter.annotation is not inspect.Parameter.empty


def test_the_glossary_has_at_most_thirty_words_each_once():
    page = (PACKAGE / "README.md").read_text(encoding="utf-8")
    rows = page.partition("| word | meaning |\n")[2].partition("\n\n")[0].splitlines()[1:]
    words = [row.split("|")[1].strip() for row in rows]
    assert 10 < len(words) == len(set(words)) <= 30
