"""Whether a result holds the drop in PSNR that was allowed (--max-drop). What steps win back is foreseen, and one scene may win back less than another."""

from __future__ import annotations

CLEARLY = 1.2  # times the allowed drop


def missed_drop(lost: float | None, allowed: float) -> list[str]:
    """A sentence if a result has lost clearly more dB than were allowed. lost: None where no drop is allowed."""
    if lost is None or not lost > CLEARLY * allowed:
        return []
    return [f"the result loses {lost:.2f} dB, more than the {allowed:g} dB that were allowed; allow less, or set a number of Gaussians that keeps more of them"]
