"""Whether a result holds the drop in PSNR that was allowed (--max-drop). What the steps will win back is
estimated before them, and it may be less."""

from __future__ import annotations

CLEARLY = 1.2  # a drop of more than so many times the allowed one is told


def missed_drop(lost: float | None, allowed: float) -> list[str]:
    """A sentence if a result has lost clearly more PSNR than was allowed, both in dB. lost: None where no
    drop is allowed."""
    if lost is None or not lost > CLEARLY * allowed:
        return []
    return [
        f"the result loses {lost:.2f} dB, more than the {allowed:g} dB that were allowed; allow less, or set"
        " a number of Gaussians that keeps more of them"
    ]
