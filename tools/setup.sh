#!/usr/bin/env bash
# Makes the virtual environment with the pinned packages: tools/setup.sh VENV PYTHON
# Where something is missing it installs Debian packages, with sudo unless it runs as root:
#   pythonX.Y-venv (if Python cannot make virtual environments), the libraries that Blender as a module links against, valgrind.
set -euo pipefail
cd "$(dirname "$0")/.."
venv=$1
python=${2:-}
blender_libraries=(libx11-6 libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libgl1 libegl1 libxxf86vm1 libgomp1)
log=$(mktemp)
trap 'rm -f "$log"' EXIT

# Runs a command; shows what it printed only if it fails.
quietly() {
    "$@" >"$log" 2>&1 || { cat "$log" >&2 && return 1; }
}

install_debian() {
    if ! command -v apt-get >/dev/null; then
        echo "this system has no apt-get; please install what these Debian packages hold: $*" >&2
        return 1
    fi
    local as_root=()
    [ "$(id -u)" = 0 ] || as_root=(sudo)
    echo "installing Debian packages: $*"
    quietly "${as_root[@]}" apt-get update -qq &&
        quietly "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@"
}

if ! "$venv/bin/python" -m pip --version >/dev/null 2>&1; then
    if [ -z "$python" ]; then
        echo "no Python 3.11, 3.12 or 3.13 found; name one with: make PYTHON=/path/to/python3.11" >&2
        exit 1
    fi
    echo "creating $venv with $("$python" --version)"
    if ! "$python" -m venv "$venv" >/dev/null 2>&1; then
        install_debian "$(basename "$python")-venv"
        quietly "$python" -m venv "$venv"
    fi
fi
python=$venv/bin/python

echo "installing the packages of requirements-dev.txt into $venv (some minutes)"
# -qq: errors only; --no-compile: Python compiles those modules that are used
install=("$python" -m pip install -qq --no-compile --disable-pip-version-check)
"${install[@]}" "$(grep -o '^cmake==[0-9.]*' requirements-dev.txt)"
tools/build_native.sh "$venv" & # compiles while pip unpacks
compiler=$!
"${install[@]}" -r requirements-dev.txt
wait "$compiler"
# The checkout is on Python's path, behind the current folder; pip's own way to do this would compile the native core again.
"$python" -m pip uninstall -qq --yes --disable-pip-version-check svrgs-addon 2>/dev/null
printf '%s\n' "$PWD" "$PWD/benchmarks" >"$("$python" -c "import sysconfig; print(sysconfig.get_path('purelib'))")/svrgs.pth"
printf '#!/bin/sh\nexec "%s" -m svrgs_addon "$@"\n' "$(cd "$venv" && pwd)/bin/python" >"$venv/bin/svrgs"
chmod +x "$venv/bin/svrgs"

if ! "$python" -c "import importlib.util, sys; sys.exit(importlib.util.find_spec('bpy') is None)"; then
    echo "there is no Blender module (bpy) for $("$python" --version), only for 3.11 and 3.13:" \
        "make test skips what needs Blender, make demo and make zip do not work"
elif ! "$python" -c "import bpy" >/dev/null 2>&1; then
    install_debian "${blender_libraries[@]}"
    quietly "$python" -c "import bpy"
fi
command -v valgrind >/dev/null || install_debian valgrind || echo "without valgrind, tests/test_instruction_counts.py is skipped"
