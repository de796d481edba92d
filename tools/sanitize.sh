#!/usr/bin/env bash
# Runs native tests under sanitizers: tools/sanitize.sh VENV. CXX names the compiler (g++).
#   address and undefined behaviour   the Python tests of the kernels, and every input that the fuzzer once found
#   threads                           a program that drives the thread pool and the kernels
set -euo pipefail
cd "$(dirname "$0")/.."
bin=$1/bin
python=$bin/python
cxx=${CXX:-g++}
out=$PWD/build/sanitize
tests=(tests/test_native_{loss,adam,sampling,stress,poison,arguments,lifetimes,invariants,repeatability,scores,threads,update,removal,decimation,order}.py
    tests/test_meshes.py tests/test_panorama.py)
address=(-O1 -g "-fsanitize=address,undefined" -fno-sanitize-recover=all)
thread=(-O1 -g "-fsanitize=thread")
program=("$cxx" -std=c++20 -pthread -Inative/include "-Wl,-rpath,$out/asan:$out/tsan")
mkdir -p "$out"

# build NAME FLAG...: the library with these flags, build/sanitize/NAME/libsvrgs-debug.so
build() {
    "$bin/cmake" -S native -B "$out/$1" "-DCMAKE_CXX_COMPILER=$cxx" "-DCMAKE_CXX_FLAGS_RELEASE=${*:2}" >"$out/$1.log"
    "$bin/cmake" --build "$out/$1" --target svrgs-debug --parallel >>"$out/$1.log"
}

build asan "${address[@]}"
# The sanitizer's runtime must be the first library of Python's process. Leaks are not looked for: Python keeps memory to its end.
SVRGS_LIBRARY=$out/asan/libsvrgs-debug.so LD_PRELOAD="$("$cxx" -print-file-name=libasan.so) $("$cxx" -print-file-name=libstdc++.so)" \
    ASAN_OPTIONS=detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1 PYTHONMALLOC=malloc \
    "$python" -m pytest "${tests[@]}"
"${program[@]}" "${address[@]}" tests/sanitizers/fuzz.cc tests/sanitizers/replay.cc "$out/asan/libsvrgs-debug.so" -o "$out/replay"
"$out/replay" tests/fuzz/corpus/*

build tsan "${thread[@]}"
"${program[@]}" "${thread[@]}" tests/sanitizers/threads.cc "$out/tsan/libsvrgs-debug.so" -o "$out/threads"
TSAN_OPTIONS=halt_on_error=1 "$out/threads"
