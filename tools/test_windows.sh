#!/usr/bin/env bash
# Runs tests with Python for Windows, under Wine: tools/test_windows.sh VENV [ARGUMENTS OF PYTEST]. Debian only, as root; the pinned packages of
# requirements-package.txt. The library and the wheel are those of tools/build_wheels.py windows-x64.
# With --blender it makes Blender's module for Windows, too; tests/test_windows_python.py then runs the extension's tests in it, with
# SVRGS_TEST_ZIP and others as in tests/test_extension.py.
# Python comes out of panda3d's wheel, which carries python311.dll and the extension modules; its standard library is that of a CPython 3.11.
set -euo pipefail
cd "$(dirname "$0")/.."
bin=$(cd "$1/bin" && pwd)
shift
root=$PWD/build/windows
library=$PWD/build/platforms/x86_64-windows-gnu/svrgs.dll
packages=(numpy==1.26.4 pycolmap==4.2.1 OpenImageIO==3.0.21.0 zstandard==0.25.0 pytest==8.4.2 hypothesis==6.170.15 scipy==1.17.0)
pip=("$bin/python" -m pip --disable-pip-version-check)
for_windows=(--platform win_amd64 --python-version 3.11 --only-binary :all:)
command -v wine >/dev/null || apt-get install -y -qq --no-install-recommends wine wine64 >/dev/null
[ -x "$bin/auditwheel" ] || "${pip[@]}" install -qq -r requirements-package.txt
if ! [ -f "$root/.ready" ]; then
    echo "making a Python for Windows in $root"
    rm -rf "$root" && mkdir -p "$root"
    "${pip[@]}" download -qq --no-deps "${for_windows[@]}" -d "$root/wheels" panda3d==1.10.16
    "$bin/python" -m zipfile -e "$root"/wheels/panda3d-*.whl "$root/panda3d"
    cp "$root"/panda3d/deploy_libs/* "$root"
    cp -r "$("$bin/python" -c 'import sysconfig; print(sysconfig.get_path("stdlib"))')" "$root/Lib"
    rm -rf "$root"/panda3d "$root"/Lib/{site-packages,lib-dynload,test,config-3*}
    "$bin/python" -m ziglang cc -target x86_64-windows-gnu -municode -O1 tools/windows_python.c -o "$root/python.exe"
    "${pip[@]}" install -qq "${for_windows[@]}" --target "$root/Lib/site-packages" "${packages[@]}"
    touch "$root/.ready"
fi
[ -f "$library" ] || "$bin/python" tools/build_wheels.py windows-x64
export WINEPREFIX=$root/prefix WINEDEBUG=-all WINEARCH=win64 PYTHONDONTWRITEBYTECODE=
arguments=(-m "not slow")
windows() { winepath -w "$1"; }
if [ "${1:-}" = --blender ]; then
    shift
    blender=$root/blender-4.5.15
    if ! [ -d "$blender" ]; then
        "${pip[@]}" download -qq --no-deps "${for_windows[@]}" -d "$root/wheels" bpy==4.5.15
        "$bin/python" -m zipfile -e "$root"/wheels/bpy-4.5.15-*.whl "$blender.new"
        mv "$blender.new" "$blender"
    fi
    [ -n "${SVRGS_TEST_ZIP:-}" ] || exit 0
    # Blender's own packages first: its OpenImageIO fits the libraries that Blender has loaded
    PYTHONPATH="$(windows "$blender/bpy/4.5/python/lib/site-packages");$(windows "$blender");$(windows "$PWD");$(windows "$PWD/benchmarks")"
    SVRGS_TEST_ZIP=$(windows "$SVRGS_TEST_ZIP")
    SVRGS_TEST_DATA=$(windows "$SVRGS_TEST_DATA")
    BLENDER_USER_RESOURCES=$(windows "$BLENDER_USER_RESOURCES")
    export PYTHONPATH SVRGS_TEST_ZIP SVRGS_TEST_DATA BLENDER_USER_RESOURCES
    cd tests/blender
    arguments=(--rootdir . -c NUL -p no:randomly)
else
    SVRGS_LIBRARY=$(windows "$library")
    export SVRGS_LIBRARY
fi
wine "$root/python.exe" -m pytest -p no:cacheprovider "${arguments[@]}" "$@" </dev/null 2>&1 | cat # this Python starts only if its output is a pipe
