"""PSNR, SSIM, FLIP and LPIPS: known values, independent computations, symmetries, refusal of what does not
compare."""

import math
import subprocess
import sys

import numpy as np
import pytest

from svrgs_addon.render.metrics import Lpips, flip, flip_map, load_lpips, psnr, ssim
from svrgs_addon.system.errors import FormatError, SceneError

METRICS = (psnr, ssim, flip)


def waves(phase: float) -> np.ndarray:
    """A smooth coloured pattern (48, 64, 3) that does not depend on any random generator."""
    y, x = np.mgrid[:48, :64]
    channels = [0.5 + 0.5 * np.sin(x * k / 7 + y / (5 + k) + phase * k) for k in (1, 2, 3)]
    return np.stack(channels, axis=-1).astype(np.float32)


def flat(colour) -> np.ndarray:
    return np.broadcast_to(np.float32(colour), (32, 32, 3))


def noisy_pair(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    return tuple(np.random.default_rng(4).random((2, height, width, 3), np.float32))


@pytest.mark.parametrize("metric", METRICS)
def test_order_of_images_does_not_matter(metric):
    a, b = waves(0.0), waves(0.3)
    assert metric(a, b) == pytest.approx(metric(b, a), abs=1e-6)


@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize("shape", [(32, 31, 3), (32, 32), (32, 32, 4)])
def test_other_shapes_are_refused(metric, shape):
    with pytest.raises(SceneError):
        metric(flat(0.5), np.zeros(shape, np.float32))


@pytest.mark.parametrize("metric", METRICS)
def test_nan_is_refused(metric):
    with pytest.raises(SceneError, match="NaN"):
        metric(flat(0.5), flat(np.nan))


def test_psnr_of_a_constant_offset():
    assert psnr(flat(0.25), flat(0.35)) == pytest.approx(20.0, abs=1e-5)
    assert psnr(flat(0), flat(1)) == 0.0


def test_psnr_of_equal_images_is_infinite():
    assert psnr(waves(0.0), waves(0.0)) == math.inf


def test_ssim_of_equal_images_is_one():
    assert ssim(waves(0.0), waves(0.0)) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("shape", [(48, 64), (7, 5)])
def test_ssim_against_its_formula_in_float64(shape):
    ndimage = pytest.importorskip("scipy.ndimage")
    a, b = (image.astype(np.float64) for image in noisy_pair(*shape))

    def window(image):
        return ndimage.gaussian_filter(image, (1.5, 1.5, 0), mode="constant", truncate=5 / 1.5)

    mean_a, mean_b = window(a), window(b)
    var_a, var_b = window(a * a) - mean_a**2, window(b * b) - mean_b**2
    covariance = window(a * b) - mean_a * mean_b
    top = (2 * mean_a * mean_b + 1e-4) * (2 * covariance + 9e-4)
    bottom = (mean_a**2 + mean_b**2 + 1e-4) * (var_a + var_b + 9e-4)
    assert ssim(a, b) == pytest.approx((top / bottom).mean(), abs=2e-7)


def test_flip_of_equal_images_is_zero_everywhere():
    assert not flip_map(waves(0.0), waves(0.0)).any()


# The expected numbers below are those of the authors' flip-evaluator 1.7 for the same arrays.
@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [((0, 0, 0), (1, 1, 1), 0.967388), ((0, 1, 0), (0, 0, 1), 1.0)],
    ids=["black and white", "green and blue"],
)
def test_flip_of_flat_images(a, b, expected):
    assert flip(flat(a), flat(b)) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize(
    ("ppd", "mean", "pixels"),
    [(67.0206, 0.691599, (0.740098, 0.655327, 0.753546)), (30.0, 0.740069, (0.735741, 0.753370, 0.804998))],
)
def test_flip_agrees_with_its_authors_program(ppd, mean, pixels):
    errors = flip_map(waves(0.0), waves(0.3), ppd)
    assert errors.shape == (48, 64) and errors.dtype == np.float32
    assert errors.mean() == pytest.approx(mean, abs=1e-4)
    assert [errors[0, 0], errors[20, 30], errors[47, 63]] == pytest.approx(pixels, abs=2e-4)


