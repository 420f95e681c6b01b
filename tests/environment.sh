# Functions for tests/run.sh and examples/demo.sh; sourced, from the top of the repository.

say() { echo "odt-plugins: $*" >&2; }

# Libraries that the wheels of open3d and pymeshlab load and do not bring: file, Debian package.
LIBRARIES="libusb-1.0.so.0:libusb-1.0-0 libGL.so.1:libgl1 libEGL.so.1:libegl1
           libOpenGL.so.0:libopengl0 libgomp.so.1:libgomp1 libX11.so.6:libx11-6"

missing_libraries() {
    local known pair
    [ "$(uname -s)" = Linux ] || return 0
    known="$(PATH="$PATH:/sbin:/usr/sbin" ldconfig -p 2>/dev/null || true)"
    for pair in $LIBRARIES; do
        case "$known" in *"${pair%%:*}"*) ;; *) echo "${pair##*:}" ;; esac
    done
}

# A browser, for the tests that open the pages of `odt-plugins compare`.
missing_browser() {
    local name
    for name in chromium chromium-browser google-chrome; do
        command -v "$name" >/dev/null && return 0
    done
    echo chromium
}

# ParaView and a display without a screen, for the tests of its plugin.
missing_paraview() {
    command -v pvpython >/dev/null && command -v Xvfb >/dev/null && return 0
    echo paraview python3-paraview xvfb
}

# system_packages: installs what is missing, all at once, and says what still is.  The libraries are
# needed, the rest for a few tests, which CI does not leave out.
system_packages() {
    local what missing failed=0
    missing="$(echo $(missing_libraries) $(missing_browser) $(missing_paraview))"
    [ -z "$missing" ] && return 0
    install_packages $missing && return 0
    for what in libraries browser paraview; do
        missing="$(echo $("missing_$what"))"
        [ -z "$missing" ] || install_packages $missing && continue
        say "missing for the tests ($what); on Debian, as root: apt-get install -y $missing"
        [ "$what" = libraries ] || [ "${CI:-}" = true ] && failed=1
    done
    return $failed
}

can_install() { [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; }

# install_packages NAMES: on Debian and its kin, as root; fails otherwise.
install_packages() {
    can_install || return 1
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

# make_lowest: .venv-lowest, with the lowest versions of all that the package cannot do without, and
# the newest of toolkits and tests that go with these.
make_lowest() {
    local python bin=.venv-lowest/bin
    python="$(command -v python3.11 || find_python)" || return 1
    if [ ! -x $bin/uv ]; then
        "$python" -m venv .venv-lowest && $bin/python -m pip install --quiet uv || return 1
    fi
    $bin/uv pip compile --quiet --python $bin/python --no-deps --resolution lowest-direct \
        pyproject.toml -o .venv-lowest/lowest.txt >/dev/null &&
        $bin/uv pip compile --quiet --python $bin/python -c .venv-lowest/lowest.txt \
            --extra plot --extra pymeshlab --extra pyvista --extra skfem --extra test \
            --extra trimesh pyproject.toml -o .venv-lowest/all.txt >/dev/null &&
        $bin/uv pip install --quiet --python $bin/python -r .venv-lowest/all.txt
}

# enter_environment: activates the environment, made or found.
enter_environment() {
    if [ -z "${VIRTUAL_ENV:-}" ]; then
        [ -x .venv/bin/python ] || make_environment || return 1
        . .venv/bin/activate
    fi
    python -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
        say "needs Python 3.11 or newer, $VIRTUAL_ENV has $(python --version)"; return 1; }
}

# install_package EXTRAS: puts this package into the active environment.
install_package() {
    local extras="$1" marker stamp
    marker="$VIRTUAL_ENV/.odt-plugins-installed"
    stamp="$PWD [$extras] $(cat pyproject.toml setup.py | cksum)"
    if grep -qxF "$stamp" "$marker" 2>/dev/null; then return 0; fi
    say "installing odt-plugins[$extras] into $VIRTUAL_ENV (a few minutes, once)"
    python -m pip --version >/dev/null 2>&1 || {
        say "$VIRTUAL_ENV has no pip; try python -m ensurepip"; return 1; }
    # Python compiles what is imported, a small part of all that is installed.  The option of that
    # name would not reach the pip that installs what builds the package.
    by_uv -e ".[$extras]" || PIP_COMPILE=0 python -m pip install $QUIET -e ".[$extras]" || {
        say "installation failed; the lines above say why"; return 1; }
    echo "$stamp" >> "$marker"
}

QUIET="--quiet --disable-pip-version-check"

# by_uv ARGUMENTS: as pip install, in a third of the time; uv finds and takes what pip was told to.
by_uv() {
    local option value
    python -m pip install $QUIET uv 2>/dev/null || return 1
    while IFS="=" read -r option value; do
        value="${value#\'}" value="${value%\'}" value="${value//\\n/ }"
        case "$option" in
            *.index-url) export UV_DEFAULT_INDEX="$value" ;;
            *.extra-index-url) export UV_INDEX="$value" ;;
            *.find-links) export UV_FIND_LINKS="${value// /,}" ;;
            *.constraint) export UV_CONSTRAINT="$value" ;;
        esac
    done <<< "$(python -m pip config list | sort -r)"
    # Of all places the newest version, as with pip.
    UV_INDEX_STRATEGY=unsafe-best-match python -m uv pip install --quiet "$@"
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
