# Functions for tests/run.sh and examples/demo.sh; sourced, from the top of the repository.

say() { echo "odt-plugins: $*" >&2; }

# Libraries that the wheels of open3d and pymeshlab load and do not bring: file, Debian package.
LIBRARIES="libusb-1.0.so.0:libusb-1.0-0 libGL.so.1:libgl1 libEGL.so.1:libegl1
           libOpenGL.so.0:libopengl0 libgomp.so.1:libgomp1 libX11.so.6:libx11-6"

system_libraries() {
    [ "$(uname -s)" = Linux ] || return 0
    local known missing="" pair
    known="$(PATH="$PATH:/sbin:/usr/sbin" ldconfig -p 2>/dev/null || true)"
    for pair in $LIBRARIES; do
        case "$known" in *"${pair%%:*}"*) ;; *) missing="$missing ${pair##*:}" ;; esac
    done
    [ -z "$missing" ] && return 0
    install_packages $missing && return 0
    say "missing system libraries; as root: apt-get install -y$missing"
    return 1
}

# A browser, for the test that opens the page of `odt-plugins compare`.
system_browser() {
    local name
    for name in chromium chromium-browser google-chrome; do
        command -v "$name" >/dev/null && return 0
    done
    install_packages chromium && return 0
    say "missing a browser for one test; on Debian, as root: apt-get install -y chromium"
    [ "${CI:-}" != true ]
}

# ParaView and a display without a screen, for the tests of its plugin.
system_paraview() {
    command -v pvpython >/dev/null && command -v Xvfb >/dev/null && return 0
    install_packages paraview python3-paraview xvfb && return 0
    say "missing ParaView; on Debian, as root: apt-get install -y paraview python3-paraview xvfb"
    [ "${CI:-}" != true ]
}

# install_packages NAMES: on Debian and its kin, as root; fails otherwise.
install_packages() {
    [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null || return 1
    say "installing system packages: $*"
    apt-get update -qq >/dev/null && DEBIAN_FRONTEND=noninteractive \
        apt-get install -y -qq --no-install-recommends "$@" >/dev/null
}

# make_environment: .venv, with the newest fitting Python on the path.
make_environment() {
    local python
    python="$(find_python)" || return 1
    say "making .venv with $("$python" --version)"
    "$python" -m venv .venv >/dev/null 2>&1 && return 0
    install_packages python3-venv && "$python" -m venv .venv >/dev/null 2>&1 && return 0
    rm -rf .venv
    say "$python cannot make an environment; on Debian, as root: apt-get install -y python3-venv"
    return 1
}

# use_environment EXTRAS: activate the environment, made or found, with this package in it.
use_environment() {
    local extras="$1" marker stamp
    if [ -z "${VIRTUAL_ENV:-}" ]; then
        [ -x .venv/bin/python ] || make_environment || return 1
        . .venv/bin/activate
    fi
    python -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
        say "needs Python 3.11 or newer, $VIRTUAL_ENV has $(python --version)"; return 1; }
    marker="$VIRTUAL_ENV/.odt-plugins-installed"
    stamp="$PWD [$extras] $(cksum < pyproject.toml)"
    if grep -qxF "$stamp" "$marker" 2>/dev/null; then return 0; fi
    say "installing odt-plugins[$extras] into $VIRTUAL_ENV (a few minutes, once)"
    python -m pip --version >/dev/null 2>&1 || {
        say "$VIRTUAL_ENV has no pip; try python -m ensurepip"; return 1; }
    # Python compiles what is imported, a small part of all that is installed.
    python -m pip install --quiet --disable-pip-version-check --no-compile -e ".[$extras]" || {
        say "installation failed; the lines above say why"; return 1; }
    echo "$stamp" >> "$marker"
}

find_python() {
    local name
    for name in python3 python3.13 python3.12 python3.11 python; do
        if command -v "$name" >/dev/null && \
           "$name" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            echo "$name"; return 0
        fi
    done
    say "needs Python 3.11 or newer; none found on the path"
    return 1
}
