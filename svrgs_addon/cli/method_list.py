"""`svrgs methods`: what each method does, its paper, and what its weights mean."""

from __future__ import annotations

import shutil
import textwrap

from ..finetune.methods import METHODS
from ..finetune.methods.base import Method

NOTE = (
    "No method of svrgs prune needs photographs: without them, pictures of the splat take their place. svrgs"
    " train needs them."
)


def method_list() -> list[dict]:
    """All methods in the order of the registry, as values that JSON can hold. lambda_f, lambda_m: defaults,
    lambda_m_prune: that of `svrgs prune`, and keeps: the share that stays without a target; null where the
    method has none."""
    return [
        {
            "name": method.name,
            "label": method.label,
            "help": method.help,
            "source": method.source,
            "decides": _decides(method),
            "learns_masks": method.learns_masks,
            "ranks": method.ranks,
            "needs_photographs": False,
            "lambda_f": method.lambda_f or None,
            "lambda_f_meaning": method.lambda_f_help,
            "lambda_m": method.lambda_m or None,
            "lambda_m_prune": method.weights(trained=True)[1] or None,
            "keeps": method.share or None,
        }
        for method in METHODS.values()
    ]


def _decides(method: Method) -> str:
    if not method.prunes:
        return "prunes nothing"
    if method.learns_masks:
        return "learns masks"
    return "ranks the Gaussians and cuts" if method.ranks else "decides during the steps"


def as_text(entries: list[dict]) -> str:
    width = max(60, shutil.get_terminal_size().columns - 2)
    wrapped = lambda text, indent: textwrap.wrap(text, width, initial_indent=indent, subsequent_indent=indent)
    lines = [*wrapped(NOTE, "")]
    for entry in entries:
        lines += ["", f"{entry['name']} ({entry['label']})", *wrapped(entry["help"], "    ")]
        decides = entry["decides"][0].upper() + entry["decides"][1:]
        lines += wrapped(f"Source: {entry['source']}. {decides}.", "    ")
        lines += wrapped(_weights(entry), "    ")
    return "\n".join(lines)


def _weights(entry: dict) -> str:
    parts = []
    if entry["lambda_f"]:
        meaning = entry["lambda_f_meaning"] or "weight of the spatial mask in the loss"
        parts.append(f"λ_F (--lambda-f, {entry['lambda_f']:g}): {meaning}.")
    else:
        parts.append("No λ_F.")
    if trained := entry["lambda_m"]:
        pruned = entry["lambda_m_prune"]
        own = f"{pruned:g}" if pruned == trained else f"{pruned:g}, in svrgs train {trained:g}"
        parts.append(f"λ_m (--lambda-m): {own}.")
    if entry["keeps"]:
        parts.append(f"Keeps {entry['keeps']:.0%} without a target.")
    elif entry["ranks"]:
        parts.append("Needs a target.")
    return " ".join(parts)
