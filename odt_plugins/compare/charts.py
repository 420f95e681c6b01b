"""Charts of the page as inline SVG: quality against time, and histograms."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from html import escape

from odt_plugins.compare.rows import MeshResult, Row

COLOURS = {
    "odt-plugins": "#1f5fa8", "gmsh": "#d1603d", "netgen": "#3a8f5c", "mmg": "#8a5fb4",
    "cgal": "#b58b00", "tetwild": "#b03a6f", "laplacian": "#6b7785", "pymeshlab": "#0f8a93",
    "open3d": "#9a5b2f",
}
"""One colour for every family."""

MOST_DOTS = 40
"""Points of a line from which on only the line is drawn."""

INK, GREY, GRID = "#22313f", "#7b8794", "#e3e8ed"


def colour(family: str) -> str:
    """Colour of a family."""
    return COLOURS.get(family, GREY)


def quality_against_time(result: MeshResult) -> str:
    """Draw least, 1 % and mean radius ratio over seconds; the numbers are those of the rows."""
    rows = [(i, r) for i, r in enumerate(result.rows, 1) if r.measured and r.timing]
    if not rows:
        return ""
    width, height, gap = 372, 320, 12
    panels = (("mean radius ratio", "mean_quality"), ("1 % radius ratio", "p1_quality"),
              ("least radius ratio", "min_quality"))
    parts = []
    for k, (title, figure) in enumerate(panels):
        points = [(i, r, r.timing.median, float(getattr(r.measured.summary, figure)))
                  for i, r in rows if r.timing and r.measured]
        start = float(getattr(result.measured.summary, figure))
        body = _scatter(points, start, title, width, height)
        parts.append(f'<g transform="translate({k * (width + gap)},0)">{body}</g>')
    total = 3 * width + 2 * gap
    return (f'<svg class="chart" viewBox="0 0 {total} {height}" role="img" '
            f'aria-label="quality against time on {escape(result.start.name)}">'
            + "".join(parts) + "</svg>")


def _scatter(
    points: Sequence[tuple[int, Row, float, float]], start: float, title: str, width: int,
    height: int,
) -> str:
    left, right, top, bottom = 44, 18, 30, 40
    times = [max(t, 1e-4) for _, _, t, _ in points]
    low_t, high_t = math.floor(math.log10(min(times))), math.ceil(math.log10(max(times)) + 1e-9)
    high_t = max(high_t, low_t + 1)
    values = [max(v, 0.0) for *_, v in points] + [max(start, 0.0)]
    low, high, step = _ticks(min(values), max(values))

    def x(t: float) -> float:
        share = (math.log10(max(t, 1e-4)) - low_t) / (high_t - low_t)
        return left + share * (width - left - right)

    def y(v: float) -> float:
        return height - bottom - (max(v, low) - low) / (high - low) * (height - top - bottom)

    out = [_text(left, 16, title, size=13, weight=600)]
    value = low
    while value <= high + 1e-9:
        out.append(_line(left, y(value), width - right, y(value), GRID))
        out.append(_text(left - 6, y(value) + 4, f"{value:.3g}", anchor="end", fill=GREY))
        value += step
    for power in range(low_t, high_t + 1):
        at = x(10.0**power)
        out.append(_line(at, top, at, height - bottom, GRID))
        label = f"{10.0**power:g}" if power > -3 else f"1e{power}"
        out.append(_text(at, height - bottom + 16, label, anchor="middle", fill=GREY))
    out.append(_text((left + width - right) / 2, height - 6, "seconds", anchor="middle",
                     fill=GREY))
    out.append(f'<line x1="{left}" y1="{y(start):.1f}" x2="{width - right}" y2="{y(start):.1f}" '
               f'stroke="{INK}" stroke-dasharray="4 4" opacity="0.6"/>')
    out.append(_text(width - right, y(start) - 5, "start", anchor="end", fill=GREY))
    for (i, row, _, v), t in sorted(zip(points, times, strict=True),
                                    key=lambda p: p[0][1].family == "odt-plugins"):
        tip = escape(f"{i}. {row.contestant}: {v:.4f} in {t:.3g} s")
        out.append(f'<g><title>{tip}</title><circle cx="{x(t):.1f}" cy="{y(v):.1f}" r="8.5" '
                   f'fill="{colour(row.family)}" stroke="white" stroke-width="1.2" '
                   f'fill-opacity="0.92"/>'
                   + _text(x(t), y(v) + 3.4, str(i), anchor="middle", fill="white", size=9.5,
                           weight=600) + "</g>")
    return "".join(out)


def histograms(result: MeshResult) -> str:
    """Small multiples: the histogram of everybody's radius ratios, that of the start behind."""
    rows = [(i, r) for i, r in enumerate(result.rows, 1) if r.measured]
    if not rows:
        return ""
    across, width, height = 5, 222, 112
    before = [c / sum(result.measured.histogram) for c in result.measured.histogram]
    shares = [[c / sum(r.measured.histogram) for c in r.measured.histogram]
              for _, r in rows if r.measured]
    top = max(max(s) for s in [*shares, before]) * 1.05
    out = []
    for k, ((i, row), share) in enumerate(zip(rows, shares, strict=True)):
        x, y = k % across * (width + 8), k // across * (height + 30)
        body = (_text(0, 14, _clip(f"{i}. {row.contestant}", 40), size=10.5)
                + _steps(before, top, width, height, fill="#c9d1d9")
                + _steps(share, top, width, height, fill=colour(row.family), opacity=0.75)
                + _line(0, height + 4, width, height + 4, GREY))
        ticks = "".join(_text(v * width, height + 16, f"{v:g}", fill=GREY, size=9.5,
                              anchor="start" if v == 0 else "end" if v == 1 else "middle")
                        for v in (0, 0.5, 1))
        out.append(f'<g transform="translate({x},{y})">{body}{ticks}</g>')
    lines = (len(rows) - 1) // across + 1
    return (f'<svg class="chart" viewBox="0 0 {across * (width + 8) - 8} {lines * (height + 30)}" '
            f'role="img" aria-label="histograms of {escape(result.start.name)}">'
            + "".join(out) + "</svg>")


