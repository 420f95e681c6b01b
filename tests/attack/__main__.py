"""``python tests/attack``: see :mod:`attack.command`."""

import sys
from pathlib import Path

TESTS = Path(__file__).resolve().parent.parent
sys.path[:1] = [str(TESTS), str(TESTS / "helpers")]

from attack.command import main  # noqa: E402

main()
