#!/usr/bin/env bash
# Sets up what the tests need, then runs ruff, mypy and pytest. Quick the second time.
#   bash tests/run.sh [arguments of pytest]
# Without arguments the numerical tests run again for other processors: BLAS of two kinds, and
# kernels without the instructions that came after SSE4.2.  Those and mypy run beside the tests, of
# which many wait, and are told after them.
# Uses the active virtual environment, or makes .venv beside pyproject.toml.
set -euo pipefail
cd "$(dirname "$0")/.."
. tests/environment.sh

NUMERICAL="tests/engine/run/test_bits.py tests/paper/test_paper_energy.py
           tests/paper/test_paper_global.py tests/paper/test_paper_gradient.py
           tests/paper/test_paper_smoothing.py"

# Kernels for x86-64-v2 come first: meanwhile the tests compile what the other two share with them.
beside_the_tests() {
    echo "== mypy"; python -m mypy
    [ "$(uname -m)" = x86_64 ] || return 0
    echo "== pytest, numerical tests, kernels for x86-64-v2"
    # The name alone leaves numba the features of this machine.
    NUMBA_CPU_NAME=x86-64-v2 \
    NUMBA_CPU_FEATURES="+64bit,+cmov,+cx16,+cx8,+fxsr,+mmx,+popcnt,+sahf,+sse,+sse2,+sse3,+ssse3,+sse4.1,+sse4.2" \
        python -m pytest $NUMERICAL
    local core
    for core in Prescott Haswell; do
        echo "== pytest, numerical tests, BLAS of $core"
        OPENBLAS_CORETYPE="$core" python -m pytest $NUMERICAL
    done
}

system_libraries
system_browser
system_paraview
use_environment "all,test"

echo "== ruff";   python -m ruff check .
if [ $# -gt 0 ]; then
    echo "== mypy";   python -m mypy
    echo "== pytest"; python -m pytest "$@"
    exit
fi
said="$(mktemp)"
# A group of its own, so that all of it ends with this script.
set -m
beside_the_tests > "$said" 2>&1 &
set +m
beside=$!
trap 'kill -- "-$beside" 2>/dev/null || true; rm -f "$said"' EXIT
trap 'exit 130' INT
trap 'exit 143' TERM
status=0
echo "== pytest"; python -m pytest -n 2 || status=$?
wait "$beside" || status=$?
cat "$said"
exit "$status"
