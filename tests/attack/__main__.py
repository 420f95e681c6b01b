"""``python tests/attack``: see :mod:`attack.command`."""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parent.parent)

from attack.command import main  # noqa: E402

main()
