"""What photographs need before a splat is fine-tuned on them, found by comparing them with what it shows."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from ..finetune.plan import Plan
from ..scene.gaussians import Scene
from ..views.dataset import Dataset
from ..views.rendered import RenderedDataset
from .context import JobContext
from .distractors import without_distractors
from .exposure_check import spread_of
from .pose_check import offset_of, with_aligned_poses
from .tone_check import tone_of, with_tone


@dataclass(frozen=True)
class Prepared:
    """The dataset, its photographs in the colours of the splat and its cameras moved where that is needed;
    the plan, in which nothing is "auto" any more; sentences for the user, and figures for the JSON
    result."""

    dataset: Dataset
    plan: Plan
    notes: list[str] = field(default_factory=list)
    facts: dict[str, float] = field(default_factory=dict)


def in_its_colours(scene: Scene, dataset: Dataset, plan: Plan) -> Prepared:
    """Compares the tone: it goes before the question whether splat and photographs belong together. Raises
    FormatError, SceneError."""
    if isinstance(dataset, RenderedDataset):
        return Prepared(dataset, plan)
    tone = tone_of(scene, dataset)
    matched = tone.differs and plan.exposure != "off"
    return Prepared(
        with_tone(dataset, tone) if matched else dataset,
        plan,
        [tone.sentence(matched)] if tone.differs else [],
        {"tone_db": tone.after - tone.before},
    )


def prepared(scene: Scene, dataset: Dataset, plan: Plan, job: JobContext) -> Prepared:
    """Compares exposure and poses, in this order, and then masks distractors if that is asked for. The
    splat's own pictures need nothing. Raises FormatError, SceneError, Cancelled."""
    if isinstance(dataset, RenderedDataset):
        return Prepared(dataset, replace(plan, exposure="off", refine_poses="off"))
    notes, facts = list[str](), dict[str, float]()
    if plan.exposure == "auto":
        spread = spread_of(scene, dataset)
        plan = replace(plan, exposure="on" if spread.varies else "off")
        notes += [spread.sentence()] if spread.varies else []
        facts["exposure_ev"] = spread.spread
    offset = offset_of(scene, dataset)
    if plan.refine_poses == "auto":
        plan = replace(plan, refine_poses="on" if offset.off else "off")
    refined = plan.refine_poses == "on"
    notes += [offset.sentence(refined)] if offset.off else []
    facts |= {"beside_pixels": offset.pixels, "aligned_db": offset.gain}
    if refined:  # also of a job that is resumed: first cut and masks depend on it
        # an allowed drop is decided and measured in held-out views, which must not be off either
        dataset = with_aligned_poses(scene, dataset, bool(plan.max_loss), job)
    if plan.mask_distractors:
        dataset, sentence = without_distractors(scene, dataset)
        notes.append(sentence)
    return Prepared(dataset, plan, notes, facts)
