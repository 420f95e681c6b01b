#!/usr/bin/env bash
# From a bare clone to a better bunny: makes an environment, then runs odt-plugins demo.
#   bash examples/demo.sh [options of odt-plugins demo]
set -euo pipefail
cd "$(dirname "$0")/.."
. tests/environment.sh

enter_environment
install_package "demo"
exec odt-plugins demo "$@"
