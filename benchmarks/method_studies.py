"""The runs of each study of benchmarks/methods.py: label, flags of svrgs, what is changed in the program."""

from __future__ import annotations

from looks import LOOKS
from svrgs_addon.finetune.methods import METHODS

ITERATIONS, RECOVERY = 30_000, 5_000

TABLE = {
    "3DGS": ["--method", "3dgs", "--recovery", str(RECOVERY)],
    "MCMC": ["--method", "3dgs", "--recovery", str(RECOVERY), "--densify", "mcmc", "--cap", "100000"],
    "LightGaussian": ["--method", "lightgaussian"],
    "Compact3DGS": ["--method", "compact3dgs"],
    "MaskGS alpha": ["--method", "maskgs-alpha"],
    "MaskGS beta": ["--method", "maskgs-beta"],
    "MaskGS gamma": ["--method", "maskgs-gamma"],
    "GNS pressure": ["--method", "gns"],
    "SVR-GS": ["--method", "svr"],
    "Scenario A": ["--method", "svr-a"],
    "Scenario B": ["--method", "svr-b"],
    "SVR-GS, self term": ["--method", "svr-self"],
    "SVR-GS, even": ["--method", "svr-even"],
    "removal": ["--method", "removal"],
}
STARTS = ("3DGS", "MCMC")  # runs of `table` whose scenes are pruned
PAPER = ("3DGS", "MaskGS alpha", "SVR-GS", "Scenario A", "Scenario B")  # the runs of its tables
SWEEP = {
    f"lambda_F {value}": ["--method", "svr", "--lambda-f", value]
    for value in ("1e-4", "1.25e-4", "1.6e-4", "2e-4")
}
PRINTED = (
    "from svrgs_addon.finetune.methods import METHODS; [setattr(m, 'image_weights', (1.0, 1.0)) for m in"
    " METHODS.values()]"
)
TARGETS = ("0.5", "0.25", "0.1", "0.05")
RIVALS = (
    "opacity", "contribution", "max-contribution", "pup", "lightgaussian", "compact3dgs", "maskgs", "gns",
    "gaussianpop", "popspa", "speedy", "minisplatting", "reduced3dgs", "efficientgs", "rdo",
)  # fmt: skip
LIMITS = (10, 30, 60, 120)  # seconds
IN_TIME = ("removal", "maskgs", "gns", "speedy")
OURS = ("svr", "svr-self", "svr-even", "saliency", "removal")
# for methods that only recover: 3 000 + 5 000, as many steps as the others
AS_MANY_STEPS = ["--recovery", "8000"]


REMOVAL = "from svrgs_addon.finetune.methods import removal; "
ABLATION = {  # name of the run: Python code that changes the program before it runs
    "removal": "",
    "opacities not lowered": REMOVAL + "removal.lowering = lambda steps: (1.0, 1.0)",
    "odds of opacities not lowered": REMOVAL + "removal.MIN_ODDS_FACTOR = 1.0",
    "opacity rate the same in the whole phase": REMOVAL + "removal.FIRST_RATE = 1",
    "values not averaged": REMOVAL + "removal.AVERAGED = 0.0",
    "position rate of 3DGS at the end": REMOVAL + "removal.POSITION_LAST = 1.6e-6",
    "8 passes": REMOVAL + "removal.PASSES = 8",
    "opacity rate of the other methods": REMOVAL + "removal.OPACITY_RATE = 0.05",
}
OWN_RATES = "removal by 3DGS's rates"
PARTS = {  # the passes of removal, but nothing is lowered or averaged
    OWN_RATES: f"{REMOVAL}own, plain = removal.Removal, removal.Method; "
    "own.paced, own.rates = plain.paced, plain.rates; "
    "removal.lowering = lambda steps: (1.0, 1.0); removal.AVERAGED, removal.OPACITY_RATE = 0.0, 0.05"
}


def pareto() -> dict[str, list[str]]:
    """The runs of the study pareto: every method at every target."""
    runs = {"3dgs": ["--method", "3dgs", *AS_MANY_STEPS]}
    for method in RIVALS + OURS:
        steps = AS_MANY_STEPS if METHODS[method].ranks else []
        runs |= {f"{method} {target}": ["--method", method, "--target", target, *steps] for target in TARGETS}
    runs |= {f"{OWN_RATES} {target}": ["--method", "removal", "--target", target] for target in TARGETS}
    straight = ["--method", "3dgs", "--recovery", str(RECOVERY + 8000), "--densify", "mcmc"]
    # MCMC never has fewer than the sparse points
    return runs | {f"mcmc {target}": straight for target in TARGETS[:2]}


RANKED = "from svrgs_addon.finetune.methods import METHODS; METHODS['removal'].ranking = "
RANKINGS = {"removal": ""} | {
    name: f"{RANKED}METHODS['{name}'].score"
    for name in ("speedy", "lightgaussian", "contribution", "opacity")  # that of removal is GaussianPOP's
}
RANKINGS["random"] = (
    f"import numpy; {RANKED}lambda scene, *_: numpy.random.default_rng(scene.count).random(scene.count)"
)
LOOKING = {name: f"from looks import look; {RANKED}look({name!r})" for name in LOOKS if not LOOKS[name][2]}
EQUAL_TARGETS = ("0.5", "0.25", "0.1", "0.05", "0.025")


