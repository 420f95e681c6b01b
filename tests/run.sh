#!/usr/bin/env bash
# Sets up what the tests need, then runs ruff, mypy and pytest. Quick the second time.
#   bash tests/run.sh [arguments of pytest]
# Without arguments the numerical tests run again for other processors: a newer one's BLAS, then an
# older one's, with kernels without the instructions that came after SSE4.2.
# Uses the active virtual environment, or makes .venv beside pyproject.toml.
set -euo pipefail
cd "$(dirname "$0")/.."
. tests/environment.sh
# Hundreds of processes import the same toolkits: what Python compiles of them is kept.
unset PYTHONDONTWRITEBYTECODE

NUMERICAL="tests/engine/run/test_bits.py tests/paper/test_paper_energy.py
           tests/paper/test_paper_global.py tests/paper/test_paper_gradient.py
           tests/paper/test_paper_smoothing.py"

system_libraries
system_browser
system_paraview
use_environment "all,test"

echo "== ruff";   python -m ruff check .
echo "== mypy";   python -m mypy
echo "== pytest"
if [ $# -gt 0 ]; then
    python -m pytest "$@"
    exit
fi
# Tests that stand together run in the same process, which imports their toolkits once.
python -m pytest -n 2 --dist worksteal
[ "$(uname -m)" = x86_64 ] || exit 0
# Side by side with one worker each: two workers would compile the same kernels for x86-64-v2.
echo "== pytest, numerical tests, BLAS of Prescott and kernels for x86-64-v2"
told="$(mktemp)" failed=0
OPENBLAS_CORETYPE=Haswell python -m pytest -p no:cacheprovider $NUMERICAL >"$told" 2>&1 &
haswell=$!
# The name alone leaves numba the features of this machine.
OPENBLAS_CORETYPE=Prescott NUMBA_CPU_NAME=x86-64-v2 \
NUMBA_CPU_FEATURES="+64bit,+cmov,+cx16,+cx8,+fxsr,+mmx,+popcnt,+sahf,+sse,+sse2,+sse3,+ssse3,+sse4.1,+sse4.2" \
    python -m pytest -p no:cacheprovider $NUMERICAL || failed=1
wait $haswell || failed=1
echo "== pytest, numerical tests, BLAS of Haswell"
cat "$told"
rm "$told"
exit $failed