def test_flip_sees_edges_and_points_as_its_authors_program_does():
    a = np.full((48, 64, 3), 0.2, np.float32)
    b = a.copy()
    b[:, 32:] += 0.1
    b[10, 10] = 1
    errors = flip_map(a, b)
    assert errors.mean() == pytest.approx(0.169113, abs=1e-4)
    assert [errors[10, 10], errors[30, 32], errors[30, 60]] == pytest.approx(
        [0.658372, 0.321153, 0.313894], abs=2e-4
    )


def test_flip_grows_with_the_difference():
    values = [flip(flat(0.5), flat(0.5 + step)) for step in (0.01, 0.1, 0.5)]
    assert values == sorted(values)


# --- LPIPS ---

CONVOLUTIONS = {
    0: (3, 64),
    2: (64, 64),
    5: (64, 128),
    7: (128, 128),
    10: (128, 256),
    12: (256, 256),
    14: (256, 256),
}
CONVOLUTIONS |= {17: (256, 512)} | dict.fromkeys((19, 21, 24, 26, 28), (512, 512))
SLICES = {1: (0, 4), 2: (4, 9), 3: (9, 16), 4: (16, 23), 5: (23, 30)}  # layers of torchvision's `features`
HEAD_CHANNELS = (64, 128, 256, 512, 512)


@pytest.fixture(scope="module")
def weights():
    """Random weights of the right shapes under torchvision's names; half precision, to keep files small."""
    torch = pytest.importorskip("torch")
    generator = torch.Generator().manual_seed(0)
    arrays = {}
    for index, (fan_in, out) in CONVOLUTIONS.items():
        scale = (2 / (9 * fan_in)) ** 0.5
        arrays[f"features.{index}.weight"] = (
            torch.randn(out, fan_in, 3, 3, generator=generator) * scale
        ).half()
        arrays[f"features.{index}.bias"] = (torch.randn(out, generator=generator) * 0.05).half()
    for k, channels in enumerate(HEAD_CHANNELS):
        arrays[f"lin{k}.model.1.weight"] = torch.rand(1, channels, 1, 1, generator=generator).half()
    return arrays


@pytest.fixture(scope="module")
def network(weights, tmp_path_factory):
    path = tmp_path_factory.mktemp("lpips") / "weights.npz"
    np.savez(path, **{key: tensor.numpy() for key, tensor in weights.items()})
    loaded, reason = load_lpips(path)
    path.unlink()
    assert reason == ""
    return loaded


def literal_lpips(weights, a, b, factor=1.0, offset=0.0) -> float:
    """The definition, by torch's modules in float64, of colours times factor plus offset."""
    import torch
    from torch import nn

    def features(image):
        colours = image.astype(np.float64) * factor + offset
        scaled = (colours - (-0.030, -0.088, -0.188)) / (0.458, 0.448, 0.450)
        x = torch.tensor(scaled).permute(2, 0, 1)[None]
        for layer in range(30):
            if layer in CONVOLUTIONS:
                module = nn.Conv2d(*CONVOLUTIONS[layer], 3, padding=1, dtype=torch.float64)
                parts = {part: weights[f"features.{layer}.{part}"].double() for part in ("weight", "bias")}
                module.load_state_dict(parts)
                x = module(x)
            else:
                x = nn.MaxPool2d(2, 2)(x) if layer in (4, 9, 16, 23) else nn.ReLU()(x)
            if layer + 1 in (end for _, end in SLICES.values()):
                yield nn.functional.normalize(x, dim=1, eps=1e-10)

    with torch.no_grad():
        pairs = zip(features(a), features(b), strict=True)
        heads = (weights[f"lin{k}.model.1.weight"].double() for k in range(5))
        total = sum(
            nn.functional.conv2d((p - q) ** 2, head).mean() for (p, q), head in zip(pairs, heads, strict=True)
        )
    return float(total)


