"""USD: the schema of OpenUSD is kept, stages of other programs are read where they place their splats,
damaged ones end no process of ours."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from svrgs_addon.files import usd, usd_arrays
from svrgs_addon.files.registry import read_scene, write_scene
from svrgs_addon.scene.affine import transformed
from svrgs_addon.system import locks
from svrgs_addon.system.errors import FormatError, SceneError
from test_formats import differences, like_trained, rotations

pxr = pytest.importorskip("pxr", reason="usd-core is not installed")
from pxr import Gf, Sdf, Usd, UsdGeom, UsdVol, Vt  # noqa: E402


def stage_of(scene, up: str = "Y", half: bool = False, path: str = "/World/Splat") -> Usd.Stage:
    """What another program may write: the values as they are in the arrays, without a change of axes."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.Xform.Define(stage, "/World").AddTransformOp().Set(Gf.Matrix4d(np.array(MATRIX).T.tolist()))
    add(stage, scene, path, half)
    return stage


def add(stage: Usd.Stage, scene, path: str, half: bool = False):
    prim = UsdVol.ParticleField3DGaussianSplat.Define(stage, path)
    alphas = (1 / (1 + np.exp(-scene.opacity_logits))).astype(np.float32)
    if half:
        prim.CreatePositionshAttr(Vt.Vec3hArray.FromNumpy(scene.means.astype(np.float16)))
    else:
        prim.CreatePositionsAttr(Vt.Vec3fArray.FromNumpy(scene.means))
    # w, x, y, z
    prim.CreateOrientationsAttr(Vt.QuatfArray([Gf.Quatf(*map(float, quat)) for quat in scene.quats]))
    prim.CreateScalesAttr(Vt.Vec3fArray.FromNumpy(np.exp(scene.log_scales)))
    prim.CreateOpacitiesAttr(Vt.FloatArray.FromNumpy(alphas))
    prim.CreateRadianceSphericalHarmonicsDegreeAttr(scene.sh_degree)
    prim.CreateRadianceSphericalHarmonicsCoefficientsAttr(Vt.Vec3fArray.FromNumpy(scene.sh.reshape(-1, 3)))


MATRIX = [[0, 0, 2, 1], [0, 2, 0, 2], [-2, 0, 0, 3], [0, 0, 0, 1]]
TURN = np.diag([1.0, -1, -1, 1])  # from right, up, back to the axes of 3DGS


@pytest.mark.parametrize("suffix", (".usd", ".usdc", ".usda"))
def test_the_prim_has_the_attributes_of_the_schema_and_no_others(tmp_path, suffix):
    write_scene(tmp_path / f"a{suffix}", like_trained(2, 20))
    stage = Usd.Stage.Open(str(tmp_path / f"a{suffix}"))
    prim = stage.GetDefaultPrim()
    assert prim.IsA(UsdVol.ParticleField3DGaussianSplat) and prim.GetTypeName() == usd_arrays.TYPE
    schema = Usd.SchemaRegistry().FindConcretePrimDefinition(usd_arrays.TYPE)
    for attribute in prim.GetAuthoredAttributes():
        assert schema.GetSchemaAttributeSpec(attribute.GetName()).typeName == attribute.GetTypeName(), (
            attribute.GetName()
        )
    splat = UsdVol.ParticleField3DGaussianSplat(prim)
    count = len(splat.GetPositionsAttr().Get())
    assert count == 20 and len(splat.GetRadianceSphericalHarmonicsCoefficientsAttr().Get()) == 9 * count
    lows, highs = np.array(splat.GetExtentAttr().Get())
    assert (np.array(splat.GetPositionsAttr().Get()) > lows).all()
    assert (np.array(splat.GetPositionsAttr().Get()) < highs).all()
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and stage.HasDefaultPrim()


@pytest.mark.parametrize("up", ("Y", "Z"))
def test_a_stage_is_read_with_its_transforms_and_its_up_axis(tmp_path, up):
    scene = like_trained(1, 50)
    stage_of(scene, up).Export(str(tmp_path / "a.usdc"))
    upright = (
        np.eye(4) if up == "Y" else np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
    )
    expected = transformed(scene, TURN @ upright @ np.array(MATRIX, np.float64))
    scene = read_scene(tmp_path / "a.usdc")
    found = differences(scene, expected)
    assert found.pop("turn") < 2.1  # the axes of a Gaussian may have other signs
    assert max(found.values()) < 1e-5 and np.abs(covariances(scene) - covariances(expected)).max() < 1e-4, (
        found
    )


def covariances(scene) -> np.ndarray:
    axes = rotations(scene.quats) * np.exp(scene.log_scales)[:, None]
    return axes @ axes.transpose(0, 2, 1)


def test_several_splats_of_a_stage_are_joined_and_half_precision_is_read(tmp_path):
    stage = stage_of(like_trained(0, 30), half=True)
    add(stage, like_trained(1, 20), "/Other")
    stage.DefinePrim("/Mesh", "Mesh")
    stage.Export(str(tmp_path / "a.usda"))
    scene = read_scene(tmp_path / "a.usda")
    assert scene.count == 50 and scene.sh_degree == 1


