#!/usr/bin/env bash
# Sets up what the tests need, then runs ruff, mypy and pytest. Quick the second time.
#   bash tests/run.sh [arguments of pytest]
# Without arguments the numerical tests run again for other processors: a newer one's BLAS, then an
# older one's, with kernels without the instructions that came after SSE4.2; and the runs for which
# kernels are compiled at installation, with kernels that check every index.
# Uses the active virtual environment, or makes .venv beside pyproject.toml.
set -euo pipefail
cd "$(dirname "$0")/.."
. tests/environment.sh
# Hundreds of processes import the same toolkits: what Python compiles of them is kept.
unset PYTHONDONTWRITEBYTECODE
# Two processes test side by side. Threads of BLAS would only take their time, waiting for work.
export OPENBLAS_NUM_THREADS="${OPENBLAS_NUM_THREADS:-1}"

WHOLE="tests/engine/run/test_bits.py"
PARTS="tests/paper/test_paper_energy.py tests/paper/test_paper_global.py
       tests/paper/test_paper_gradient.py tests/paper/test_paper_smoothing.py"

newer() { OPENBLAS_CORETYPE=Haswell python -m pytest -p no:cacheprovider "$@"; }

# The name alone leaves numba the features of this machine.
older() {
    OPENBLAS_CORETYPE=Prescott NUMBA_CPU_NAME=x86-64-v2 \
    NUMBA_CPU_FEATURES="+64bit,+cmov,+cx16,+cx8,+fxsr,+mmx,+popcnt,+sahf,+sse,+sse2,+sse3,+ssse3,+sse4.1,+sse4.2" \
        python -m pytest -p no:cacheprovider "$@"
}

enter_environment
# Side by side, as each keeps one core busy; whatever fails, packages are never left half installed.
system=""
trap '[ -z "$system" ] || wait "$system"' EXIT
if can_install; then system_packages & system=$!; else system_packages; fi
install_package "all,test"

echo "== ruff";   python -m ruff check .
echo "== mypy";   python -m mypy
if [ -n "$system" ]; then wait "$system"; fi
echo "== pytest"
if [ $# -gt 0 ]; then
    python -m pytest "$@"
    exit
fi
# Tests that stand together run in the same process, which imports their toolkits once.
python -m pytest -n 2 --dist worksteal
[ "$(uname -m)" = x86_64 ] || exit 0
# Whole runs compile all their kernels for the older processor: the rest goes on beside them.
echo "== pytest, numerical tests, BLAS of Prescott and kernels for x86-64-v2, whole runs"
told="$(mktemp)" failed=0
{
    echo "== pytest, numerical tests, BLAS of Haswell"
    newer $WHOLE $PARTS || failed=1
    echo "== pytest, numerical tests, BLAS of Prescott and kernels for x86-64-v2, the rest"
    older $PARTS || failed=1
    echo "== runs of the installation, every index checked"
    checked="$(mktemp -d)"
    NUMBA_BOUNDSCHECK=1 python -m odt_plugins.ahead "$checked" || failed=1
    rm -r "$checked"
    exit $failed
} >"$told" 2>&1 &
beside=$!
older $WHOLE || failed=1
wait $beside || failed=1
cat "$told"
rm "$told"
exit $failed
