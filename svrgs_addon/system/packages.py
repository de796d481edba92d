"""Packages that are imported only where they are needed."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import os
import signal
import sys
import threading
from collections.abc import Iterator
from types import ModuleType

from .errors import NativeError, SceneError

# of the environment: why packages are missing and what to do, a sentence
MISSING_VARIABLE = "SVRGS_MISSING_PACKAGES"
ON_PYPI = {"pxr": "usd-core"}  # names of packages that have another one there


def load(name: str, purpose: str) -> ModuleType:
    """Imports the package or module. purpose: subject of the sentence if it is missing ('reading COLMAP
    models').

    Raises SceneError if it is not installed, NativeError if it is installed but cannot be loaded, for
    instance for lack of memory.
    """
    package = name.partition(".")[0]
    try:
        with uninterrupted():
            return importlib.import_module(name)
    except (ImportError, RuntimeError) as error:  # pycolmap turns an ImportError into a RuntimeError
        if isinstance(_first_of(error), KeyboardInterrupt):  # of another handler of Ctrl-C than Python's
            raise KeyboardInterrupt from None
        if isinstance(error, ModuleNotFoundError) and error.name == package:
            install = f"run {sys.executable} -m pip install {ON_PYPI.get(package, package)}"
            remedy = os.environ.get(MISSING_VARIABLE) or install
            raise SceneError(f"{purpose} needs the package {package}: {remedy}") from None
        raise NativeError(f"the package {package} cannot be loaded ({import_reason(error)})") from error


def is_installed(name: str) -> bool:
    """Whether a package is there, without importing it."""
    return importlib.util.find_spec(name) is not None


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Context manager for imports: while its block runs, Ctrl-C waits. Then it raises KeyboardInterrupt.

    Within an import, packages in C turn a KeyboardInterrupt into other errors. Other handlers of Ctrl-C than
    Python's stay as they are.
    """
    usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not usual or threading.current_thread() is not threading.main_thread():
        yield
        return
    asked: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: asked.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if asked:
            raise KeyboardInterrupt


def import_reason(error: BaseException) -> str:
    """The last line of the first error in a chain of errors."""
    first = _first_of(error)
    return (str(first).strip().splitlines() or [type(first).__name__])[-1]


def _first_of(error: BaseException) -> BaseException:
    while cause := error.__cause__ or error.__context__:
        error = cause
    return error
