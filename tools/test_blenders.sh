#!/usr/bin/env bash
# Runs the extension's tests in other Blenders too: tools/test_blenders.sh VENV. BLENDERS names their versions.
# Each is a Blender module (bpy) in a virtual environment of its own, build/bpy-VERSION, about 1 GB.
set -euo pipefail
cd "$(dirname "$0")/.."
pythons=()
for version in ${BLENDERS:-4.2.23 4.5.15 5.2.3 5.3.0}; do
    venv=$PWD/build/bpy-$version
    case $version in
        4.* | 5.0.* | 5.1.*) needs=3.11 with=("numpy<2") ;;
        *) needs=3.13 with=(OpenImageIO) ;; # the module brings no OpenImageIO
    esac
    if ! [ -f "$venv/.ready" ]; then
        python=$(tools/find_python.sh "$needs")
        if [ -z "$python" ]; then
            echo "Blender $version needs Python $needs, which was not found" >&2
            exit 1
        fi
        echo "installing Blender $version into $venv"
        "$python" -m venv "$venv"
        "$venv/bin/python" -m pip install -qq --disable-pip-version-check "bpy==$version" pytest usd-core "${with[@]}"
        touch "$venv/.ready"
    fi
    pythons+=("$venv/bin/python")
done
SVRGS_BLENDER_PYTHONS=$(IFS=: && echo "${pythons[*]}") "$1/bin/python" -m pytest tests/test_extension.py
