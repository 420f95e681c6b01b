"""Pictures of the examples, drawn small: what they hold is seen as well on fewer dots."""

from __future__ import annotations

from typing import Any

import pytest


def draw_small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are written with half as many dots per inch."""
    from matplotlib.figure import Figure

    write = Figure.savefig

    def small(figure: Figure, *args: Any, dpi: float, **more: Any) -> None:
        write(figure, *args, dpi=dpi / 2, **more)

    monkeypatch.setattr(Figure, "savefig", small)