def _steps(
    share: Sequence[float], top: float, width: int, height: int, *, fill: str, opacity: float = 1.0
) -> str:
    base, room = height + 4, height - 18
    bin_width = width / len(share)
    path = [f"M0 {base}"]
    for k, s in enumerate(share):
        at = base - s / top * room
        path.append(f"L{k * bin_width:.1f} {at:.1f}L{(k + 1) * bin_width:.1f} {at:.1f}")
    path.append(f"L{width} {base}Z")
    return f'<path d="{"".join(path)}" fill="{fill}" fill-opacity="{opacity}"/>'


def power_laws(
    title: str, series: Sequence[tuple[str, Sequence[float], Sequence[float]]], x_label: str,
    y_label: str, *, log_x: bool = True, log_y: bool = True,
) -> str:
    """Draw lines through points on (double) logarithmic axes, labelled at their ends.

    Parameters
    ----------
    series : (name, x, y) of every line
    """
    names = [name for name, x, _ in series if len(x)]
    if not names:
        return ""
    width, height, left, right, top, bottom = 560, 340, 62, 150, 32, 42
    xs = [v for _, x, _ in series for v in x]
    ys = [v for _, _, y in series for v in y if v > 0 or not log_y]
    fx, x_ticks = _axis(xs, log_x, left, width - right)
    fy, y_ticks = _axis(ys, log_y, height - bottom, top)
    palette = list(COLOURS.values())
    out = [_text(left, 18, title, size=13, weight=600)]
    for v in x_ticks:
        out.append(_line(fx(v), top, fx(v), height - bottom, GRID))
        out.append(_text(fx(v), height - bottom + 16, f"{v:g}", anchor="middle", fill=GREY))
    for v in y_ticks:
        out.append(_line(left, fy(v), width - right, fy(v), GRID))
        out.append(_text(left - 6, fy(v) + 4, f"{v:.3g}", anchor="end", fill=GREY))
    out.append(_text((left + width - right) / 2, height - 8, x_label, anchor="middle", fill=GREY))
    ends: list[tuple[float, str, str]] = []
    for k, (name, x, y) in enumerate(series):
        shown = [(fx(a), fy(b)) for a, b in zip(x, y, strict=True) if b > 0 or not log_y]
        if not shown:
            continue
        stroke = palette[k % len(palette)]
        line = " ".join(f"{a:.1f},{b:.1f}" for a, b in shown)
        out.append(f'<polyline points="{line}" fill="none" stroke="{stroke}" stroke-width="2"/>')
        if len(shown) < MOST_DOTS:
            out += [f'<circle cx="{a:.1f}" cy="{b:.1f}" r="3" fill="{stroke}"/>'
                    for a, b in shown]
        ends.append((shown[-1][1], name, stroke))
    lowest = -math.inf
    for at, name, stroke in sorted(ends):
        lowest = max(at, lowest + 14)
        out.append(_text(width - right + 8, lowest + 4, name, fill=stroke, size=11))
    label = escape(f"{title}: {y_label} over {x_label}")
    return (f'<svg class="chart half" viewBox="0 0 {width} {height}" role="img" '
            f'aria-label="{label}">' + "".join(out) + "</svg>")


def _axis(
    values: Sequence[float], log: bool, start: float, end: float
) -> tuple[Callable[[float], float], list[float]]:
    if log:
        low = math.floor(math.log10(min(values)))
        high = max(math.ceil(math.log10(max(values)) - 1e-9), low + 1)
        every = max(1, (high - low) // 6)

        def place(v: float) -> float:
            return start + (math.log10(v) - low) / (high - low) * (end - start)

        return place, [10.0**p for p in range(low, high + 1, every)]
    bottom, top, step = _ticks(min(values), max(values))
    count = round((top - bottom) / step)
    return (lambda v: start + (v - bottom) / (top - bottom) * (end - start),
            [bottom + i * step for i in range(count + 1)])


def _ticks(low: float, high: float) -> tuple[float, float, float]:
    """Round limits and a round step with four to eight intervals."""
    span = max(high - low, 1e-9 * max(abs(high), 1.0))
    raw = span / 5
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(m * power for m in (1, 2, 5, 10) if m * power >= raw)
    return math.floor(low / step) * step, math.ceil(high / step + 1e-9) * step, step


def _line(x1: float, y1: float, x2: float, y2: float, stroke: str) -> str:
    return (f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{stroke}"/>')


def _text(
    x: float, y: float, text: str, *, anchor: str = "start", fill: str = INK, size: float = 11,
    weight: int = 400,
) -> str:
    return (f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{fill}" '
            f'font-size="{size}" font-weight="{weight}">{escape(text)}</text>')


def _clip(text: str, length: int) -> str:
    return text if len(text) <= length else text[: length - 1] + "…"
