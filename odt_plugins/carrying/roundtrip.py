"""Round trip of a mesh: any object to the engine, and a new object of the same type back.

This is the only place where adapters and engine meet.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.elevated import held, linear
from odt_plugins.adapters.fields import named_array
from odt_plugins.adapters.host import (
    Adapter,
    HostMesh,
    Result,
    as_indices,
    expect_tetrahedra,
    flat_points,
    with_places,
    words_of,
)
from odt_plugins.adapters.kept import hold_charts, hold_kept, hold_places, protect_surface
from odt_plugins.adapters.regions import AUTO, CHARTS, are_names
from odt_plugins.adapters.registry import find_adapter
from odt_plugins.adapters.staying import note_kept
from odt_plugins.adapters.wedges import glued, with_seams, without_seams
from odt_plugins.carrying.aside import (
    note,
    of_cells,
    of_optimised,
    seen,
    with_others,
    without_others,
)
from odt_plugins.carrying.bending import bent_again, leaving_bent, with_bent
from odt_plugins.carrying.curved import Kept, keep_curved, untangled_around
from odt_plugins.carrying.following import (
    CONSERVE,
    Prepared,
    around,
    expect_overlaps,
    follow,
    interpolated,
    interpolates,
    locating,
    new_faces,
    new_vertices,
)
from odt_plugins.carrying.onto import in_space, near_geometry, on_geometry
from odt_plugins.carrying.reference import within_reference
from odt_plugins.carrying.sources import cell_origin, in_input_order, surrounding_cells
from odt_plugins.carrying.textures import feet_of
from odt_plugins.carrying.transfer import transfer_of
from odt_plugins.carrying.untangling import Tangle, Wanted, rest_places, untangle_mesh
from odt_plugins.errors import InvalidMeshError, TangledMeshError, warn
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.bodies import of_bodies
from odt_plugins.mesh.layers import keep_layers
from odt_plugins.mesh.numbering import in_old_numbers, most_vertices, new_numbers, old_numbers
from odt_plugins.mesh.numbers import even_rows
from odt_plugins.mesh.plane import PlaneFrame, places_in_space
from odt_plugins.mesh.simplex import (
    SimplexMesh,
    compact_labels,
    reverse,
    simplex_mesh,
)
from odt_plugins.mesh.soup import at_copies, first_there, same_places
from odt_plugins.mesh.surface import surface_mesh
from odt_plugins.mesh.tangled import tangled_mesh
from odt_plugins.metric.looks import ADVICE, MOST, looks_anisotropic
from odt_plugins.metric.through import with_metric
from odt_plugins.options import Options
from odt_plugins.progress import BEFORE_FIELDS, DONE, kernels_shown, part, silent, told_whole

if TYPE_CHECKING:
    from odt_plugins.engine.run.outcome import Leaving, Outcome


PLAIN = Wanted()
"""What is asked of a mesh with inverted or flat cells unless something else is."""


@told_whole
def run_engine(
    mesh: Any,
    options: Options,
    engine: Callable[[SimplexMesh, Options, Leaving], Outcome] | None = None,
    wanted: Wanted = PLAIN,
) -> tuple[Any, SimplexMesh, Outcome, dict[str, Any]]:
    """Adapter, engine, adapter: the caller's new mesh and all that its report is made of.

    Parameters
    ----------
    mesh : object        what :func:`odt_plugins.optimize` takes
    options : Options
    engine : callable    takes the place of the engine, and judges meshes as they leave
    wanted : Wanted      of a mesh with inverted or flat cells

    Returns
    -------
    result : same type as `mesh`
    before, outcome : the input as the engine reads it, and what the engine handed back
    told : dict          what its report is told besides, by the names of the fields
    """
    def as_after(mesh: SimplexMesh) -> SimplexMesh:
        """The mesh with regions such as the result has: bodies where its cells are others."""
        return of_bodies(mesh) if wanted.linear else mesh

    tell = options.progress or None
    conserves = options.fields == CONSERVE
    progress = part(tell or silent, 0.0, BEFORE_FIELDS if conserves else 1.0)
    with kernels_shown(options.progress):
        first = part(progress, 0.0, wanted.share)
        work, given = _prepare(mesh, replace(options, progress=tell and first), wanted)
        layers = 0
        if "layers" not in options.free and options.metric is None:
            was = () if work.tangle is None else (work.tangle.before, work.tangle.source)
            kept, layers = keep_layers(work.mesh, options.threads, *was)
        stretched = layers > MOST * len(work.mesh.cells) or (
            "layers" in options.free and "metric" not in wanted.refused
            and looks_anisotropic(work.mesh, options.threads))
        if layers and not (stretched and wanted.linear):
            work = work._replace(mesh=kept)
        elif stretched:
            layers = 0
        if stretched and options.metric is None:
            work = work._replace(notes=(*work.notes, ADVICE))
        moves = work.mesh.is_surface or options.boundary == "slide"
        work = on_geometry(work) if moves else work
        leaves: Leaving = partial(_as_it_leaves, work._replace(mesh=as_after(work.mesh)),
                                  options.threads, onto=moves)
        with words_of(work.host):
            expect_overlaps(work, given, options)
            if wanted.sizes:
                options = replace(options, density=named_array(given, wanted.sizes))
            options = of_cells(of_optimised(options, given), work.own, len(given.cells))
            chosen = _of_mesh(_in_frame(options, work.frame), work.tangle)
            metric, chosen, more = with_metric(
                work.mesh, chosen, work.host, work.frame, wanted.growth)
            work = work._replace(mesh=metric, notes=work.notes + more)
            chosen, left = within_reference(chosen, work.host)
            work = work._replace(notes=work.notes + left)
            if moves:
                work, chosen = near_geometry(work, chosen)
            bent = None
            if given.higher_order and not work.host.higher_order:
                work, chosen, bent = with_bent(work, given, chosen, free=moves and wanted.linear)
                leaves = leaves if bent is None else leaving_bent(leaves, work.mesh)
            then = progress if work.tangle is None else part(progress, wanted.share, 1.0)
            chosen = replace(chosen, progress=tell and then)
            curved = _run_kept(work, given, engine or optimized, chosen, leaves)
    if conserves:
        progress("fields", 1.0)
    work, outcome = work._replace(mesh=as_after(curved.mesh)), curved.outcome
    points: Any = outcome.written
    source: Any = outcome.source
    cells, places = outcome.cells, outcome.points
    same = work.same
    if same is not None and outcome.origin is not None:
        keep = np.flatnonzero((outcome.origin < 0) | (same[outcome.origin] == outcome.origin))
        points, places = points[keep], places[keep]
        cells = new_numbers(keep, len(outcome.origin))[cells]
        outcome = replace(outcome, points=places, cells=cells, origin=outcome.origin[keep])
        same = None
    if same is not None:
        stays = (places == work.mesh.points).all(axis=1)[same]
        points, places = points[same], places[same]
        points[stays], places[stays] = work.host.points[stays], work.mesh.points[stays]
        old = work.host.cells.astype(np.int64)
        cells = at_copies(cells, source, old, same, work.host.blocks)
    before = work.mesh
    if work.tangle is not None:
        before = as_after(replace(work.tangle.before, metric=work.mesh.metric))
        source = work.tangle.source[source]
        outcome = replace(outcome, origin=work.tangle.origin(outcome.origin))
    fields = interpolated(work, options)
    near = partial(around, work, options.threads)
    written = replace(outcome, written=points, cells=cells)
    vertices = new_vertices(work, written, near, moved=bool(fields),
                            always=bool(fields) and conserves)
    data = follow(work, given, outcome, vertices, options)
    if work.orientation < 0:
        cells = reverse(cells, np.ones(len(cells), dtype=np.bool_))
    if work.own is not None:
        n = len(work.mesh.points)
        number = np.arange(n) if outcome.origin is None else new_numbers(outcome.origin, n)
        cells, source = with_others(given.cells, cells, source, work.own, number)
    faces = new_faces(work, given, outcome)
    whence = cell_origin(work.host.ids, work.host.total, source, [
        (kept.ids, now.source) for kept, now in zip(given.kept, faces, strict=False)
        if kept.ids is not None and now is not None])
    told: dict[str, Any] = {
        "regions_from": work.host.regions_from, "notes": (
            *work.notes,
            *(places_in_space(text, work.frame, work.mesh.extent) for text in outcome.notes)),
        "cell_origin": whence, "plane": work.frame,
        "carrying": transfer_of(work, given, outcome, written, options, whence),
        "interpolated": () if vertices is None else fields,
        "refused": wanted.refused + ("insert",) * (given.higher_order and not given.whole)
        + ("free='layers'",) * (not layers) + ("free='periodic'",) * work.host.linked,
        "tangle": work.tangle, "curved": curved.facts, "layers": layers,
        "integrals": data.cell_integrals, "point_integrals": data.point_integrals}
    result = Result(
        points, as_indices(cells, work.host.cells), source, work.mesh.is_surface,
        feet_of(work.host, work.mesh, places, cells, outcome.origin,
                follow=interpolates(work, options), same=work.same),
        data.vertices if not work.host.higher_order else None,
        locate=locating(work, given, options.threads) if fields else None, same=same,
        of_cells=data.of_cells, faces=faces,
    )
    if given.higher_order and not work.host.higher_order:
        result, more, told["curved"] = bent_again(
            work, given, outcome, bent, result, locating(work, given, options.threads), moves=moves)
        told["notes"] += more
    (tell or silent)(DONE, 1.0)
    out = work.adapter.write(result, given)
    if given.higher_order:
        # The writer puts nodes on edges and faces, of which there are others.
        told["nodes"] = len(find_adapter(out).read(out, None).points)
    return out, before, outcome, told


def optimized(mesh: SimplexMesh, options: Options, leaving: Leaving) -> Outcome:
    """Let the engine for this kind of mesh do the work."""
    if mesh.is_surface or (mesh.dim == 2 and options.boundary == "slide"):
        from odt_plugins.engine.surface.in_plane import run_any

        return run_any(mesh, options, leaving)
    from odt_plugins.engine.run import plan

    return plan.run(mesh, options, leaving)


def _run_kept(
    work: Prepared, given: HostMesh, engine: Callable[..., Outcome], options: Options,
    leaving: Leaving,
) -> Kept:
    """What the engine makes of the mesh, as it leaves, with curved cells as good as before."""
    progress = options.progress

    def run(mesh: SimplexMesh, attempt: int) -> Outcome:
        tell = progress and part(progress, 1.0 - 0.5**attempt, 1.0 - 0.5 ** (attempt + 1))
        outcome = engine(mesh, replace(options, progress=tell), leaving)
        return outcome if outcome.written is not None else leaving(outcome)

    host, tangle = work.host, work.tangle
    if given.nodes is not None and tangle is not None:
        own = slice(None) if work.own is None else work.own
        host = replace(given, cells=given.cells[own], nodes=given.nodes[own])
    if host.nodes is None:
        outcome = engine(work.mesh, options, leaving)
        return Kept(work.mesh, outcome if outcome.written is not None else leaving(outcome), None)
    figures = bool(options.keep) and not work.mesh.is_surface
    return keep_curved(
        host, work.mesh, run, leaving, work.orientation, figures=figures,
        slides=options.boundary == "slide" or work.mesh.is_surface,
        source=None if tangle is None else tangle.source)


def _prepare(mesh: Any, options: Options, wanted: Wanted) -> tuple[Prepared, HostMesh]:
    """The mesh for the engine, and as it came."""
    adapter = find_adapter(mesh)
    names = options.regions if are_names(options.regions) else None
    host = adapter.read(mesh, AUTO if names == CHARTS else names)
    keep_seams = names == CHARTS and host.textured
    host = adapter.read(mesh, CHARTS) if names == CHARTS and not keep_seams else host
    options = of_optimised(options, host)
    if not are_names(options.regions):
        host = replace(host, regions=even_rows("regions", options.regions))
    with words_of(host):
        if options.insert:
            expect_tetrahedra(host, options.insert)
        flat = flat_points(host)
    host = with_places(host, *flat)
    with words_of(host):
        own, seen_host = seen(host, flat[0]), host
        if host.nodes is not None:
            seen_host = held(host, options.fixed)
        if host.higher_order and (wanted.linear or options.insert):
            seen_host = linear(seen_host)
        if own is not None:
            seen_host, options = without_others(seen_host, options, own)
        work = partial(_checked, adapter, flat, options, wanted)
        found = work(seen_host, keep_seams=keep_seams)
        if found.tangle is not None and host.higher_order and (wanted.linear or options.insert):
            msg = ("got inverted or flat cells of higher order; expected none where vertices "
                   "come and go, try untangling the mesh first")
            raise TangledMeshError(msg)
        if own is not None:
            notes = (*found.notes, note(len(host.cells) - len(own)))
            return found._replace(own=own, notes=notes), host
        if found.tangle is not None:
            return found, host
        same = None if host.higher_order else same_places(host.points, host.cells.astype(np.int64))
        if same is None:
            return found, host
        gone = wanted.linear
        return _of_soup(found, work, host, same, keep_seams, gone), host


def _checked(
    adapter: Adapter, flat: tuple[FloatArray, PlaneFrame | None], options: Options,
    wanted: Wanted, host: HostMesh, *, keep_seams: bool,
) -> Prepared:
    """Check a mesh and fix what is to stay of it, the seams of its texture if asked to."""
    points, frame = flat
    labels: Any = host.regions
    on_surface = host.cells.shape[1] == points.shape[1]
    if on_surface or keep_seams:
        host = with_seams(host) if keep_seams else without_seams(host)
    if host.blocks is not None:
        labels = compact_labels(labels, len(host.cells)).astype(np.int64)
        labels = labels * (int(host.blocks.max()) + 1) + host.blocks
    resized = wanted.linear and options.boundary == "slide"
    given: Any = {"regions": labels, "fixed": options.fixed, "selection": options.selection}
    if on_surface:
        surface = surface_mesh(points, host.cells, orient=options.repair == "orient", **given)
        surface = protect_surface(surface, host.kept, host.anchors, resized=resized,
                                  others=wanted.linear)
        if host.geometry is not None and options.boundary == "fixed":
            surface.fixed[host.geometry.on_curves] = True
        if keep_seams:
            surface = hold_charts(surface, host.blocks)
        surface, notes = hold_places(
            surface, host, periodic="periodic" not in options.free, resized=resized)
        notes += note_kept(surface, host, resized)
        return Prepared(adapter, host, None, surface, 1, notes=notes)
    tangled = False
    try:
        simplices, orientation = simplex_mesh(points, host.cells, **given, threads=options.threads)
    except TangledMeshError:
        if options.repair == "none":
            raise
        simplices, orientation = tangled_mesh(points, host.cells, **given)
        tangled = True
    if frame is not None and 2 * simplices.turned > len(simplices.cells):
        orientation = -1
        simplices = replace(simplices, turned=len(simplices.cells) - simplices.turned)
    simplices, notes = hold_kept(simplices, host, free="inside" in options.free,
                                 advise=not {"free", "free='inside'"} & {*wanted.refused},
                                 resized=resized)
    if options.boundary == "slide":
        simplices, more = hold_places(
            simplices, host, periodic="periodic" not in options.free, resized=resized)
        notes += more
    notes += note_kept(simplices, host, resized)
    work = Prepared(adapter, host, frame, simplices, orientation, notes=notes)
    return _untangled(work, options, wanted) if tangled or wanted.rest is not None else work


def _untangled(work: Prepared, options: Options, wanted: Wanted) -> Prepared:
    """The same mesh without inverted or flat cells, in the type of the caller."""
    host, frame, before = work.host, work.frame, work.mesh

    def places(points: FloatArray) -> tuple[NDArray[Any], FloatArray]:
        n, k = len(before.points), len(points) - len(before.points)
        moved = np.append((points[:n] != before.points).any(axis=1), np.ones(k, dtype=np.bool_))
        written, read = np.pad(host.points, [(0, k), (0, 0)]), points.copy()
        written[moved] = points[moved] if frame is None else frame.to_space(points[moved])
        back = written[moved].astype(np.float64)
        read[moved] = back if frame is None else frame.to_plane(back)
        return written, read

    if wanted.rest is not None:
        rest = rest_places(wanted.rest, host.points, before.cells, frame)
        wanted = wanted._replace(rest=rest)
    mesh, tangle = untangled_around(host, before, lambda mesh: untangle_mesh(
        mesh, options, lambda points: places(points)[1], wanted.seen(host)))
    cells = reverse(mesh.cells, np.full(len(mesh.cells), work.orientation < 0))
    host = replace(host, points=places(mesh.points)[0], cells=cells.astype(host.cells.dtype))
    return work._replace(host=host, mesh=mesh, tangle=tangle)


def _of_soup(
    found: Prepared, work: Callable[..., Prepared], host: HostMesh, same: NDArray[np.int64],
    keep_seams: bool, gone: bool,
) -> Prepared:
    """The curved surface of a soup, vertices at the same place as one; others as they were found.

    Where vertices have texture coordinates those at the same place with others stay apart; not so
    where most cells would, if none is ``gone`` in the result.

    Warns
    -----
    ODTWarning    hardly any vertices may move, since the cells are no such surface
    """
    call = "try merging vertices at the same place"
    why = ""
    if found.mesh.is_surface:
        of_vertices = host.texture is not None and host.texture.ndim == 2
        if of_vertices:
            apart = first_there(np.concatenate([host.points, host.texture], axis=1))
            if gone or same_places(host.points, apart[host.cells.astype(np.int64)]) is None:
                same = apart
        try:
            merged = work(glued(host, same), keep_seams=keep_seams or of_vertices)
        except InvalidMeshError as exc:
            why = f", and do not fit together where vertices at the same place are one ({exc})"
        else:
            fixed = np.zeros(len(same), dtype=np.bool_)
            fixed[same[merged.mesh.fixed]] = True
            used, places = len(np.unique(host.cells)), len(merged.mesh.used)
            there = "gone" if gone else "apart again, at the same place"
            note = host.words(
                f"{used - places} of {used} vertices were at the place of another one and merged "
                f"with it for the work; in the result they are {there}; {call} for a mesh without "
                f"them")
            return merged._replace(
                mesh=replace(merged.mesh, fixed=fixed), same=same,
                notes=(note, *merged.notes) if places < used else merged.notes,
                host=replace(host, blocks=merged.host.blocks))
    note = host.words(
        f"hardly any vertices may move, since the cells share hardly any{why}; {call}")
    warn(note)
    return found._replace(notes=(note,))


def _in_frame(options: Options, frame: PlaneFrame | None) -> Options:
    """Let a density function see the caller's coordinates."""
    density = options.density
    if frame is None or not callable(density):
        return options
    return replace(options, density=lambda x: density(frame.to_space(x)))


