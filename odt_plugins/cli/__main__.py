"""``python -m odt_plugins.cli``: the command line without its script."""

import sys

from odt_plugins.cli.main import main

sys.exit(main())
