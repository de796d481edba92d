"""The exception family of the product. Each message is one sentence: what is wrong, in which file, what to do."""


class SplatError(Exception):
    """Base of every error a user can cause or mend. The command line prints it and exits 2."""


class FormatError(SplatError):
    """A file is not what it claims to be: truncated, hostile, or of a kind that is not read."""


class SceneError(SplatError):
    """Files are readable but do not fit together, or the request would leave nothing."""


class NativeError(Exception):
    """The native library is missing, does not match, or reports a failure. The command line exits 1."""


class Cancelled(Exception):
    """The user asked to stop; everything written so far is complete."""
