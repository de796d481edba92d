#!/usr/bin/env bash
# Cross-compiles the native core into build/platforms/TARGET/: tools/platforms/build.sh VENV TARGET... The compiler, zig, comes from PyPI into
# build/zig. The first build for a target takes minutes, because zig compiles its C++ library for it.
set -euo pipefail
cd "$(dirname "$0")/../.."
cmake=$PWD/$1/bin/cmake
python=$PWD/build/zig/bin/python
[ "${1#/}" = "$1" ] || cmake=$1/bin/cmake
shift
if ! [ -f build/zig/.ready ]; then
    echo "installing ziglang into build/zig"
    python3 -m venv build/zig
    "$python" -m pip install -qq --disable-pip-version-check -r tools/platforms/requirements.txt
    touch build/zig/.ready
fi
export SVRGS_PYTHON=$python SVRGS_TARGET
for SVRGS_TARGET in "$@"; do
    folder=build/platforms/$SVRGS_TARGET
    mkdir -p "$folder"
    echo "compiling for $SVRGS_TARGET"
    { "$cmake" -S native -B "$folder" "-DCMAKE_TOOLCHAIN_FILE=$PWD/native/zig-toolchain.cmake" && "$cmake" --build "$folder" --parallel 2; } \
        >"$folder/build.log" 2>&1 || { tail -30 "$folder/build.log" >&2 && exit 1; }
done
