"""Who takes part: one table of tools, their settings and the extra that brings them;
and which meshes no contestant of a tool takes, and why.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from shutil import which
from typing import Any, NamedTuple

from odt_plugins.compare.start import Kind
from odt_plugins.errors import InvalidOptionError
from odt_plugins.objectives import AIMS

OURS = "odt-plugins"
"""Name of the contestant that the others are held against: every default of ours."""

OWN = "own"
"""Family of contestants that are no part of the package."""

FUNCTION = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")
"""Names of functions, as in "module:name"."""


@dataclass(frozen=True)
class Contestant:
    """One tool with one choice of settings.

    Attributes
    ----------
    name : str                 shown in every table
    family : str               the tool; ``--against`` takes families and names
    kinds : tuple of str       kinds of start mesh it is tried on
    module : str               file in `baselines`, or the full name of a module elsewhere
    settings : dict            for its `prepare`; plain JSON values
    package : str              distribution whose version is recorded, "" for numpy alone
    program : str              executable that is run, "" for none; without it on the PATH the row
                               is left out
    extra : str                extra of odt-plugins that brings the package
    remark : str               what one must know to read its row
    """

    name: str
    family: str
    kinds: tuple[Kind, ...]
    module: str
    settings: dict[str, Any] = field(default_factory=dict)
    _: KW_ONLY
    package: str = ""
    program: str = ""
    extra: str = "compare"
    remark: str = ""

    def installed(self) -> str | None:
        """Version of the package, "" of a program, None when it is not installed."""
        if self.program:
            return which(self.program) and ""
        try:
            return version(self.package or "numpy")
        except PackageNotFoundError:
            return None

    @property
    def missing(self) -> str:
        """What to say where it is not installed."""
        if self.program:
            return f"no program {self.program} is on the PATH"
        return f'{self.package} is not installed; try pip install "odt-plugins[{self.extra}]"'


FLAT: tuple[Kind, ...] = ("planar",)
SOLID: tuple[Kind, ...] = ("tets",)
CURVED: tuple[Kind, ...] = ("surface",)
NO_INSERT = {"optim": True, "nosurf": True, "nofem": True, "noinsert": True}
INSERT = {"optim": True, "nosurf": True, "nofem": True}
COMBINATION = [["", 1], ["Netgen", 1], ["Relocate3D", 1]]
FLIPS = ("meshing_edge_flip_by_planar_optimization", {"planartype": "delaunay", "iterations": 0})
"""Its `iterations` are passes of smoothing afterwards, which would move the boundary."""


def _ours() -> list[Contestant]:
    """Every default, and each method by itself as in the paper, without finishing."""
    alone: dict[str, Any] = {"finish": False, "keep": []}
    methods: dict[str, dict[str, Any]] = {
        "ODT local": {"method": "odt"}, "CPT local": {"method": "cpt"},
        "Laplacian": {"method": "laplacian"}, "CVT": {"method": "cvt"},
        "ODT global": {"method": "odt", "smoothing": {"solver": "global"}},
        "CPT global": {"method": "cpt", "smoothing": {"solver": "global"}},
    }
    rows = [Contestant(OURS, "odt-plugins", (*SOLID, *FLAT, *CURVED), "ours", {"options": {}},
                       package="odt-plugins", remark="every default")]
    freer: dict[str, dict[str, Any]] = {
        "insertion": {"insert": True}, "sliding": {"boundary": "slide"},
        "sliding, insertion": {"boundary": "slide", "insert": True},
    }
    rows += [Contestant(f"{OURS}: {name}", "odt-plugins", SOLID, "ours", {"options": options},
                        package="odt-plugins", remark="as its name says, all else by default")
             for name, options in freer.items()]
    rows += [Contestant(f"{OURS}: {name}, no finish", "odt-plugins", (*SOLID, *FLAT), "ours",
                        {"options": {**options, **alone}}, package="odt-plugins",
                        remark="the paper's method by itself, no figure guarded")
             for name, options in methods.items()]
    rows += [Contestant(f"{OURS}: {name}", "odt-plugins", (*SOLID, *FLAT, *CURVED), "ours",
                        {"options": {"objective": name}}, package="odt-plugins",
                        remark=f"the objective {name}: {aim.text}")
             for name, aim in AIMS.items() if not aim.by_ratios]
    rows.append(Contestant(f"{OURS}: envelope 2e-3", "odt-plugins", CURVED, "ours",
                           {"options": {"envelope": 2e-3}}, package="odt-plugins",
                           remark="twice as far from the start"))
    return rows


def _plain() -> list[Contestant]:
    both = (*SOLID, *FLAT)
    return [Contestant("Laplacian", "laplacian", both, "averaging",
                       {"iterations": 10, "smart": False}, remark="10 passes in numpy"),
            Contestant("smart Laplacian", "laplacian", both, "averaging",
                       {"iterations": 10, "smart": True}, remark="10 passes in numpy")]


def _gmsh() -> list[Contestant]:
    def row(name: str, kinds: tuple[Kind, ...], remark: str = "", **settings: Any) -> Contestant:
        return Contestant(f"Gmsh {name}", "gmsh", kinds, "gmsh_optimize", settings,
                          package="gmsh", remark=remark)

    return [row("default", SOLID, sequence=[["", 1]]),
            row("Netgen", SOLID, sequence=[["Netgen", 1]]),
            row("Relocate3D", SOLID, sequence=[["Relocate3D", 5]]),
            row("combination", SOLID, "default, Netgen, Relocate3D, three times, threshold 0.7",
                sequence=COMBINATION, threshold=0.7, times=3),
            row("Relocate2D", FLAT, sequence=[["Relocate2D", 10]]),
            row("Laplace2D", FLAT, sequence=[["Laplace2D", 10]])]


def _volume_tools() -> list[Contestant]:
    def netgen(steps: str, times: int) -> Contestant:
        return Contestant(f"Netgen {steps}", "netgen", SOLID, "netgen_optimize",
                          {"optimize3d": steps, "steps": times},
                          package="netgen-mesher", remark=f"{times} steps")

    def mmg(name: str, options: dict[str, bool], times: int = 1, remark: str = "") -> Contestant:
        return Contestant(f"mmg3d {name}", "mmg", SOLID, "mmg_optimize",
                          {"options": options, "times": times}, package="mmgpy",
                          remark=remark)

    def cgal(*steps: str) -> Contestant:
        first = "; one pass of odt first" if "lloyd" in steps else ""
        return Contestant(f"CGAL {' + '.join(steps)}", "cgal", SOLID, "cgal_optimize",
                          {"steps": list(steps), "iterations": 40},
                          package="cgal", remark=f"Delaunay starts only; moves the surface{first}")

    def tetwild(name: str, energy: float) -> Contestant:
        return Contestant(name, "tetwild", SOLID, "tetwild", {"stop_energy": energy},
                          package="pytetwild",
                          remark="meshes the surface anew; does not repeat itself")

    return [netgen("m", 10), netgen("sm", 3), netgen("stm", 10),
            mmg("no insertion", NO_INSERT), mmg("with insertion", INSERT, remark="adds vertices"),
            mmg("with insertion, 3 times", INSERT, 3, "adds vertices"),
            cgal("odt"), cgal("lloyd"), cgal("perturb"), cgal("exude"),
            cgal("odt", "perturb", "exude"),
            Contestant("Stellar", "stellar", SOLID, "stellar", {"measure": 0}, program="Stellar",
                       remark="surface fixed, smallest sine; adds vertices"),
            Contestant("TetGen -rYO10/7", "tetgen", SOLID, "tetgen_refine",
                       {"flags": "rYO10/7"}, program="tetgen", remark="surface fixed"),
            tetwild("TetWild again", 10.0), tetwild("TetWild again, energy 5", 5.0)]


def _surface_tools() -> list[Contestant]:
    def lab(name: str, kinds: tuple[Kind, ...], *filters: Any, remark: str = "",
            **settings: Any) -> Contestant:
        return Contestant(f"MeshLab {name}", "pymeshlab", kinds, "meshlab",
                          {"filters": [list(f) for f in filters], **settings},
                          package="pymeshlab", remark=remark)

    def o3d(name: str, steps: int) -> Contestant:
        return Contestant(f"open3d {name}", "open3d", CURVED, "open3d_smooth",
                          {"filter": name, "iterations": steps}, package="open3d")

    ten = {"stepsmoothnum": 10, "boundary": False, "cotangentweight": False}
    inner: tuple[Any, ...] = (
        ("compute_selection_from_mesh_border", {}), ("apply_selection_inverse", {}),
        ("apply_coord_laplacian_smoothing", {**ten, "selected": True}),
    )
    free = ("compute_selection_by_condition_per_vertex", {"condselect": "q > 0"})
    def mmgs(name: str, envelope: float) -> Contestant:
        return Contestant(f"mmgs {name}", "mmg", CURVED, "mmg_remesh", {"envelope": envelope},
                          package="mmgpy", remark="hausd as the envelope; changes the vertices")

    remesh = "meshing_isotropic_explicit_remeshing"
    same_size: dict[str, Any] = {"iterations": 5, "targetlen": None}
    fixed_size: dict[str, Any] = {**same_size, "splitflag": False, "collapseflag": False}
    return [
        lab("flips", (*FLAT, *CURVED), FLIPS),
        lab("Laplacian", (*FLAT, *CURVED), free, inner[-1],
            remark="10 passes; a boundary in the plane and interfaces not selected", regions=True),
        lab("flips and Laplacian", FLAT, FLIPS, *inner, FLIPS, *inner[2:], FLIPS),
        lab("Taubin", CURVED, ("apply_coord_taubin_smoothing", {})),
        lab("HC Laplacian", CURVED, ("apply_coord_hc_laplacian_smoothing", {})),
        lab("two-step", CURVED, ("apply_coord_two_steps_smoothing", {})),
        lab("surface-preserving", CURVED,
            ("apply_coord_laplacian_smoothing_surface_preserving", {"iterations": 10})),
        lab("isotropic remeshing", CURVED, (remesh, same_size), remark="changes the vertices"),
        lab("isotropic, no refinement", CURVED, (remesh, fixed_size),
            remark="flips, smoothing and projection alone"),
        mmgs("hausd 1e-3", 1e-3), mmgs("hausd 2e-3", 2e-3),
        Contestant("CGAL isotropic remeshing", "cgal", CURVED, "cgal_remesh", {"iterations": 5},
                   package="cgal", remark="changes the vertices"),
        o3d("simple", 5), o3d("laplacian", 5), o3d("taubin", 5),
    ]


CONTESTANTS = tuple(_ours() + _plain() + _gmsh() + _volume_tools() + _surface_tools())


def choose(against: Sequence[str]) -> list[Contestant]:
    """Pick contestants by name or family; ours are always among them.

    Parameters
    ----------
    against : names or families    none means everybody; "module:name" is a function of the
                                   caller's, see :mod:`odt_plugins.compare.baselines.given`

    Raises
    ------
    InvalidOptionError             a name that nobody has
    """
    if not against:
        return [c for c in CONTESTANTS if not c.program or c.installed() is not None]
    families = sorted({c.family for c in CONTESTANTS})
    known = {c.name for c in CONTESTANTS} | set(families)
    for name in against:
        if name not in known and not FUNCTION.fullmatch(name):
            msg = (f"got {name!r} to compare with; expected one of {', '.join(families)}, a name, "
                   f"or module:name of a function of yours")
            raise InvalidOptionError(msg)
    whole = OURS in against
    return [*(c for c in CONTESTANTS
              if c.name == OURS or c.name in against
              or (c.family in against and (c.family != OURS or whole))),
            *(Contestant(name, OWN, (*SOLID, *FLAT, *CURVED), "given", {"function": name})
              for name in dict.fromkeys(against) if name not in known)]


def of_families(contestants: Sequence[Contestant], against: Sequence[str]) -> list[Contestant]:
    """Give ours and those of the families that are named; all unless any is."""
    return [c for c in contestants if c.name == OURS or not against or c.family in against]


KINDS: dict[Kind, str] = {
    "tets": "tetrahedra", "planar": "triangles in the plane", "surface": "surfaces",
}
"""Kinds of start mesh as sentences call them."""


class Tool(NamedTuple):
    """A family of contestants.

    Attributes
    ----------
    name : str        as its makers write it
    refuses : dict    why no contestant of it takes a kind of mesh
    """

    name: str
    refuses: dict[Kind, str]


MMG = "mmg3d and mmgs, the parts of Mmg that are compared, take no mesh in the plane"
CGAL = "CGAL's optimisers of Mesh_3 and its remeshing of surfaces take no mesh in the plane"
STELLAR = "Stellar takes tetrahedra only"
TETGEN = "TetGen takes tetrahedra only"
TETWILD = "TetWild fills a surface with tetrahedra; the mesh has none"

TOOLS: dict[str, Tool] = {
    OURS: Tool("odt-plugins", {}),
    "laplacian": Tool("Laplacian", {
        "surface": "averaging in space shrinks a surface; MeshLab and Open3D have filters for it"}),
    "gmsh": Tool("Gmsh", {
        "surface": "Gmsh moves vertices of a surface only where it has a parametrisation of it"}),
    "netgen": Tool("Netgen", {
        "planar": "Netgen optimises triangles only on a geometry of its own, not on a stored mesh",
        "surface": "Netgen optimises triangles only on a geometry of its own, not on a stored mesh",
    }),
    "mmg": Tool("Mmg", {"planar": MMG}),
    "cgal": Tool("CGAL", {"planar": CGAL}),
    "stellar": Tool("Stellar", {"planar": STELLAR, "surface": STELLAR}),
    "tetgen": Tool("TetGen", {"planar": TETGEN, "surface": TETGEN}),
    "tetwild": Tool("TetWild", {"planar": TETWILD, "surface": TETWILD}),
    "pymeshlab": Tool("MeshLab", {"tets": "MeshLab has no tetrahedra"}),
    "open3d": Tool("Open3D", {
        "tets": "Open3D's filters smooth triangles only",
        "planar": "Open3D's filters have no vertices that stay, so the boundary would shrink"}),
}
"""Every family of contestants."""


def refusals(kind: Kind, contestants: Sequence[Contestant]) -> dict[str, tuple[str, str]]:
    """Name the families of which no contestant takes a kind of mesh.

    Returns
    -------
    dict    family -> (name of its row, why)
    """
    found = {}
    for family in dict.fromkeys(c.family for c in contestants):
        names = [c.name for c in contestants if c.family == family]
        if not any(c.family == family and kind in c.kinds for c in contestants):
            tool = TOOLS.get(family, Tool(family, {}))
            name = names[0] if len(names) == 1 else tool.name
            found[family] = name, tool.refuses.get(kind, f"does not take {KINDS[kind]}")
    return found
