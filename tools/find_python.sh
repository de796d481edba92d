#!/usr/bin/env bash
# Prints the first Python of the versions given that runs, looking on PATH and then under pyenv: tools/find_python.sh 3.11 3.13 3.12
# Prints nothing where there is none.
set -euo pipefail

for version in "$@"; do
    for python in "python$version" "${PYENV_ROOT:-$HOME/.pyenv}/versions/$version".*/bin/"python$version"; do
        if "$python" -c "" 2>/dev/null; then
            echo "$python"
            exit 0
        fi
    done
done