def equal() -> dict[str, list[str]]:
    """The runs of the study equal. Nothing removed: what the steps alone give, plain and by the recipe."""
    runs = {
        "steps of 3dgs 1": ["--method", "3dgs", *AS_MANY_STEPS],
        "removal 1": ["--method", "removal", "--target", "1"],
    }
    for target in EQUAL_TARGETS:
        runs |= {f"{name} {target}": ["--method", "removal", "--target", target] for name in RANKINGS}
    return runs


def published() -> dict[str, list[str]]:
    """The runs of the study published: rivals with their published steps, and the default with as many, by
    its own recipe and by theirs."""
    runs = {}
    for target in ("0.25", "0.1"):
        for method in ("lightgaussian", "speedy", "gaussianpop"):
            runs[f"{method}, 5 k {target}"] = ["--method", method, "--target", target, "--recovery", "5000"]
        for method in ("maskgs", "removal"):
            steps = ["--method", method, "--target", target, "--iterations", "5000", "--recovery", "5000"]
            runs[f"{method}, 5 k + 5 k {target}"] = steps
        steps = ["--method", "removal", "--target", target, "--iterations", "1900", "--recovery", "3100"]
        runs |= {f"{name}, 5 k {target}": steps for name in ("removal", OWN_RATES)}
        runs[f"{OWN_RATES}, 5 k + 5 k {target}"] = runs[f"removal, 5 k + 5 k {target}"]
    return runs


# what else steps could learn from, so that few keep the texture (texture.py): the weights of L1 and SSIM, and
# of a term that is added, with which it is about as large as they are
WEIGHTS = "from svrgs_addon.finetune.methods import METHODS; METHODS['removal'].image_weights = {}; "
TERM = "from texture import add_term; add_term({!r}, {})"
BOTH = "gradients 1.5, SSIM 0.5"
TEXTURE = {
    "removal": "",
    "L1 0.2, SSIM 0.8": WEIGHTS.format((0.2, 0.8)),
    "gradients 0.5": TERM.format("gradients", 0.5),
    BOTH: WEIGHTS.format((0.8, 0.5)) + TERM.format("gradients", 1.5),
    "SSIM of smaller sizes 0.2": TERM.format("SSIM of smaller sizes", 0.2),
    "local contrast 1": TERM.format("local contrast", 1.0),
    "LPIPS 0.1": TERM.format("LPIPS", 0.1),
    "teacher": "from texture import add_teacher; add_teacher()",
}
LEVELS = {
    level: f"from svrgs_addon.native import rasterizer; rasterizer.best_level = lambda: {level!r}"
    for level in ("scalar", "baseline", "avx2", "avx512")
}
# SH degrees at the same share, and at shares that make an SPZ about as large as a tenth with all bands
DEGREES = ((3, "0.1"), (2, "0.1"), (1, "0.1"), (0, "0.1"), (2, "0.115"), (1, "0.13"), (0, "0.15"))
SIZES = ("0.2", "0.6")  # MB, of the study sizes
COARSE, VIEWS = ["--coarse-until", "10000"], ["--views-by-loss"]
SKIPS = {"plain": [], "coarse": COARSE, "views": VIEWS, "coarse, views": COARSE + VIEWS}
SCENARIOS = {
    f"Scenario {name} {value}": ["--method", f"svr-{name.lower()}", "--lambda-f", value]
    for name, values in (("A", ("1e-4", "1e-3", "1e-2", "1e-1")), ("B", ("1e-5", "1e-4", "1e-3")))
    for value in values
}


STUDIES = {
    "table": TABLE,
    "equal": equal(),
    "looks": {
        f"{name} {target}": ["--method", "removal", "--target", target]
        for target in ("0.25", "0.1")
        for name in LOOKING
    },
    "printed": {run: TABLE[run] for run in PAPER} | SWEEP,
    "lambda": SWEEP,
    "pareto": pareto(),
    "ablation": {
        f"{label} {target}": ["--method", "removal", "--target", target]
        for target in ("0.17", "0.05")
        for label in ABLATION
    },
    "published": published(),
    "texture": {
        f"{name} {target}": ["--method", "removal", "--target", target]
        for target in ("1", "0.1")
        for name in (TEXTURE if target != "1" else ["removal", BOTH])
    },
    "degrees": {
        f"SH {degree} {target}": ["--method", "removal", "--target", target, "--sh-degree", str(degree)]
        for degree, target in DEGREES
    },
    "sizes": {
        f"SH {degree}, {size} MB": ["--method", "removal", "--target-size", size, "--sh-degree", str(degree)]
        for size in SIZES
        for degree in (3, 2, 1, 0)
    },
    "skips": {name: [*TABLE["3DGS"], *flags] for name, flags in SKIPS.items()},
    "levels": {level: TABLE["3DGS"] for level in LEVELS},
    "scenarios": SCENARIOS,
    "time": {
        f"{method} {limit} s": ["--method", method, "--target", "0.1", "--time", str(limit)]
        for limit in LIMITS
        for method in IN_TIME
    },
}
# these prune the scene of a run of `table`
PRUNED = ("equal", "looks", "pareto", "published", "ablation", "texture", "degrees", "sizes", "time")


def change_of(study: str, run: str) -> str:
    """The Python code that changes the program before a run."""
    changes = dict(ablation=ABLATION, equal=RANKINGS, looks=LOOKING, levels=LEVELS, texture=TEXTURE)
    changes |= {"pareto": PARTS, "published": PARTS}
    name = (run.rpartition(" ")[0] or run).partition(", 5 k")[0]
    return PRINTED if study == "printed" else changes.get(study, {}).get(name, "")
