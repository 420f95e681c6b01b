#!/usr/bin/env bash
# Sets up what the tests need, then runs ruff, mypy and pytest, the numerical tests as other kinds of
# processors too. Quick the second time.
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
if [ $# -gt 0 ]; then exec python -m pytest "$@"; fi
python -m pytest -n 2

# What is computed must not hang on the kind of processor: the same tests as other kinds run them.
NUMERICAL="tests/paper tests/engine/odt tests/engine/cells"
for core in Haswell Prescott SkylakeX; do
    echo "== pytest, OPENBLAS_CORETYPE=$core"
    OPENBLAS_CORETYPE=$core python -m pytest -n 2 $NUMERICAL -k "not examples"
done
echo "== pytest, NUMBA_CPU_NAME=x86-64-v2"
NUMBA_CPU_NAME=x86-64-v2 NUMBA_CPU_FEATURES= python -m pytest -n 2 $NUMERICAL -k "not examples"
