#!/usr/bin/env bash
# Puts the wheel into empty environments, and prints a table of what a first run takes there.
#   bash tests/clean.sh
# First every Python from 3.11 on that is on the path, without numba; then, without the library,
# versions of numba. A run optimises the stored bunny with no HOME, no compiler and packages that
# cannot be written to; by root, as nobody if that one may run Python.
set -euo pipefail
unset PYTHONPATH
cd "$(dirname "$0")/.."
made="$(mktemp -d)"
trap 'chmod -R u+w "$made"; rm -r "$made"' EXIT
chmod 755 "$made"
python -m pip wheel -q --disable-pip-version-check --no-deps -w "$made" .
nobody=""
[ "$(id -u)" != 0 ] || nobody="setpriv --reuid=65534 --regid=65534 --clear-groups"

cat > "$made/run.py" <<'RUN'
import hashlib
import platform
import time
from importlib.metadata import distributions

start = time.perf_counter()
from odt_plugins import optimize
from odt_plugins.compare.start import stored

mesh = stored("bunny")
ready = time.perf_counter()
points, cells = optimize((mesh.points, mesh.cells))
done = time.perf_counter()
known = {found.metadata["Name"]: found.version for found in distributions()}
told = hashlib.sha256(points.tobytes() + cells.tobytes()).hexdigest()[:12]
row = (platform.python_version(), known["numpy"], known.get("numba", "none"),
       f"{ready - start:.2f}", f"{done - ready:.2f}", told)
print("|", " | ".join(row), "|")
RUN

# row PYTHON [NUMBA]
row() {
    local place="$made/$1-${2:-}"
    "$1" -m venv "$place"
    "$place/bin/pip" install -q --disable-pip-version-check "$made"/*.whl ${2:+"numba==$2"}
    [ -z "${2:-}" ] || find "$place" -path '*compiled/kernels.so' -delete
    chmod -R a-w "$place"
    # An interpreter in the home of another user is for that one only.
    $nobody env "$place/bin/python" -c "" 2>/dev/null || nobody=""
    (cd / && $nobody env -i PATH="$place/bin" OPENBLAS_NUM_THREADS=1 python "$made/run.py")
}

echo "| Python | NumPy | numba | import, s | bunny, s | result |"
echo "|---|---|---|---|---|---|"
for version in 3.11 3.12 3.13 3.14; do
    "python$version" -c "" 2>/dev/null && row "python$version"
done
for version in 0.60.0 0.62.1 0.65.0; do row python3.11 "$version"; done
