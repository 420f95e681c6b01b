#!/usr/bin/env bash
# Sets up what the tests need, then runs ruff, mypy and pytest. Quick the second time.
#   bash tests/run.sh [arguments of pytest]
# Uses the active virtual environment, or makes .venv beside pyproject.toml.
set -euo pipefail
cd "$(dirname "$0")/.."
. tests/environment.sh

system_libraries
system_browser
use_environment "all,test"

# Cached kernels do not notice that a kernel of another file changed, so every state of the
# engine has a cache of its own.
NUMBA_CACHE_DIR="$VIRTUAL_ENV/kernels/$(cat odt_plugins/engine/{,surface/}*.py | cksum | cut -d ' ' -f 1)"
export NUMBA_CACHE_DIR

echo "== ruff";   python -m ruff check .
echo "== mypy";   python -m mypy
echo "== pytest"
if [ $# -eq 0 ]; then set -- -n 2; fi
python -m pytest "$@"
