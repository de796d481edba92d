"""The exceptions of the product. Each message is a sentence: the file, the fault, what to do about it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from .file_names import shown


class SplatError(Exception):
    """Base class of errors that a user can cause and correct. The command line exits with status 2."""

    def __str__(self) -> str:
        return shown(super().__str__())


class FormatError(SplatError):
    """A file cannot be read: it is truncated, malformed, malicious or of an unsupported kind."""


class TooMany(FormatError):
    """A file holds more Gaussians than are read as a whole, or than memory can hold."""


class OtherRun(FormatError):
    """What is to be continued is of a run with other settings or inputs."""


class SceneError(SplatError):
    """The files can be read, but do not belong together, or nothing would be left of the scene."""


class MemoryShort(SceneError):
    """The work on a whole scene needs more memory than there is."""


class NativeError(Exception):
    """The native library is missing, has another interface version or reports a failure; or a package cannot
    be loaded. The command line exits with status 1."""


class Cancelled(Exception):
    """The user asked to stop. Files written before are complete. The command line exits with status 130. It
    may carry a sentence on what is left of the work; without one, there is a checkpoint."""


@contextlib.contextmanager
def system_errors(kind: type[SplatError], sentence: str) -> Iterator[None]:
    """An OSError of the block becomes an error of this kind, with its reason after the sentence."""
    try:
        yield
    except OSError as error:
        raise kind(f"{sentence} ({error.strerror or error})") from error
