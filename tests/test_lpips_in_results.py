"""LPIPS stands in the results of every way to prune, where its weights are named, and in reports where they
are there."""

import numpy as np
import pytest

import tiny_dataset
from svrgs_addon.render.metrics import lpips
from svrgs_addon.system import memory

pytestmark = pytest.mark.slow

FINE_TUNED = ("--target", 0.5, "--iterations", 20)
RECIPES = {
    "quick": ("--quick", "--target", 0.5),
    "fine-tuned": FINE_TUNED,
    "merged without photographs": ("--method", "merge", "--target", 0.5),
}


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A file of random weights."""
    rng, arrays = np.random.default_rng(0), {}
    for name, shape in lpips._expected().items():
        scale = (2 / max(1, np.prod(shape[1:]))) ** 0.5
        arrays[name] = (scale * (rng.random(shape) - 0.3)).astype(np.float16)
    path = tmp_path_factory.mktemp("lpips") / "w.npz"
    np.savez(path, **arrays)
    yield path
    path.unlink()


def words(recipe: str, tiny) -> tuple:
    return RECIPES[recipe] if "without" in recipe else (*RECIPES[recipe], "--data", tiny.folder)


def short(recipe: str) -> tuple:
    """Few steps."""
    return ("--recovery", 20) if recipe != "quick" else ()


@pytest.mark.parametrize("recipe", RECIPES)
def test_it_is_measured_where_its_weights_are_named(recipe, tiny, svrgs, weights, small_rig, tmp_path):
    command = (f"prune {tiny.splat} --out {tmp_path}/o.ply", *words(recipe, tiny), *short(recipe), "--json")
    measured, plain = svrgs(*command, "--lpips-weights", weights).json, svrgs(*command).json
    assert measured["lpips"] == measured["after"]["lpips"] != 0 and plain["lpips"] is None
    assert (measured["psnr"], measured["count"]) == (plain["psnr"], plain["count"])


@pytest.mark.parametrize("recipe", ["quick", "fine-tuned"])
def test_by_blocks_too(recipe, tiny, svrgs, weights, small_rig, monkeypatch, tmp_path):
    """As if memory sufficed for no scene as a whole."""
    monkeypatch.setattr("svrgs_addon.prune.recipes.fine_tuned.refuse_excess", too_little)
    monkeypatch.setattr(memory, "decimating", lambda *_: 10**15)
    command = (f"prune {tiny.splat} --out {tmp_path}/o.ply", *words(recipe, tiny), *short(recipe), "--json")
    masked = ("--visible-mask",) if recipe == "fine-tuned" else ()
    result = svrgs(*command, "--lpips-weights", weights, *masked).json
    assert result["blocks"] == 1 and result["lpips"] == result["after"]["lpips"] != 0


def too_little(what: str, *_):
    raise memory.MemoryShort(f"{what} needs more")


def test_a_report_has_it_where_the_weights_are_fetched(tiny, svrgs, weights, monkeypatch, tmp_path):
    monkeypatch.setenv(lpips.VARIABLE, str(weights))
    command = ("prune", tiny.splat, "--out", tmp_path / "o.ply", *FINE_TUNED, "--recovery", 20)
    command = (*command, "--data", tiny.folder, "--json")
    assert svrgs(*command).json["lpips"] is None
    result = svrgs(*command, "--report", tmp_path / "report").json
    row = (tmp_path / "report/index.html").read_text("utf-8").partition("LPIPS (VGG)")[2][:100]
    assert f"{result['before']['lpips']:.4f}" in row and f"{result['lpips']:.4f}" in row


@pytest.mark.parametrize("recipe", RECIPES)
def test_its_memory_counts_before_a_job_begins(
    recipe, tiny, svrgs, weights, small_rig, monkeypatch, tmp_path
):
    monkeypatch.setattr(memory, "LPIPS_PIXEL", 10**12)
    command = ("prune", tiny.splat, "--out", tmp_path / "o.ply", *words(recipe, tiny))
    done = svrgs(*command, "--lpips-weights", weights)
    assert done.status != 0 and "of memory" in done.err and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("damage", "why"), [("memory", "of memory"), ("file", "cannot be read as LPIPS weights")]
)
def test_unasked_it_is_left_out_with_the_reason(tiny, svrgs, weights, monkeypatch, tmp_path, damage, why):
    """Where memory is too short for it, or the fetched file is damaged, a report does without."""
    monkeypatch.setenv(lpips.VARIABLE, str(weights))
    if damage == "memory":
        monkeypatch.setattr(memory, "LPIPS_PIXEL", 10**12)
    else:
        (tmp_path / "w.npz").write_bytes(b"nothing")
        monkeypatch.setenv(lpips.VARIABLE, str(tmp_path / "w.npz"))
    words = ("--recovery", 20, "--data", tiny.folder, "--report", tmp_path / "report", "--json")
    result = svrgs("prune", tiny.splat, "--out", tmp_path / "o.ply", *FINE_TUNED, *words).json
    assert result["lpips"] is None and result["psnr"] > 0
    assert why in (tmp_path / "report/index.html").read_text("utf-8")


def test_eval_measures_both_inputs_by_name(tiny, svrgs, weights):
    command = ("eval", tiny.splat, "--data", tiny.folder, "--lpips-weights", weights, "--json")
    alone, both = svrgs(*command).json, svrgs(*command, "--lpips-authors").json
    assert alone["lpips"] == both["lpips"] and "lpips_authors" not in alone
    assert both["lpips_authors"] not in (0, both["lpips"])


def test_it_is_left_out_of_views_that_are_too_small_unless_it_is_named(svrgs, weights, monkeypatch, tmp_path):
    narrow = tiny_dataset.write_tiny(tmp_path, cameras=tiny_dataset.views(12, 1, 48))
    monkeypatch.setenv(lpips.VARIABLE, str(weights))
    words = f"--data {narrow.folder}"
    for done in (
        svrgs(f"eval {narrow.splat}", words),
        svrgs(f"compare {narrow.splat} {narrow.splat} --out {tmp_path}/c", words),
        svrgs(
            f"prune {narrow.splat} --out {tmp_path}/o.ply --report {tmp_path}/r",
            words,
            *FINE_TUNED,
            "--recovery 9",
        ),
    ):
        assert done.status == 0 and "PSNR" in done.out, done.err
    assert "LPIPS needs" in svrgs(f"eval {narrow.splat}", words, "--lpips-weights", weights).err
