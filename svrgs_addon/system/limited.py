"""A script, run as a child process: runs another script with limits, where the system can set them. It
imports nothing else of this package.

python limited.py SECONDS MEGABYTES SCRIPT WORD…    SECONDS of the processor, MEGABYTES of addresses
"""

import contextlib
import runpy
import sys


def main(seconds: str, megabytes: str, script: str, *words: str):
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds)))
        resource.setrlimit(resource.RLIMIT_AS, (int(megabytes) << 20, int(megabytes) << 20))
    sys.argv = [script, *words]
    runpy.run_path(script, run_name="__main__")


if __name__ == "__main__":
    main(*sys.argv[1:])
