"""The comments of a PLY header. One of them may say that the scene is antialiased."""

from __future__ import annotations

import re
from collections.abc import Iterable

from ..scene.gaussians import Scene
from ..system.errors import SceneError
from .ply_header import is_comment

MIP_COMMENT = "SplatRenderMode: mip"
# written by Brush; by Postshot
MIP_PATTERN = re.compile(r"\s*(SplatRenderMode:\s*mip|antialiased\s+1)\s*", re.IGNORECASE)
MODE_PATTERN = re.compile(r"\s*(SplatRenderMode:|antialiased\s).*", re.IGNORECASE)


def written_comments(scene: Scene) -> list[str]:
    """The comments to write: those that were read, with the antialiasing comment corrected if the flag has
    changed.

    Raises SceneError for a comment that a PLY cannot store.
    """
    comments = list(scene.comments)
    if scene.antialiased != is_mip(comments):
        comments = [text for text in comments if not MODE_PATTERN.fullmatch(text)]
        comments += [MIP_COMMENT] * scene.antialiased
    if not all(is_comment(text) for text in comments):
        raise SceneError(
            "a comment of the scene is not one line of text, so it cannot be stored in a PLY; remove it first"
        )
    return comments


def is_mip(comments: Iterable[str]) -> bool:
    """Whether a comment marks the scene as antialiased."""
    return any(MIP_PATTERN.fullmatch(text) for text in comments)
