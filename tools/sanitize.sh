#!/usr/bin/env bash
# Runs native tests under sanitizers: tools/sanitize.sh VENV. CXX names the compiler (g++).
#   address and undefined behaviour   the Python tests of the kernels, and every input that the fuzzer once found
#   threads                           a program that drives the thread pool and the kernels
set -euo pipefail
cd "$(dirname "$0")/.."
python=$1/bin/python
cxx=${CXX:-g++}
out=$PWD/build/sanitize
tests=(tests/test_native_{loss,adam,sampling,stress,poison,arguments,lifetimes,invariants,repeatability,scores,threads,update,removal}.py
    tests/test_meshes.py tests/test_panorama.py)
address=(-O1 -g "-fsanitize=address,undefined" -fno-sanitize-recover=all)
thread=(-O1 -g "-fsanitize=thread")
program=("$cxx" -std=c++20 -pthread -Inative/include "-Wl,-rpath,$out")
mkdir -p "$out"

make --no-print-directory -C native CXX="$cxx" BUILD=build/asan OUT="$out/libsvrgs-asan.so" EXTRA="${address[*]}"
# The sanitizer's runtime must be the first library of Python's process. Leaks are not looked for: Python keeps memory to its end.
SVRGS_LIBRARY=$out/libsvrgs-asan.so LD_PRELOAD="$("$cxx" -print-file-name=libasan.so) $("$cxx" -print-file-name=libstdc++.so)" \
    ASAN_OPTIONS=detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1 PYTHONMALLOC=malloc \
    "$python" -m pytest "${tests[@]}"
"${program[@]}" "${address[@]}" tests/sanitizers/fuzz.cc tests/sanitizers/replay.cc "$out/libsvrgs-asan.so" -o "$out/replay"
"$out/replay" tests/fuzz/corpus/*

make --no-print-directory -C native CXX="$cxx" BUILD=build/tsan OUT="$out/libsvrgs-tsan.so" EXTRA="${thread[*]}"
"${program[@]}" "${thread[@]}" tests/sanitizers/threads.cc "$out/libsvrgs-tsan.so" -o "$out/threads"
TSAN_OPTIONS=halt_on_error=1 "$out/threads"
