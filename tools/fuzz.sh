#!/usr/bin/env bash
# Fuzzes the C interface with libFuzzer under the address and undefined behaviour sanitizers: tools/fuzz.sh
# CLANG names the compiler (clang++-16), FUZZ_SECONDS the time (300). What it finds lies in build/sanitize/.
set -euo pipefail
cd "$(dirname "$0")/.."
clang=${CLANG:-clang++-16}
out=$PWD/build/sanitize
flags=(-O1 -g "-fsanitize=address,undefined" -fno-sanitize-recover=all)
mkdir -p "$out/corpus"

cmake=$(command -v .venv/bin/cmake || command -v cmake)
"$cmake" -S native -B "$out/fuzzed" "-DCMAKE_CXX_COMPILER=$clang" "-DCMAKE_CXX_FLAGS_RELEASE=${flags[*]} -fsanitize=fuzzer-no-link" \
    -DCMAKE_SHARED_LINKER_FLAGS=-Wl,-z,undefs
"$cmake" --build "$out/fuzzed" --target svrgs-debug --parallel
"$clang" -std=c++20 "${flags[@]}" -fsanitize=fuzzer -pthread -Inative/include tests/sanitizers/fuzz.cc "$out/fuzzed/libsvrgs-debug.so" \
    "-Wl,-rpath,$out/fuzzed" -o "$out/fuzz"
"$out/fuzz" "-max_total_time=${FUZZ_SECONDS:-300}" -max_len=8192 -len_control=0 -print_final_stats=1 "-artifact_prefix=$out/" \
    "$out/corpus" tests/fuzz/corpus