def test_instances_of_a_splat_are_read_where_they_are(tmp_path):
    scene, stage = like_trained(1, 20), Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, "Y")
    stage.CreateClassPrim("/Prototype")
    add(stage, scene, "/Prototype/Splat")
    for number in range(3):
        instance = UsdGeom.Xform.Define(stage, f"/Instance{number}")
        instance.AddTranslateOp().Set((10 * number, 0, 0))
        instance.GetPrim().GetReferences().AddInternalReference("/Prototype")
        instance.GetPrim().SetInstanceable(True)
    stage.Export(str(tmp_path / "a.usdc"))
    found = read_scene(tmp_path / "a.usdc")
    first = transformed(scene, TURN)
    assert found.count == 60
    for number in range(3):
        assert np.allclose(found.means[20 * number :][:20], first.means + [10 * number, 0, 0], atol=1e-5)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("scales", Vt.Vec3fArray(3), "scales are missing"),
        ("radiance:sphericalHarmonicsDegree", 7, "degree 7"),
        ("radiance:sphericalHarmonicsDegree", 2, "sh are missing"),
        ("opacities", Vt.FloatArray(0), "opacities are missing"),
    ],
)
def test_arrays_that_do_not_fit_are_named(tmp_path, name, value, said):
    stage = stage_of(like_trained(1, 10))
    stage.GetPrimAtPath("/World/Splat").GetAttribute(name).Set(value)
    stage.Export(str(tmp_path / "a.usdc"))
    with pytest.raises(FormatError, match=said):
        read_scene(tmp_path / "a.usdc")


def test_a_stage_without_splats_and_one_that_is_none_are_told(tmp_path):
    stage = Usd.Stage.CreateInMemory()
    stage.DefinePrim("/Mesh", "Mesh")
    stage.Export(str(tmp_path / "a.usda"))
    (tmp_path / "b.usdc").write_bytes(b"PXR-USDC" + bytes(200))
    for name, said in (("a.usda", "no prim of the type"), ("b.usdc", "is damaged")):
        with pytest.raises(FormatError, match=said) as caught:
            read_scene(tmp_path / name)
        assert name in str(caught.value)


def test_a_reader_that_ends_or_takes_too_long_is_one_sentence(tmp_path, monkeypatch):
    write_scene(tmp_path / "a.usdc", like_trained(0, 5))
    for name, text in (("ends", "import os; os.abort()"), ("hangs", "import time; time.sleep(60)")):
        script = tmp_path / f"{name}.py"
        script.write_text(text)
        with monkeypatch.context() as changed:
            changed.setattr(usd.usd_arrays, "__file__", str(script))
            changed.setattr(usd, "LONGER", 0.1)
            with pytest.raises(FormatError, match="OpenUSD cannot read it"):
                read_scene(tmp_path / "a.usdc")


def test_without_openusd_the_package_is_named(tmp_path, monkeypatch):
    write_scene(tmp_path / "a.usdc", like_trained(0, 5))
    monkeypatch.setattr(usd.packages, "is_installed", lambda _: False)
    monkeypatch.setattr(usd.packages.importlib, "import_module", missing)
    with pytest.raises(SceneError, match="usd-core"):
        read_scene(tmp_path / "a.usdc")


def missing(name: str):
    raise ModuleNotFoundError(name, name="pxr")


def test_a_flat_stage_keeps_what_3dgs_has(tmp_path):
    scene = dataclasses.replace(like_trained(3, 40), comments=("made by hand",))
    write_scene(tmp_path / "a.usdc", scene)
    found = differences(read_scene(tmp_path / "a.usdc"), scene)
    assert max(found.values()) < 1e-6, found
    assert Sdf.Layer.FindOrOpen(str(tmp_path / "a.usdc")).GetPrimAtPath("/Splat")


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are text there")
def test_a_folder_whose_name_is_not_utf_8_and_a_full_disk_are_one_sentence(tmp_path):
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff"))
    folder.mkdir()
    with pytest.raises(SceneError, match="names are UTF-8"):
        write_scene(folder / "a.usdc", like_trained(1, 9))
    assert not list(folder.iterdir())
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000));"
        "from svrgs_addon.cli.main import main; sys.exit(main(sys.argv[1:]))"
    )
    write_scene(tmp_path / "a.ply", like_trained(1, 900))
    words = ["convert", tmp_path / "a.ply", tmp_path / "a.usdc"]
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True)
    assert done.returncode and "Traceback" not in done.stderr and "a.usdc" in done.stdout + done.stderr
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == ["a.ply"]


def test_openusd_replaces_no_file_that_is_open(tmp_path, monkeypatch):
    """Windows would refuse it."""
    opened, exported = [], []
    create, export = locks.create_owned, usd._export
    monkeypatch.setattr(locks, "create_owned", lambda path: opened.append(path) or create(path))
    monkeypatch.setattr(usd, "_export", lambda *words: exported.append(words[1]) or export(*words))
    write_scene(tmp_path / "a.usdc", like_trained(0, 20))
    assert len(exported) == 1 and opened and not set(exported) & set(opened)
    assert [path.name for path in tmp_path.iterdir()] == ["a.usdc"]
