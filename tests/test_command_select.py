"""`svrgs select`: counts, files, refusals."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

import scenes
from command_checks import files, refused
from svrgs_addon.files.ply import read_ply, write_ply
from svrgs_addon.files.registry import read_parts, write_scene
from svrgs_addon.prune.selection.criteria import sizes
from svrgs_addon.scene.gaussians import SH_C0
from svrgs_addon.system import memory


@pytest.fixture
def splat(tmp_path):
    scene = scenes.random_scene(200)
    write_ply(
        tmp_path / "s.ply", dataclasses.replace(scene, attributes={"label": np.arange(200, dtype=np.float32)})
    )
    return tmp_path / "s.ply"


def test_a_range_of_opacities_is_written_with_all_columns(svrgs, splat):
    source = read_ply(splat)
    opacities = 1 / (1 + np.exp(-source.opacity_logits.astype(np.float64)))
    wanted = np.flatnonzero((opacities >= 0.3) & (opacities <= 0.7))
    assert 0 < len(wanted) < 200
    result = svrgs("select", splat, "--opacity", "0.3,0.7", "--out", splat.with_name("o.ply"), "--json").json
    found = read_ply(splat.with_name("o.ply"))
    assert result["selected"] == found.count == len(wanted) and result["count"] == 200
    assert (found.attributes["label"] == wanted).all() and (found.means == source.means[wanted]).all()


def test_criteria_are_combined_and_inverted(svrgs, splat):
    count = lambda *words: svrgs("select", splat, *words, "--json").json["selected"]
    box = ("--box", "-1000,-1000,-1000,1000,1000,0.5")
    opaque, both = count("--opacity", "0.5,"), count("--opacity", "0.5,", *box)
    assert both <= opaque and both <= count(*box)
    assert (
        svrgs("select", splat, "--opacity", "0.5,", "--invert", "--out", splat.with_name("rest.ply")).status
        == 0
    )
    assert read_ply(splat.with_name("rest.ply")).count == 200 - opaque


def test_criteria_of_single_gaussians_need_no_memory_for_the_scene(svrgs, tmp_path, monkeypatch):
    scene = scenes.random_scene(30_000)
    scene.means[7] = np.nan
    write_scene(tmp_path / "s.ply", scene)
    parts = [part.count for part in read_parts(tmp_path / "s.ply")]
    kept = (np.linalg.norm(scene.means.astype(np.float64), axis=1) <= 1.5) & (sizes(scene) >= 0.05)
    monkeypatch.setattr(memory, "reading", lambda _: 10**15)
    found = svrgs(
        f"select {tmp_path}/s.ply --size 0.05, --sphere 0,0,0,1.5 --out {tmp_path}/o.ply --json"
    ).json
    assert len(parts) > 2
    assert (found["count"], found["selected"], found["unusable"]) == (30_000, kept.sum(), 1)
    assert 0 < kept.sum() < 30_000
    assert (read_ply(tmp_path / "o.ply").sh == scene.sh[kept]).all()
    assert (
        svrgs("select", tmp_path / "s.ply", "--sphere", "0,0,0,1.5", "--invert", "--json").json["selected"]
        > 0
    )
    refused(svrgs("select", tmp_path / "s.ply", "--floaters"), "of memory")


def test_without_an_output_nothing_is_written(svrgs, splat):
    before = files(splat.parent)
    done = svrgs("select", splat, "--opacity", ",0.5")
    assert done.status == 0 and "of 200 Gaussians selected" in done.out
    assert files(splat.parent) == before


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "no criterion"),
        (("--opacity", "0.9,0.1"), "lower one first"),
        (("--box", "1,2,3"), "six numbers"),
        (("--sphere", "0,0,0,nan"), "four numbers"),
        (("--contribution", "1,"), "--data or --cameras"),
        (("--opacity", "2,3", "--out", "OUT"), "no Gaussian fulfils"),
        (("--opacity", "0,1", "--out", "IN"), "never overwritten"),
        (("--opacity", "0,1", "--out", "OUT.txt"), "OUT.txt"),
    ],
)
def test_refusals(svrgs, splat, words, said):
    places = {"OUT": splat.with_name("o.ply"), "IN": splat, "OUT.txt": splat.with_name("OUT.txt")}
    before = files(splat.parent)
    refused(svrgs("select", splat, *(places.get(word, word) for word in words)), said)
    assert files(splat.parent) == before


def test_a_base_colour_is_selected(svrgs, splat):
    colours = 0.5 + SH_C0 * read_ply(splat).sh[:, 0].astype(np.float64)
    wanted = np.linalg.norm(colours - (0.6, 0.4, 0.5), axis=1) <= 0.3
    assert 0 < wanted.sum() < 200
    result = svrgs("select", splat, "--color", "0.6,0.4,0.5,0.3", "--json").json
    assert result["selected"] == wanted.sum()