def test_lpips_against_its_definition(weights, network):
    a, b = waves(0.0)[:33, :40], waves(0.3)[:33, :40]
    assert network(a, b) == pytest.approx(literal_lpips(weights, a, b), rel=1e-4)
    arrays = {key: tensor.float().numpy() for key, tensor in weights.items()}
    assert Lpips(arrays, "authors")(a, b) == pytest.approx(literal_lpips(weights, a, b, 2, -1), rel=1e-4)


def test_lpips_properties(network):
    a, b = waves(0.0)[:16, :16], waves(0.3)[:16, :16]
    different = network(a, b)
    assert network(a, a) == 0.0
    assert network(b, a) == pytest.approx(different, rel=1e-5)
    assert different > network(a, a + 0.01) > 0


def test_lpips_refuses_images_smaller_than_its_poolings(network):
    with pytest.raises(SceneError, match="16 x 16"):
        network(waves(0.0)[:15, :20], waves(0.0)[:15, :20])


def test_lpips_reads_the_names_of_the_lpips_package(weights, network, tmp_path):
    def package_name(key):
        if key.startswith("lin"):
            return key.replace("lin", "lins.", 1)
        index = int(key.split(".")[1])
        number = next(n for n, (start, end) in SLICES.items() if start <= index < end)
        return key.replace("features", f"net.slice{number}")

    path = tmp_path / "weights.npz"
    named = {package_name(key): tensor.numpy() for key, tensor in weights.items()}
    np.savez(path, **named, **{"scaling_layer.shift": np.zeros(1)})
    other, _ = load_lpips(path)
    path.unlink()
    a, b = waves(0.0)[:16, :16], waves(0.3)[:16, :16]
    assert other(a, b) == network(a, b)


@pytest.mark.parametrize(
    ("path", "reason"), [(None, "no LPIPS weights"), ("nowhere.npz", "nowhere.npz does not exist")]
)
def test_without_lpips_weights_the_reason_is_told(path, reason):
    network, why = load_lpips(path)
    assert network is None and reason in why


@pytest.mark.parametrize("name", ["weights.npz", "weights.pt"])
@pytest.mark.parametrize(
    "content", [b"", b"not weights\n" * 50, b"PK\x03\x04" + bytes(100)], ids=["empty", "text", "torn"]
)
def test_lpips_refuses_other_files(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(FormatError, match=name):
        load_lpips(path)


@pytest.mark.parametrize(
    "arrays",
    [
        {},
        {"features.0.weight": np.zeros((64, 3, 5, 5), np.float32)},
        {"features.0.weight": np.zeros((64, 3, 3, 3), np.int32)},
        {"features.0.weight": np.full((64, 3, 3, 3), np.nan, np.float32)},
        {"features.0.weight": np.array(["text"])},
    ],
    ids=["missing", "shape", "integers", "nan", "text"],
)
def test_lpips_refuses_other_arrays(tmp_path, arrays):
    np.savez(tmp_path / "weights.npz", **arrays)
    with pytest.raises(FormatError):
        load_lpips(tmp_path / "weights.npz")


def test_lpips_never_runs_code_from_a_file(tmp_path):
    class Trap:
        def __reduce__(self):
            return (open, (str(tmp_path / "sprung"), "w"))

    np.savez(tmp_path / "weights.npz", **{"features.0.weight": np.array([Trap()], object)})
    with pytest.raises(FormatError):
        load_lpips(tmp_path / "weights.npz")
    assert not (tmp_path / "sprung").exists()


def test_importing_the_metrics_loads_numpy_only():
    heavy = "{'torch', 'scipy', 'OpenImageIO', 'bpy'}"
    code = (
        f"import sys, svrgs_addon.render.metrics, svrgs_addon.prune.report; sys.exit(bool({heavy} &"
        " set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
