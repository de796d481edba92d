"""What docs/results.md says of runs on equal terms, and of rivals with their published recoveries, is what
the rows hold."""

from statistics import fmean

from published_rows import by_run, gains_by_seed, means_by_run, said


def test_sentences_on_longer_runs_are_those_of_the_rows():
    case = {"study": "equal", "trained": 0.1, "shrink": 2}
    steps = (0.4, 1.0)
    miku = {n: means_by_run(**case, scene="snowmiku", schedule=n) for n in (0.1, *steps)}
    figures = lambda n, run: [round(miku[n][run][0], 2), round(miku[n][run][1], 3)]
    sentence = "A tenth of snowmiku has # dB and # LPIPS after 800 steps, # and # after 3,200,"
    expected = [figure for n in miku for figure in figures(n, "removal 0.1")]
    assert said("results.md", f"{sentence} # and # after 8,000") == expected
    plain = figures(1.0, "steps of 3dgs 1")
    assert said("results.md", "as many plain steps have # and #. So PSNR comes back") == plain
    half = by_run(**case, scene="snowmiku", schedule=0.05)["removal 0.1"]
    expected = [round(half["psnr"], 2), round(half["lpips"], 3)]
    assert said("results.md", "a tenth of snowmiku has # dB and # LPIPS.") == expected
    ends = lambda gaps: [round(end(gap[k] for gap in gaps), 2 + k) for k in (0, 1) for end in (min, max)]
    speedy = [gains_by_seed("removal 0.1", "speedy 0.1", **case, scene="snowmiku", schedule=n) for n in steps]
    assert all(gap > 0 for some in speedy for pair in some for gap in pair)
    mean = [tuple(map(fmean, zip(*some, strict=True))) for some in speedy]
    assert said("results.md", "`speedy` is # to # dB and # to # LPIPS behind in the mean") == ends(mean)
    south = [
        gains_by_seed("removal 0.1", "speedy 0.1", **case, scene="south_building", schedule=n) for n in steps
    ]
    level = [tuple(map(fmean, zip(*some, strict=True))) for some in south]
    most = said("results.md", "On south_building the two are within # dB and # LPIPS in the mean")
    assert all(abs(psnr) <= most[0] and abs(lpips) <= most[1] for psnr, lpips in level)
    faint = {
        scene: gains_by_seed("opacity 0.1", "removal 0.1", **case, scene=scene, schedule=0.4)
        for scene in ("south_building", "snowmiku")
    }
    mean = [value for some in faint.values() for value in map(fmean, zip(*some, strict=True))]
    sentence = "`opacity` is # dB and # LPIPS ahead there, and # dB and # LPIPS behind on snowmiku"
    signed = zip((1, 1, -1, -1), mean, (2, 3, 2, 3), strict=True)
    assert said("results.md", sentence) == [round(sign * value, digits) for sign, value, digits in signed]
    recipe = [
        gains_by_seed("removal 1", "steps of 3dgs 1", **case, scene=scene, schedule=n)
        for scene in ("snowmiku", "south_building") for n in steps
    ]  # fmt: skip
    mean = [tuple(map(fmean, zip(*some, strict=True))) for some in recipe]
    found = [round(end(gain[k] for gain in mean), 1 + 2 * k) for k in (0, 1) for end in (min, max)]
    assert said("results.md", "stays # to # dB and # to # LPIPS ahead of plain steps in the mean") == found


