"""`svrgs prune`: its result, file and report, every method, budgets, and the first cut."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

import tiny_dataset
from command_checks import MEASURES, TEST_VIEWS, files, refused
from svrgs_addon.cli.arguments import parser
from svrgs_addon.files.ply import read_ply
from svrgs_addon.finetune import scores
from svrgs_addon.finetune.methods import METHODS
from svrgs_addon.finetune.viewed_scene import ViewedScene
from svrgs_addon.prune.options import GROUPS, PruneOptions
from svrgs_addon.system.option_kinds import options_of

ROOT = Path(__file__).resolve().parents[1]


SHORT = ("--iterations", 8, "--recovery", 4, "--quiet")


def measures(result: dict) -> dict:
    """The part of a result that is the same for every run."""
    return {name: result[name] for name in MEASURES - {"ms_per_frame"}}


@pytest.fixture(scope="module")
def pruned(tiny, tmp_path_factory) -> dict:
    """Result of one real pruning run with a report; 'folder' beside its keys."""
    folder = tmp_path_factory.mktemp("pruned")
    words = (
        f"prune {tiny.splat} --data {tiny.folder} --iterations 300 --recovery 200 --target 0.4 --json"
        f" --out {folder}/small.ply --report {folder}/report"
    ).split()
    command = [sys.executable, "-m", "svrgs_addon", *words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert re.search(r"recover 500/500 .* Gaussians", done.stderr), "progress belongs on stderr"
    assert done.stdout.count("\n") == 1
    return {"folder": folder, **json.loads(done.stdout)}


def test_prune_result(tiny, pruned):
    assert MEASURES | {"before", "after", "seconds", "method", "lambda_f", "out"} <= pruned.keys()
    assert pruned["before"].keys() == pruned["after"].keys() == MEASURES
    assert (pruned["method"], pruned["lambda_f"]) == ("removal", None), "the target says how many stay"
    assert tiny_dataset.FAINT <= pruned["first_cut"] < tiny_dataset.COUNT
    assert pruned["count"] == round(0.4 * tiny_dataset.COUNT)
    assert pruned["before"]["count"] == tiny_dataset.COUNT
    assert pruned["psnr"] > pruned["before"]["psnr"] + 1, "fine-tuning does not fit the photographs"
    assert sorted(files(pruned["folder"])) == ["report/index.html", "small.ply"]


def test_prune_measures_what_eval_measures(tiny, pruned, svrgs):
    for scene, part in ((pruned["out"], "after"), (tiny.splat, "before")):
        assert measures(svrgs("eval", scene, "--data", tiny.folder, "--json").json) == pytest.approx(
            measures(pruned[part]), rel=1e-12
        )
    assert measures(pruned) == measures(pruned["after"])


def test_pruned_file_keeps_the_form_of_its_source(tiny, pruned):
    source, small = read_ply(tiny.splat), read_ply(pruned["out"])
    assert (small.count, small.sh_degree) == (pruned["count"], source.sh_degree)
    assert small.antialiased == source.antialiased
    assert small.property_order == source.property_order
    assert small.attributes.keys() == source.attributes.keys()


def test_report_is_one_page_with_table_plots_and_pictures(pruned):
    page = (pruned["folder"] / "report/index.html").read_text("utf-8")
    assert "no LPIPS weights: give --lpips-weights" in page
    assert f"{pruned['before']['psnr']:.2f} dB" in page and f"{pruned['psnr']:.2f} dB" in page
    pictures = 6 * len(TEST_VIEWS) + 3  # of each view, and of where it differs most
    assert page.count("<svg") >= 3
    assert len(re.findall('src="data:image/[a-z]+;base64,', page)) == pictures
    assert not re.search(r'(src|href)="(?!data:)', page) and "http-equiv" in page and "@import" not in page


@pytest.mark.parametrize(
    "method", [name for name, method in METHODS.items() if not method.ranks and not method.share]
)
def test_every_method_runs(tiny, svrgs, tmp_path, method):
    result = svrgs(
        f"prune {tiny.splat} --data {tiny.folder} --method {method}", *SHORT, f"--out {tmp_path}/o.ply --json"
    ).json
    assert result["method"] == method and result["lambda_f"] == (METHODS[method].lambda_f or None)
    left = tiny_dataset.COUNT - result["first_cut"]
    own_rule = ("removal", "saliency", "minisplatting", "minisplatting-outdoor", "reduced3dgs", "efficientgs")
    # masks cannot have learned in so few steps
    assert result["count"] < left if method in own_rule else result["count"] == left
    assert (
        result["first_cut"] > tiny_dataset.FAINT
        if method.startswith("svr")
        else result["first_cut"] == tiny_dataset.FAINT
    )
    assert result["iterations"] == (4 if method == "3dgs" else 12)


@pytest.mark.parametrize("method", [name for name, method in METHODS.items() if method.ranks or method.share])
def test_every_method_with_a_budget_prunes_to_it(tiny, svrgs, tmp_path, method):
    """Asked for, or its own where it has one."""
    for target in (("--target-count", 70), ("--target", 0.5), ()):
        job = f"prune {tiny.splat} --data {tiny.folder} --method {method} --out {tmp_path}/o.ply --json"
        words = (job, *target, *SHORT)
        if not target and not METHODS[method].share:
            refused(svrgs(*words), f"method '{method}' needs --target")
            continue
        share = METHODS[method].share or 0.5
        expected = {"--target-count": 70, "--target": tiny_dataset.COUNT // 2}.get(
            target and target[0], round(share * tiny_dataset.COUNT)
        )
        assert svrgs(*words).json["count"] == expected


@pytest.mark.parametrize("method", [name for name in METHODS if name != "3dgs"])
def test_every_method_trains_to_a_share(tiny, svrgs, tmp_path, method):
    """Of the Gaussians there are when densification ends: here of the sparse points, which none has
    multiplied."""
    words = (
        f"--method {method} --target 0.5 --iterations 60 --recovery 5 --sh-degree 0",
        "--densify-until 20 --quiet --json",
    )
    result = svrgs("train", "--data", tiny.folder, *words, "--out", tmp_path / "o.ply").json
    assert result["count"] == result["target"] == tiny_dataset.SEEN // 2 and result["iterations"] == 65


@pytest.mark.slow
def test_training_by_mcmc_grows_to_its_cap(tiny, svrgs, tmp_path):
    words = (
        f"train --data {tiny.folder} --densify mcmc --schedule 0.01 --sh-degree 0 --quiet --json",
        f"--out {tmp_path}/o.ply",
    )
    once = int(1.05 * tiny_dataset.SEEN)
    for cap, count in ((once + 1, once + 1), (10_000, int(1.05 * once))):
        assert svrgs(*words, "--cap", cap).json["count"] == count
    assert svrgs(*words, "--target-count", once).json["count"] == once
    assert (
        svrgs(*words, "--cap", 10_000, "--method", "lightgaussian", "--target-count", 50).json["count"] == 50
    )
    refused(svrgs(*words), "--densify mcmc needs --cap")


def test_the_papers_form_is_chosen_by_a_flag(tiny, svrgs, tmp_path):
    words = (f"--data {tiny.folder} --paper --method svr", *SHORT, f"--out {tmp_path}/o.ply --json")
    result = svrgs("prune", tiny.splat, *words).json
    assert (result["method"], result["lambda_f"]) == ("svr-paper", 1e-4)
    assert result["first_cut"] == tiny_dataset.FAINT
    refused(svrgs("prune", tiny.splat, *words, "--method", "maskgs"), "--paper", "'maskgs'")
    refused(
        svrgs(
            "prune", tiny.splat, "--data", tiny.folder, "--method", "svr-paper", "--out", tmp_path / "p.ply"
        ),
        "unknown",
    )


def test_every_method_is_listed_with_its_source_and_its_weights(svrgs):
    found = svrgs("methods", "--json").json["methods"]
    assert [entry["name"] for entry in found] == list(METHODS)
    for entry in found:
        assert entry["source"] and entry["help"], "a method names its paper"
        assert (
            bool(entry["lambda_f"])
            == bool(METHODS[entry["name"]].lambda_f)
            == bool(entry["lambda_f_meaning"])
        )
    said = svrgs("methods").out
    assert all(f"\n{name} ({method.label})\n" in said for name, method in METHODS.items())
    assert "Ranks the Gaussians and cuts." in said
    assert "λ_m (--lambda-m): 0.02, in svrgs train 0.0005." in said, "MaskGaussian prunes with another weight"


def test_the_page_names_the_papers_that_the_program_names():
    page = (ROOT / "docs/methods.md").read_text("utf-8")
    papers = {
        number for method in METHODS.values() for number in re.findall(r"arXiv (\S+?)(?:,|$)", method.source)
    }
    assert papers and all(number in page for number in papers)


def test_help_fits_one_screen_and_help_all_has_the_rest(svrgs, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    short, whole = svrgs("prune", "--help").out, svrgs("prune", "--help-all").out
    assert len(short.splitlines()) <= 40 and all(f"\n{group}:\n" in short for group in GROUPS)
    flags = {
        f"--{option.flag or name.replace('_', '-')}" for name, option in options_of(PruneOptions).items()
    }
    assert flags <= set(re.findall(r"--[a-z-]+", whole)) and not flags <= set(re.findall(r"--[a-z-]+", short))
    assert "--colmap" not in whole and "--cameras" not in whole


def test_older_names_of_options_are_still_read():
    for command, words in {"prune": ["x.ply"], "select": ["x.ply"], "eval": ["x.ply"]}.items():
        for flag in ("--colmap", "--data"):
            assert parser().parse_args([command, *words, flag, "here"]).data == Path("here")
            assert parser().parse_args([command, *words, f"{flag}=here"]).data == Path("here")
    for flag in ("--cameras", "--seen-from"):
        assert parser().parse_args(["prune", "x.ply", flag, "c.json"]).cameras == Path("c.json")
    for flag in ("--steps", "--tuning-steps"):
        assert parser().parse_args(["large", "tune", "work", flag, "3"]).steps == 3


def test_opacity_keeps_the_most_opaque(tiny, svrgs, tmp_path):
    words = ("--method", "opacity", "--target-count", 50, "--recovery", 0, "--quiet", "--json")
    assert (
        svrgs("prune", tiny.splat, "--data", tiny.folder, *words, "--out", tmp_path / "o.ply").json["count"]
        == 50
    )
    logits = read_ply(tiny.splat).opacity_logits
    assert np.array_equal(np.sort(read_ply(tmp_path / "o.ply").opacity_logits), np.sort(logits)[-50:])


def test_contribution_keeps_what_contributes_most(tiny, svrgs, tmp_path):
    words = ("--method", "contribution", "--target", 0.2, "--recovery", 0, "--quiet", "--json")
    assert (
        svrgs("prune", tiny.splat, "--data", tiny.folder, *words, "--out", tmp_path / "o.ply").json["count"]
        == 50
    )
    scene = read_ply(tiny.splat)
    train = [camera for i, camera in enumerate(tiny.cameras) if i % 8]
    sums, _, _ = scores.contribution(ViewedScene.of(scene, train))
    expected = scene.means[np.sort(np.argsort(-sums)[:50])]
    assert np.array_equal(read_ply(tmp_path / "o.ply").means, expected)


def first_cut(tiny, svrgs, out: Path, *words: object) -> dict:
    """Result of a pruning run that takes no step."""
    words = ("--iterations", 0, "--recovery", 0, "--quiet", "--json", *words)
    return svrgs("prune", tiny.splat, "--data", tiny.folder, *words, "--out", out).json


def test_the_first_cut_drops_what_contributes_little_to_every_training_view(tiny, svrgs, tmp_path):
    result = first_cut(tiny, svrgs, tmp_path / "o.ply", "--min-contribution", 0.3)
    scene = read_ply(tiny.splat)
    train = [camera for i, camera in enumerate(tiny.cameras) if i % 8]
    _, peaks, _ = scores.contribution(ViewedScene.of(scene, train))
    assert 10 < result["count"] == (peaks >= 0.3).sum() < 200
    assert result["first_cut"] == tiny_dataset.COUNT - result["count"]
    assert np.array_equal(read_ply(tmp_path / "o.ply").means, scene.means[peaks >= 0.3])


def test_the_first_cut_spares_enough_for_a_target(tiny, svrgs, tmp_path):
    words = "--min-contribution 0.9 --iterations 2 --recovery 0 --target-count 200 --quiet --json"
    done = svrgs("prune", tiny.splat, "--data", tiny.folder, words, "--out", tmp_path / "o.ply")
    assert done.json["count"] == 200


def test_only_the_invisible_goes_where_nothing_else_is_asked_for(tiny, svrgs, tmp_path):
    result = first_cut(tiny, svrgs, tmp_path / "o.ply", "--min-contribution", 0)
    assert result["count"] == tiny_dataset.COUNT - tiny_dataset.FAINT
    assert result["psnr"] == result["before"]["psnr"]


def test_a_scene_that_would_lose_everything_is_refused(tiny, svrgs, tmp_path):
    done = svrgs(
        f"prune {tiny.splat} --data {tiny.folder} --lambda-f 1e9 --iterations 2500 --recovery 0 --quiet",
        f"--out {tmp_path}/o.ply --report {tmp_path}/report",
    )
    refused(done, "pruning would leave", "smaller lambda-f")
    assert not list(tmp_path.iterdir())
