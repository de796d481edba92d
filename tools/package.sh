#!/usr/bin/env bash
# Builds everything that is published, in dist/: tools/package.sh VENV. From one Linux machine, for all platforms of tools/platforms.toml.
set -euo pipefail
cd "$(dirname "$0")/.."
python=$1/bin/python
"$python" -m pip install -qq --disable-pip-version-check -r requirements-package.txt
rm -rf dist
"$python" tools/fetch_wheels.py --all
"$python" tools/fetch_web_modules.py
"$python" tools/build_wheels.py
"$python" tools/check_libraries.py
"$python" tools/build_extension.py --all