def test_sentences_on_other_counts_after_longer_runs_are_those_of_the_rows():
    case = {"study": "equal", "trained": 0.1, "shrink": 2, "schedule": 0.4}
    for scene, start in (("snowmiku", "of them snowmiku has"), ("south_building", "south_building")):
        runs = means_by_run(**case, scene=scene)
        found = [runs[f"removal {share}"] for share in ("1", "0.5", "0.05", "0.025")]
        figures = [figure for psnr, lpips in found for figure in (round(psnr, 2), round(lpips, 3))]
        assert said("results.md", f"{start} # dB and # LPIPS, # and #, # and #, # and #") == figures
    gaps = {
        (scene, share): gains_by_seed(f"removal {share}", f"speedy {share}", **case, scene=scene)
        for scene in ("snowmiku", "south_building") for share in ("0.5", "0.05", "0.025")
    }  # fmt: skip
    mean = {key: [round(fmean(gap[k] for gap in some), 2 + k) for k in (0, 1)] for key, some in gaps.items()}
    few = [("snowmiku", share) for share in ("0.05", "0.025")]
    sentence = "seed on snowmiku, by # dB and # LPIPS, and # and #; on"
    assert said("results.md", sentence) == [figure for key in few for figure in mean[key]]
    assert all(gap > 0 for key in few for pair in gaps[key] for gap in pair)
    level = [mean["snowmiku", "0.5"][0], -mean["south_building", "0.5"][0]]
    assert said("results.md", "With a half `speedy` is level (# and −# dB)") == level
    (within,) = said("results.md", "it is level in PSNR (within # dB)")
    south = [("south_building", share) for share in ("0.05", "0.025")]
    assert all(abs(mean[key][0]) <= within for key in south)
    assert said("results.md", "and # and # LPIPS behind with every seed.") == [mean[key][1] for key in south]
    assert all(lpips > 0 for key in south for _, lpips in gaps[key])


def test_sentences_on_passes_with_the_recovery_of_rivals_are_those_of_the_rows():
    case = {"study": "published"}
    rivals = {"gaussianpop": "5 k", "speedy": "5 k", "lightgaussian": "5 k", "maskgs": "5 k + 5 k"}

    def gains(ours: str, name: str, share: str) -> tuple[list, tuple[float, float]]:
        steps = f", {rivals[name]} {share}"
        found = gains_by_seed(f"{ours}{steps}", f"{name}{steps}", **case)
        return found, (round(fmean(one[0] for one in found), 2), round(fmean(one[1] for one in found), 3))

    whole = {share: [gains("removal", name, share) for name in rivals] for share in ("0.1", "0.25")}
    sentence = (
        "with a tenth by # dB and # LPIPS (`gaussianpop`), # and # (`speedy`), # and # (`lightgaussian`)"
    )
    assert said("results.md", sentence) == [figure for _, mean in whole["0.1"][:3] for figure in mean]
    assert said("results.md", ", # and # (`maskgs`); with a quarter") == [*whole["0.1"][3][1]]
    sentence = "with a quarter by # and #, # and #, # and #, # and #. In LPIPS"
    assert said("results.md", sentence) == [figure for _, mean in whole["0.25"] for figure in mean]
    seeds = [gain for found in whole.values() for some, _ in found for gain in some]
    behind = [psnr for psnr, _ in seeds if psnr < 0]
    assert all(lpips > 0 for _, lpips in seeds) and len(behind) == 2
    assert said("results.md", "have up to # dB more.\n") == [round(-min(behind), 2)]
    passes = "removal by 3DGS's rates"
    tenth = [gains(passes, name, "0.1") for name in ("gaussianpop", "speedy", "maskgs")]
    sentence = (
        "by # dB (`gaussianpop`), # (`speedy`) and # (`maskgs`) in the mean, and in LPIPS with every seed"
    )
    assert said("results.md", sentence) == [mean[0] for _, mean in tenth]
    assert all(lpips > 0 for found, _ in tenth for _, lpips in found)
    quarter = gains(passes, "gaussianpop", "0.25")[1]
    assert said("results.md", "level with `gaussianpop` (+# dB, −# LPIPS)") == [quarter[0], -quarter[1]]
    rest = {
        share: [
            gains_by_seed(f"removal, {n} {share}", f"{passes}, {n} {share}", **case)
            for n in ("5 k", "5 k + 5 k")
        ]
        for share in whole
    }
    mean = lambda some, k: round(fmean(gain[k] for gain in some), 2 + k)
    assert said("results.md", "adds # and # dB with a tenth") == [mean(some, 0) for some in rest["0.1"]]
    assert all({gain[0] > 0 for gain in some} == {True, False} for some in rest["0.1"])
    assert all(abs(mean(some, 1)) < 0.003 for some in rest["0.1"])
    found = [mean(some, k) for k in (0, 1) for some in rest["0.25"]]
    assert said("results.md", "with a quarter # and # dB, # and # LPIPS") == found