def _of_mesh(options: Options, tangle: Tangle | None) -> Options:
    """Say for a mesh that was untangled what was said before: densities, how many vertices come.

    Its cells have the densities of those they come from, inserted vertices those around them; the
    sizes of what stayed are kept. A metric takes the place of a density.
    """
    if tangle is None or options.metric is not None:
        return options
    m, n = len(tangle.before.cells), len(tangle.before.points)
    if options.insert and tangle.added:
        used = len(tangle.before.used)
        left = most_vertices(used, options.insert) / (used + tangle.added) - 1.0
        options = replace(options, insert=left if left > 0.0 else False)
    if isinstance(options.density, str) and options.density == "keep":
        from odt_plugins.engine.untangle.sizes import kept_sizes

        lab = options.smoothing
        if (kept := kept_sizes(tangle.after, tangle.before.points, lab.exponent)) is None:
            return options
        return replace(options, density=kept, smoothing=replace(lab, exponent=None))
    if isinstance(options.density, str) or callable(options.density):
        return options
    values = np.asarray(options.density)
    if values.shape == (n,) and tangle.added:
        cell, weights = surrounding_cells(tangle.around, tangle.after.points[n:])
        more = (values[tangle.before.cells[cell]] * weights).sum(axis=1)
        return replace(options, density=np.append(values, more))
    if values.shape != (m,) or m == n:
        return options
    return replace(options, density=values[tangle.source])


