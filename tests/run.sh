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

echo "== ruff";   python -m ruff check .
echo "== mypy";   python -m mypy
echo "== pytest"
if [ $# -eq 0 ]; then set -- -n 2; fi
python -m pytest "$@"
