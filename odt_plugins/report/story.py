"""The story that a report tells under its table, line by line."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from odt_plugins.errors import counted
from odt_plugins.mesh.numbering import AS_MANY_AS_PAY, most_vertices
from odt_plugins.report.binding import free_option, joined_lines


def story(report: Any) -> list[str]:
    """How the run of a :class:`odt_plugins.Report` went, line by line."""
    lines = [f"{report.n_movable} of {report.n_used} vertices may move "
             f"({100 * report.movable_share:.0f} %)"] if report.n_used else []
    if report.regions_from:
        names = ", ".join(map(repr, report.regions_from))
        lines.append(f"regions are those of {names}, with the interfaces between them")
    if report.interpolated:
        names = ", ".join(map(repr, report.interpolated))
        lines.append(f"fields interpolated at the new places of vertices: {names}")
    if report.layers:
        free = free_option((*report.options["free"], "layers")).replace('"', "'")
        lines.append(
            f"layers {report.layers} cells that are stretched alike with their neighbours stay "
            f"as they are; {free} lets them change")
    for kind, changes in (("cell", report.integrals), ("point", report.point_integrals)):
        if changes:
            told = ", ".join(f"{name!r} by {change:.3g}" for name, change in changes.items())
            lines.append(f"integrals of {kind} arrays changed, relative to those of absolute "
                         f"values: {told}")
    lines += [f"note   {note}" for note in report.notes]
    if report.untangled:
        lines += _untangled_lines(report.untangled)
    if report.curved:
        lines += _curved_lines(report.curved)
    if report.surface:
        lines += _surface_lines(report.surface)
    if report.energy:
        first, last = report.energy[0][1], report.energy[-1][1]
        lines.append(f"energy {first:.6g} -> {last:.6g}")
    if report.times:
        parts = ", ".join(f"{name} {seconds:.2f} s" for name, seconds in report.times.items())
        lines.append(f"time   {parts}")
    if report.counts:
        lines.append("counts " + ", ".join(f"{k} {v}" for k, v in report.counts.items()))
    if full := _full(report):
        lines.append(full)
    if report.slid:
        text = ("slid   {vertices} vertices; {forward:.3g} and {backward:.3g} from surface to "
                "surface, at most {envelope:.3g}; volume {volume:+.3%}")
        lines.append(text.format(**report.slid))
    if report.filled:
        lines.append(f"filled {report.filled}")
    if report.stop_reason:
        lines.append(f"ended  {report.stop_reason}")
    if report.fallback:
        lines.append(f"fell back: {report.fallback}{_past_crossings(report)}")
    if report.vetoed:
        lines.append(_veto_line(report.vetoed, report.options))
    if report.binding:
        lines += ["", "what binds the minimum:"]
        lines += [f"  {line}" for line in joined_lines(report.binding, 5)]
    for number, part in enumerate(report.parts):
        lines += ["", f"part {number} {part.name!r}", *str(part).split("\n")]
    return lines


def _veto_line(facts: Mapping[str, Any], options: Mapping[str, Any]) -> str:
    """Say which figures made a state be refused, its quality, and the option that accepts it."""
    worse = ", ".join(f"{name} ({there:.4g}, before {old:.4g})"
                      for name, (old, there) in facts["worse"].items())
    left = tuple(name for name in options["keep"] if name not in facts["worse"])
    return (f"veto   of {worse}: a state with mean q {facts['mean_quality']:.3f} and least q "
            f"{facts['min_quality']:.3f} was refused; try keep={left!r}")


def _past_crossings(report: Any) -> str:
    """End of a sentence: what to try where a surface that moved went through itself."""
    if not re.search("through (itself|other triangles)", report.fallback or ""):
        return ""
    return f"; try envelope={0.5 * report.options['envelope']:g}"


def _full(report: Any) -> str:
    """Say that no more vertices could come, and how to let them."""
    insert = report.options.get("insert")
    added = report.counts.get("vertices added", 0)
    if not insert or not 0 < most_vertices(report.n_used, insert) - report.n_used <= added:
        return ""
    share = 2.0 * (AS_MANY_AS_PAY if insert is True else insert)
    return (f"size   {counted(added, 'vertex', 'vertices')} came, as many as may by insert="
            f"{insert}; try insert={share:g}")


def _curved_lines(facts: Mapping[str, float]) -> list[str]:
    """How good curved cells are, and what was held for them."""
    text = ("curved {cells} cells; least scaled Jacobian {least_before:.4f} -> {least_after:.4f}, "
            "mean {mean_before:.4f} -> {mean_after:.4f}")
    lines = [text.format(**facts)]
    folded, held = int(facts.get("folded", 0)), int(facts["vertices_held"])
    if folded:
        cells = counted(folded, "valid curved cell is", "valid curved cells are")
        lines.append(f"note   {cells} folded, since the mesh was untangled; try repair='none', or "
                     f"moving what is inverted")
    if held:
        vertices = counted(held, "vertex stays", "vertices stay")
        lines.append(f"note   {vertices}, since curved cells there would be folded or have a "
                     f"smaller scaled Jacobian")
    return lines


def _untangled_lines(facts: Mapping[str, Any]) -> list[str]:
    """Say what was done to a mesh with inverted or flat cells."""
    lines = [f"untangled {facts['inverted']} inverted and {facts['flat']} flat cells: "
             f"{counted(facts['moved'], 'vertex', 'vertices')} moved, {facts['added']} added, "
             f"{counted(facts['flips'], 'flip')}; {facts['left']} left"]
    if facts["worse"]:
        lines.append(f"of the valid cells of the input {', '.join(facts['worse'])}")
    return lines


def _surface_lines(facts: Mapping[str, float]) -> list[str]:
    size = facts["diagonal"]
    return [
        f"features {facts['feature_edges']} edges with {facts['corners']} corners; "
        f"{facts['on_lines']} vertices slide along them, {facts['held']} are held",
        f"distance {facts['forward']:.4g} to the input, {facts['backward']:.4g} from it, at "
        f"most {facts['envelope']:.4g} allowed ({facts['forward'] / size:.3g}, "
        f"{facts['backward'] / size:.3g}, {facts['envelope'] / size:.3g} of the diagonal)",
    ]
