"""Remeshing from a valid mesh to one that keeps the promise, for every kind of mesh."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from odt_plugins.engine.record.progress import in_attempts
from odt_plugins.engine.remesh.chords import sizes_as_wished
from odt_plugins.engine.remesh.distance import (
    Broken,
    Grounds,
    beyond,
    furthest,
    grounds_of,
    too_far,
)
from odt_plugins.engine.remesh.finish import MORE, Room, finished, sums
from odt_plugins.engine.remesh.notes import (
    told_of_edges,
    told_of_fallen,
    told_of_frozen,
    told_of_triangles,
    told_of_unused,
)
from odt_plugins.engine.remesh.number import (
    NEAR,
    ROUGHLY,
    Goal,
    factor_towards,
    goal_of,
    out_of_reach_told,
)
from odt_plugins.engine.remesh.onto import on_smooth
from odt_plugins.engine.remesh.places import seen_figures
from odt_plugins.engine.remesh.remedies import (
    ATTEMPTS,
    EXTREMES,
    HARDLY_COARSER,
    Attempt,
    nearer,
    remedy,
    told_apart,
)
from odt_plugins.engine.remesh.resized import LONGER, Made, with_sizes
from odt_plugins.engine.remesh.seams import as_sewn, sewn
from odt_plugins.engine.remesh.sizes import Sizes
from odt_plugins.engine.remesh.triangles import resized_triangles
from odt_plugins.engine.remesh.weld import as_welded, welded
from odt_plugins.engine.remesh.wish import Wish
from odt_plugins.engine.run.judge import envelope_length
from odt_plugins.engine.run.outcome import Leaving, Outcome, as_it_is, unchanged
from odt_plugins.errors import InvalidMeshError
from odt_plugins.mesh.arrays import FloatArray
from odt_plugins.mesh.simplex import SimplexMesh, diagonal, vertices_of
from odt_plugins.options import Options
from odt_plugins.progress import part, silent
from odt_plugins.promise.good import good_enough
from odt_plugins.promise.remeshed import broken_by_remeshing

SHARES = (0.7, 0.4)
"""Parts of the envelope within which surfaces are resized, one after the other until the promise
holds; sliding has the rest."""

MOST_STUCK, ALL = 0.5, 1.0
"""Part of the vertices of a surface up to which it may stay finer than asked for without sizes that
give way to it; and that part where fewer cells are tried than such sizes make."""

FEWER = 5
"""Most times that fewer cells are tried."""

HALVINGS, FINER = 2, 1.5
"""Most times that sizes between coarse ones, with which figures fell, and finer ones are tried, and
multiple of the cells of the coarse ones from which on it is worth it."""

class Coarse(NamedTuple):
    """What was resized with which figures fell: its sizes, and how many cells they made."""

    mesh: SimplexMesh
    sizes: Sizes
    cells: int


class Done(NamedTuple):
    """What an attempt makes of a mesh.

    Attributes
    ----------
    outcome : Outcome
    firm : bool               see :class:`~odt_plugins.engine.remesh.finish.Resized`
    broken : Broken or None   of the promise, where that is known before the mesh is judged
    old : Grounds             surfaces of the input, none where these stay
    length : float            that edges were to have, on average
    multiple : (n,) float64   of it that was asked for
    notes : tuple of str
    """

    outcome: Outcome
    firm: bool
    broken: Broken | None = None
    old: Grounds | None = None
    length: float = 0.0
    multiple: FloatArray = np.zeros(0)
    notes: tuple[str, ...] = ()


class Course(NamedTuple):
    """What attempts with some sizes begin with.

    Attributes
    ----------
    room : callable             see :data:`~odt_plugins.engine.remesh.finish.Room`
    known : Attempt or None     what kept the promise with sizes in proportion
    made : Made or None         what the first attempt makes of the mesh, where that is known
    brief : bool                whether those within the first share of the envelope are all
    full : int                  see :class:`~odt_plugins.engine.remesh.remedies.Attempt`
    done : dict or None         what attempts made, by :func:`~.remedies.told_apart`, where they may
                                be judged anew
    """

    room: Room = lambda _: MORE
    known: Attempt | None = None
    made: Made | None = None
    brief: bool = False
    full: int = 0
    done: dict[bytes, Done] | None = None


def remesh(mesh: SimplexMesh, options: Options, leaving: Leaving, wish: Wish) -> Outcome:
    """Give a mesh other sizes.

    Parameters
    ----------
    mesh : SimplexMesh    of any kind
    options : Options     ``density`` holds the lengths if ``wish.given``
    leaving : callable    applied to every mesh before it is judged
    wish : Wish

    Returns
    -------
    Outcome               a mesh that keeps the promise as it leaves, at worst the input itself
    """
    slides = mesh.is_surface and options.boundary == "slide"
    seams = sewn(mesh) if slides else None
    if seams is not None:
        return as_sewn(mesh, seams, options, leaving, partial(remesh, wish=wish))
    small = welded(mesh) if slides else None
    if small is not None:
        return as_welded(mesh, small, options, leaving, partial(remesh, wish=wish))
    clock = time.perf_counter()
    base, sizes = sizes_as_wished(mesh, options, wish)
    unused = told_of_unused(options) if mesh.dim == 2 else ()
    options = replace(
        options, density="keep", smoothing=replace(options.smoothing, exponent=None), insert=False)
    if mesh.frozen.all() or not len(mesh.cells):
        return unchanged(mesh, "no cell may change")
    options = in_attempts(options, "resizing")

    def tries(tried: Sizes, course: Course) -> tuple[Outcome, Attempt | None]:
        if mesh.dim == 2:
            found = resized_triangles(mesh, base, tried, options, leaving)
            # Those tried for a number out of reach are longer than any that it stands for.
            asked = sizes.values if wish.curved else sizes.before_chords(base)
            return found if found.origin is None else replace(
                found, notes=told_of_triangles(mesh, base, asked, found) + found.notes), None
        return _tetrahedra(mesh, base, tried, options, leaving, course)

    def stiff(tried: Sizes, made: Made | None) -> tuple[Outcome, Broken | None]:
        own, course = tried.first(len(mesh.points)), Course(lambda _: 0.0)
        attempt = _first(mesh, own, options, ALL)
        made = made if base is mesh else None
        for _ in range(ATTEMPTS):
            outcome, broken = _once(attempt, own.values, options, leaving, course, made)
            if broken is None:
                break
            following, falls = remedy(mesh, attempt, outcome, broken, options)
            if following is None or falls:
                break
            attempt, made = following._replace(why=broken.why), None
        return told_of_frozen(
            mesh, attempt.mesh, outcome, attempt.why, boundary=False), broken

    goal = goal_of(wish, mesh.dim)
    outcome = (tries(sizes, Course())[0] if goal is None
               else _towards(goal, base, sizes, options, tries, stiff))
    rest = time.perf_counter() - clock - sum(outcome.times.values())
    return replace(outcome, notes=unused + sizes.notes + outcome.notes,
                   times=sums(outcome.times, {"checks and other attempts": rest}))


def _towards(
    goal: Goal, mesh: SimplexMesh, sizes: Sizes, options: Options,
    tries: Callable[[Sizes, Course], tuple[Outcome, Attempt | None]],
    stiff: Callable[[Sizes, Made | None], tuple[Outcome, Broken | None]],
) -> Outcome:
    """A mesh with about so many cells or vertices.

    Tetrahedra are resized until their number is about right before a mesh is finished and judged;
    what that changes is corrected then, but where resizing cannot reach the number. Where there are
    more then, sizes that do not give way to a surface make fewer, poorer ones.
    """
    nearest: dict[float, Made] = {}
    resizings: dict[float, int] = {}
    best, spent = unchanged(mesh, ""), 0.0
    known: Attempt | None = None

    def resized(factor: float, stuck: float = MOST_STUCK) -> int | None:
        nonlocal spent
        scaled, clock = sizes.scaled(factor), time.perf_counter()
        tick = partial(part(options.progress or silent, 0.0, 0.4), "resizing")
        try:
            made = with_sizes(_first(mesh, scaled, options, stuck), scaled.values, options, tick)
        except InvalidMeshError:
            return None
        finally:
            spent += time.perf_counter() - clock
        off = goal.off(made[0].outcome)
        if all(off < goal.off(other.outcome) for other, _ in nearest.values()):
            nearest.clear()
            nearest[factor] = made
        resizings[factor] = goal.count(made[0].outcome)
        if goal.crowded and factor == 1.0:
            goal.crowded(resizings[factor] / goal.number)
        return resizings[factor]

    def kept(factor: float) -> int | None:
        nonlocal best, known
        outcome, last = tries(sizes.scaled(factor), Course(
            lambda found: min(MORE, goal.number / goal.count(found) - 1.0), known,
            nearest.pop(factor, None), brief=factor != 1.0))
        known = known or last
        if best.origin is None or (
                outcome.origin is not None and goal.off(outcome) < goal.off(best)):
            best = outcome
        return None if outcome.origin is None else goal.count(outcome)

    factor, out_of_reach = 1.0, False
    if mesh.dim == 3:
        factor = factor_towards(goal, resized, lambda: NEAR, factor)
        out_of_reach = any(goal.off(made[0].outcome) > ROUGHLY for made in nearest.values())
    as_resized = resizings.copy()
    factor_towards(goal, kept, lambda: math.inf if out_of_reach else ROUGHLY if known else NEAR,
                   factor, lambda: {} if known else as_resized)
    more = goal.count(best) > goal.number and goal.off(best) > ROUGHLY
    if more and mesh.dim == 3 and options.boundary == "slide" and not len(mesh.metric):
        nearest.clear()
        factor = factor_towards(goal, partial(resized, stuck=ALL), lambda: ROUGHLY, 1.0)
        for _ in range(FEWER if factor > 1.0 else 0):
            outcome, broken = stiff(sizes.scaled(factor), nearest.pop(factor, None))
            if broken is None or goal.off(outcome) > goal.off(best):
                best = best if broken else min(best, outcome, key=goal.off)
                break
            factor = math.sqrt(factor)
    if mesh.dim == 3:
        best = replace(best, times=sums(best.times, {"resizing": spent}))
    if goal.off(best) > NEAR:
        note = out_of_reach_told(goal, goal.count(best), mesh, options)
        best = replace(best, notes=(note, *best.notes))
    return best


def _tetrahedra(
    mesh: SimplexMesh, base: SimplexMesh, sizes: Sizes, options: Options, leaving: Leaving,
    course: Course,
) -> tuple[Outcome, Attempt | None]:
    """Resize tetrahedra; where they hardly become coarser good ones may become fewer, as poor ones
    do not.

    Also the attempt that kept the promise, with which sizes in proportion may begin; None of the
    first attempt, or where none kept the promise.
    """
    strict = course.known is None or not course.known.full
    good = good_enough(tuple(options.keep), 4)
    fewer = (good and sizes.first(len(mesh.points)).cells < len(mesh.cells)
             and seen_figures(mesh).small_angles > good["share_below_20"])
    course = course._replace(done={} if fewer else None)
    found, last = (
        _with_base(mesh, base, sizes, options, leaving, course) if strict
        else (unchanged(mesh, ""), None))
    sizes = sizes.first(len(mesh.points))
    enough = found.origin is not None and (
        last is None or len(found.points) <= HARDLY_COARSER * len(mesh.points)
        or len(found.cells) <= FINER * sizes.cells)
    if enough or not fewer:
        return found, last
    other, then = _tries(mesh, sizes, options, leaving,
                         course._replace(made=None, full=len(mesh.cells)))
    if other is None or not len(other.points) < len(found.points):
        return found, last
    return told_of_fallen(mesh, other, options), then


def _with_base(
    mesh: SimplexMesh, base: SimplexMesh, sizes: Sizes, options: Options, leaving: Leaving,
    course: Course,
) -> tuple[Outcome, Attempt | None]:
    """As :func:`_tetrahedra`, with more vertices where sizes need them if the promise holds so."""
    n = len(mesh.points)

    def own(outcome: Outcome) -> Outcome:
        origin = np.arange(len(outcome.points)) if outcome.origin is None else outcome.origin
        return replace(outcome, origin=np.where(origin < n, origin, -1))

    if base is not mesh:
        if course.known is None or len(course.known.mesh.points) > n:
            found, last = _tries(
                base, sizes, options, lambda outcome: leaving(own(outcome)), course)
            if found is not None:
                found = own(found)
                origin: Any = found.origin
                if not broken_by_remeshing(
                        mesh, found.points, found.cells, found.regions, origin,
                        tuple(options.keep), found.metric, found.faces, slides=True,
                        threads=options.threads):
                    return found, last
            course = course._replace(known=None)
        sizes, course = sizes.first(n), course._replace(made=None)
    found, last = _tries(mesh, sizes, options, leaving, course)
    if found is not None:
        return found, last
    outcome = leaving(unchanged(mesh, "no other sizes kept the promise"))
    advice = "; try a metric that is stretched less" if len(mesh.metric) else ""
    if advice and EXTREMES & {*options.keep}:
        advice += ", or keep mean_quality and p1_quality alone"
    why = last.why if last else ""
    return replace(outcome, fallback=f"the input is returned, since {why}{advice}"), None


def _tries(
    mesh: SimplexMesh, sizes: Sizes, options: Options, leaving: Leaving, course: Course,
) -> tuple[Outcome | None, Attempt | None]:
    """Resize until the promise holds; None where it does not.

    Also the last attempt; None where the first kept the promise.

    Within each share of the envelope :func:`remedy` says what is tried next. Then sizes are halfway
    to those of the input where figures still fall, and the share is smaller; at last the boundary
    stays. Where sizes gave way, coarser ones are looked for, see :func:`_less_fine`. What kept the
    promise with sizes in proportion is begun with, and its share is the only one.
    """
    slides, falls = options.boundary == "slide", False
    attempt = _first(mesh, sizes, options)._replace(full=course.full)
    shares = (*(SHARES if slides else ()), 0.0)
    known, made = course.known, course.made
    if known is not None:
        factor = float(sizes.asked[0] / known.sizes.asked[0])
        attempt, shares = known._replace(sizes=known.sizes.scaled(factor)), (known.share,)
        made = None
    for share in shares[:1] if course.brief else shares:
        following: Attempt | None = attempt._replace(share=share)
        coarse: Coarse | None = None
        for _ in range(ATTEMPTS):
            if following is None:
                break
            attempt = following
            outcome, broken = _once(attempt, sizes.values, options, leaving, course, made)
            made = None
            if broken is None:
                if (coarse is not None and known is None and attempt.mesh is coarse.mesh
                        and attempt.sizes is not coarse.sizes):
                    attempt, outcome = _less_fine(attempt, outcome, coarse, lambda other: _once(
                        other, sizes.values, options, leaving, course, None))
                outcome = told_of_frozen(mesh, attempt.mesh, outcome, attempt.why,
                                         boundary=slides and share == 0.0)
                return outcome, attempt if attempt.why or attempt.full else None
            following, falls = remedy(mesh, attempt, outcome, broken, options)
            coarse = Coarse(attempt.mesh, attempt.sizes, len(outcome.cells)) if falls else None
            attempt = attempt._replace(why=broken.why)
            following = following and following._replace(why=broken.why)
        attempt = (following or attempt)._replace(mesh=mesh)
        if falls:
            halfway = nearer(mesh, attempt.sizes, np.zeros(len(mesh.cells), dtype=np.bool_))
            attempt = attempt._replace(sizes=halfway or attempt.sizes)
    return None, attempt


def _less_fine(
    fine: Attempt, found: Outcome, coarse: Coarse,
    once: Callable[[Attempt], tuple[Outcome, Broken | None]],
) -> tuple[Attempt, Outcome]:
    """An attempt that kept the promise, or one with sizes nearer to coarse ones that does, too.

    The geometric mean of both is tried while the finer ones make FINER times as many cells.
    """
    for _ in range(HALVINGS):
        if len(found.cells) <= FINER * coarse.cells:
            break
        middle = np.sqrt(fine.sizes.values * coarse.sizes.values)
        other = fine._replace(sizes=coarse.sizes.below(fine.mesh, middle))
        outcome, broken = once(other)
        if broken is None and len(outcome.cells) < len(found.cells):
            fine, found = other, outcome
        else:
            coarse = coarse._replace(sizes=other.sizes, cells=len(outcome.cells))
    return fine, found


def _first(
    mesh: SimplexMesh, sizes: Sizes, options: Options, stuck: float = MOST_STUCK
) -> Attempt:
    """The attempt that comes first."""
    share = SHARES[0] if options.boundary == "slide" else 0.0
    return Attempt(mesh, sizes, np.ones(len(mesh.points)), 0.0 if len(mesh.metric) else stuck,
                   share)


def _once(
    attempt: Attempt, asked: FloatArray, options: Options, leaving: Leaving, course: Course,
    made: Made | None,
) -> tuple[Outcome, Broken | None]:
    """Resize within a share of the envelope, optimise within the rest, and judge."""
    known = {} if course.done is None else course.done
    key = told_apart(attempt)
    done = known.pop(key, None)
    if done is None:
        done = _completed(attempt, asked, options, leaving, course.room, made)
        if course.done is not None and not attempt.full:
            known[key] = done
    outcome, broken = _judged(attempt, done, options)
    return outcome, broken and broken._replace(firm=done.firm)


def _completed(
    attempt: Attempt, asked: FloatArray, options: Options, leaving: Leaving, room: Room,
    made: Made | None,
) -> Done:
    """Resize, unless that is done, and optimise within the rest of the envelope."""
    clock, report = time.perf_counter(), options.progress or silent
    mesh, share = attempt.mesh, attempt.share
    try:
        given, log = made or with_sizes(
            attempt, asked, options, partial(part(report, 0.0, 0.4), "resizing"))
    except InvalidMeshError:
        why = "cells overlap where the surface folded over itself"
        return Done(unchanged(mesh, why), False, Broken(why))
    firm, resized, envelope = given.firm, given.outcome, envelope_length(mesh, options)
    onto = mesh.smooth if share > 0.0 else None
    left, old = envelope, None
    if share > 0.0:
        old = grounds_of(mesh)
        far = furthest(old, resized, envelope - mesh.sag)
        left = envelope - max(far[0], far[1]) - mesh.sag
        if not left > 0.0:
            broken = too_far(f"the resized surface is {max(far):.3g}", envelope)
            return Done(resized, firm, broken)
    times = {"resizing": time.perf_counter() - clock}
    inner = replace(
        options, boundary="slide" if share > 0.0 else "fixed",
        envelope=min(0.5, left / diagonal(resized.points[vertices_of(resized.cells)])),
        progress=part(report, 0.4, 0.8 if onto else 1.0),
    )
    if onto is None:
        done, told = finished(mesh, given, inner, leaving, room)
    else:
        done, told = finished(mesh, given, inner, as_it_is, lambda _: 0.0)
    off: tuple[str, ...] = ()
    if onto is not None and told:
        outcome, off = on_smooth(done.outcome, onto)
        times |= outcome.times
        log.counts |= outcome.counts
        inner = replace(inner, boundary="fixed", progress=part(report, 0.8, 1.0))
        given = done._replace(outcome=outcome)
        done, told = finished(mesh, given, inner, leaving, room)
    outcome = replace(done.outcome, times=sums(times, done.outcome.times),
                      counts=sums(log.counts, done.outcome.counts))
    if not told:
        return Done(outcome, firm, Broken("labels of the surface cannot be told apart"))
    return Done(outcome, firm, None, old, given.lengths.mean() / LONGER, done.multiple, off)


def _judged(attempt: Attempt, done: Done, options: Options) -> tuple[Outcome, Broken | None]:
    """Hold what an attempt made against the promise, and say of it what there is to say."""
    mesh, slides, outcome, broken = attempt.mesh, attempt.share > 0.0, done.outcome, done.broken
    if broken is not None:
        return outcome, broken
    origin: Any = outcome.origin
    others = broken_by_remeshing(
        mesh, outcome.points, outcome.cells, outcome.regions, origin, tuple(options.keep),
        outcome.metric, outcome.faces, slides=slides, threads=options.threads,
        full=attempt.full, figures=partial(outcome.figures, options.threads))
    if others:
        return outcome, Broken(others[0])
    if done.old is not None:
        broken, slid = beyond(mesh, done.old, outcome, envelope_length(mesh, options))
        outcome = replace(outcome, slid=slid)
    notes = told_of_edges(outcome, done.length, done.multiple)
    return replace(outcome, notes=notes + done.notes), broken