def _as_it_leaves(work: Prepared, threads: int, outcome: Outcome, *, onto: bool = False) -> Outcome:
    """The outcome with the points that the caller will read, and cells in the order of the input's.

    A vertex that did not move keeps the caller's coordinates bit for bit; others are put `onto` the
    geometry if they are on one.
    """
    n = len(work.mesh.points)
    origin = outcome.origin if outcome.origin is not None else np.arange(n)
    moved = (origin < 0) | (outcome.points != work.mesh.points[origin]).any(axis=1)
    written = np.array(work.host.points)[origin]
    points, new = outcome.points.copy(), in_space(work, outcome, moved, onto=onto)
    written[moved] = new
    read = written[moved].astype(np.float64)
    points[moved] = read if work.frame is None else work.frame.to_plane(read)
    outcome = replace(outcome, points=points, written=written)
    cells, regions, source = _sorted_cells(work.mesh, outcome, threads)
    return replace(outcome, cells=cells, regions=regions, source=source)


def _sorted_cells(
    before: SimplexMesh, outcome: Outcome, threads: int
) -> tuple[IntArray, IntArray, IntArray]:
    """Cells, regions and source of :func:`in_input_order`, whatever vertices came and went."""
    points, cells, origin = outcome.points, outcome.cells, outcome.origin
    if origin is None:
        return in_input_order(before, points, cells, outcome.regions, threads)
    n = len(before.points)
    points = in_old_numbers(before.points, points, origin)
    cells, regions, source = in_input_order(
        before, points, old_numbers(origin, n)[cells], outcome.regions, threads
    )
    return new_numbers(origin, n)[cells], regions, source
