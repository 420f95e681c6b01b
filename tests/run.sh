#!/usr/bin/env bash
# Sets up what the tests need, then runs ruff, mypy and pytest. Quick the second time.
#   bash tests/run.sh [arguments of pytest]
#   bash tests/run.sh --lowest [arguments of pytest]
#   bash tests/run.sh --indices
# The second runs some tests in .venv-lowest, which has the lowest versions of all dependencies that
# pyproject.toml allows, toolkits excepted; numba compiles the kernels that they need, once.
# The third does the runs of odt_plugins/ahead.py with kernels that numba compiles for x86-64-v2 and
# that check every index.
# Without arguments the numerical tests run again with the BLAS of a newer processor, and with that of
# an older one and the kernels that the library has for it.
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

LOWEST="tests/adapters/test_adapters_files.py tests/cli/test_cli.py tests/mesh tests/promise
        tests/report tests/carrying/test_reference.py tests/carrying/test_transfer.py"

newer() { OPENBLAS_CORETYPE=Haswell nice -n 19 python "$@"; }

# Without features of its own numba takes those of the name.
older() {
    OPENBLAS_CORETYPE=Prescott NUMBA_CPU_NAME=x86-64-v2 NUMBA_CPU_FEATURES="" \
        nice -n 19 python "$@"
}

tested() { "$1" -m pytest -p no:cacheprovider -o timeout=1200 "${@:2}"; }

if [ "${1:-}" = --lowest ]; then
    shift
    [ $# -gt 0 ] || set -- $LOWEST
    make_lowest
    echo "== pytest, lowest versions"
    PYTHONPATH="$PWD" exec .venv-lowest/bin/python -m pytest -p no:cacheprovider -o timeout=1200 "$@"
fi
enter_environment
# Side by side, as each keeps one core busy; whatever fails, packages are never left half installed.
system=""
trap '[ -z "$system" ] || wait "$system"' EXIT
if can_install; then system_packages & system=$!; else system_packages; fi
install_package "all,site,test"

if [ "${1:-}" = --indices ]; then
    [ -z "$system" ] || wait "$system"
    for name in cells triangles; do
        echo "== runs of the installation, $name, every index checked"
        NUMBA_BOUNDSCHECK=1 older -c "from odt_plugins.ahead import run; run('$name')"
    done
    exit
fi

echo "== ruff";   python -m ruff check .
if [ -n "$system" ]; then wait "$system"; fi
if [ $# -gt 0 ]; then
    echo "== mypy";   python -m mypy
    echo "== pytest"; python -m pytest "$@"
    exit
fi
told="$(mktemp -d)" failed=0
trap 'rm -r "$told"' EXIT
# All else is done whenever a test waits for what it started, two by two when all tests are done.
# Tests that stand together run in the same process, which imports their toolkits once.
{
    failed=0
    echo "== mypy"
    nice -n 19 python -m mypy || failed=1
    if [ "$(uname -m)" = x86_64 ]; then
        echo "== pytest, numerical tests, BLAS of Haswell"
        tested newer $PARTS || failed=1
    fi
    exit $failed
} >"$told/one" 2>&1 &
one=$!
{
    [ "$(uname -m)" = x86_64 ] || exit 0
    echo "== pytest, numerical tests, BLAS of Prescott, kernels for x86-64-v2"
    failed=0
    tested older $WHOLE || failed=1
    tested older $PARTS || failed=1
    exit $failed
} >"$told/other" 2>&1 &
other=$!
echo "== pytest"
python -m pytest -n 2 --dist worksteal || failed=1
wait $one || failed=1
wait $other || failed=1
cat "$told/one" "$told/other"
exit $failed
