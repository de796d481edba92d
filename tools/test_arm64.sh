#!/usr/bin/env bash
# Runs the native tests and those of the PLY reader as arm64, under QEMU: tools/test_arm64.sh [ARGUMENTS OF PYTEST]
# The library is that of make package. Python and its packages come from Debian's for arm64, unpacked into build/arm64 (Debian only, as root).
set -euo pipefail
cd "$(dirname "$0")/.."
library=$PWD/build/platforms/aarch64-linux-gnu.2.28/libsvrgs.so
root=$PWD/build/arm64
python=$root/usr/bin/python3-qemu # Python calls itself so, and its tests start it again
packages=python3,python3-numpy,python3-scipy,python3-pytest,python3-hypothesis,python3-torch
[ -f "$library" ] || { echo "$library is not built: run make package" >&2 && exit 1; }
command -v qemu-aarch64 mmdebstrap >/dev/null || apt-get install -y -qq --no-install-recommends qemu-user mmdebstrap
if ! [ -f "$root/.ready" ]; then
    echo "unpacking Debian's Python for arm64 into $root"
    rm -rf "$root"
    mmdebstrap --quiet --variant=extract --arch=arm64 --include="$packages" bookworm "$root"
    libraries=$root/usr/lib/aarch64-linux-gnu
    printf '#!/bin/sh\nexec qemu-aarch64 -L "%s" -E "LD_LIBRARY_PATH=%s" -0 "$0" "%s" "$@"\n' \
        "$root" "$libraries/blas:$libraries/lapack" "$root/usr/bin/python3" >"$python"
    chmod +x "$python"
    touch "$root/.ready"
fi
# No setting limits the threads under QEMU, so the test that sets one is left out.
left_out=tests/test_native_threads.py::test_fewer_threads_where_the_system_gives_no_more
tests=("$@")
[ $# -gt 0 ] || tests=(tests/test_native_*.py tests/test_ply.py tests/test_ply_refusals.py --deselect "$left_out")
SVRGS_LIBRARY=$library PYTHONPATH=$PWD PYTHONDONTWRITEBYTECODE=1 exec "$python" -m pytest -q -p no:cacheprovider "${tests[@]}"
