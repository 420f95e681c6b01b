"""``python tests/measure``: see :mod:`measure.command`."""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parent.parent)

from measure.command import main  # noqa: E402

main()
