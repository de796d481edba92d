#!/usr/bin/env bash
# Compiles the native core into svrgs_addon/, if its sources have changed, and shows warnings: tools/build_native.sh VENV.
# CXX names the compiler.
set -euo pipefail
cd "$(dirname "$0")/.."
cmake=$1/bin/cmake
log=build/native.log
unset MAKEFLAGS # of `make -j2`: CMake calls a make of its own
mkdir -p build
if ! [ -f build/native/CMakeCache.txt ] || ! [ -f svrgs_addon/libsvrgs.so ]; then
    echo "compiling the native core"
    rm -rf build/native
fi
{ "$cmake" -S native -B build/native "-Dlibrary_folder=$PWD/svrgs_addon" && "$cmake" --build build/native --target svrgs --parallel 2; } >"$log" 2>&1 ||
    { cat "$log" >&2 && exit 1; }
grep -A 4 'warning:' "$log" >&2 || true
