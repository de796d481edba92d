#!/usr/bin/env bash
# Checks style and types of all sources: tools/lint.sh VENV. With --fix as second argument it formats them instead.
# Every check runs; the exit status is 0 if all passed.
# shellcheck disable=SC2317  # its functions are called by name
set -uo pipefail
cd "$(dirname "$0")/.." || exit
bin=$(cd "$1/bin" && pwd) || exit
mapfile -t cpp < <(find native tests \( -name '*.cc' -o -name '*.h' \) -not -path 'native/build/*' | sort)
mapfile -t scripts < <(find .ci/run tools -type f \( -name '*.sh' -o -name run \) | sort)
failed=()

check() {
    local name=$1
    shift
    echo "$name"
    "$@" || failed+=("$name")
}

# mypy needs the repository as a package with a valid name; its messages show the files' paths as they are.
types() {
    mkdir -p build/lint && ln -sfn ../.. build/lint/svrgs
    "$bin/mypy" | sed 's|^build/lint/svrgs/||'
}

cpp_format() {
    if [ -f .clang-format ]; then
        "$bin/clang-format" "$@" "${cpp[@]}"
    else
        echo "skipped: there is no .clang-format"
    fi
}

if [ "${2:-}" = --fix ]; then
    check "ruff check --fix-only" "$bin/ruff" check --quiet --fix-only .
    check "ruff format" "$bin/ruff" format --quiet .
    check "clang-format" cpp_format -i
else
    check "ruff check" "$bin/ruff" check --quiet .
    check "ruff format --check" "$bin/ruff" format --quiet --check .
    check "mypy" types
    check "clang-format --dry-run" cpp_format --dry-run -Werror
    check "check-jsonschema" "$bin/check-jsonschema" --quiet --builtin-schema vendor.github-workflows .github/workflows/*.yml
    for script in "${scripts[@]}"; do
        check "bash -n $script" bash -n "$script"
    done
fi

for name in "${failed[@]}"; do
    echo "failed: $name" >&2
done
exit "$((${#failed[@]} > 0))"
