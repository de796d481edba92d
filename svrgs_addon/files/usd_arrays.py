"""A script, run by usd.py in a child process: reads the splats of a USD stage into an .npz. OpenUSD takes
much time and memory for some damaged files, and may end its process.

python usd_arrays.py STAGE OUT.npz

Of splat n: n:positions, n:orientations (x, y, z, w), n:scales, n:opacities, n:sh, n:degree, n:matrix (4, 4),
to the coordinates of the stage; and z_up. Arrays are as the file has them. Nothing else of this package is
imported.
"""

import sys

TYPE = "ParticleField3DGaussianSplat"
SH, DEGREE = "radiance:sphericalHarmonicsCoefficients", "radiance:sphericalHarmonicsDegree"
ARRAYS = {name: name for name in ("positions", "orientations", "scales", "opacities")} | {"sh": SH}
HALF = "h"  # end of the names of the same attributes in half precision


def main(stage_path: str, out: str):
    import numpy as np
    from pxr import Usd, UsdGeom

    stage, time = Usd.Stage.Open(stage_path), Usd.TimeCode.EarliestTime()
    cache, arrays = UsdGeom.XformCache(time), {"z_up": np.array(UsdGeom.GetStageUpAxis(stage) == "Z")}
    for number, prim in enumerate(
        prim for prim in stage.Traverse(Usd.TraverseInstanceProxies()) if prim.GetTypeName() == TYPE
    ):
        for name, attribute in ARRAYS.items():
            values = [
                value
                for one in (attribute, attribute + HALF)
                if (value := prim.GetAttribute(one).Get(time)) is not None
            ]
            arrays[f"{number}:{name}"] = np.array(values[0] if values else [], np.float32)
        degree = prim.GetAttribute(DEGREE).Get() if prim.HasAttribute(DEGREE) else 3
        arrays[f"{number}:degree"] = np.array(degree if isinstance(degree, int) else -1)
        arrays[f"{number}:matrix"] = np.array(cache.GetLocalToWorldTransform(prim), np.float64).T
    np.savez(out, **arrays)


if __name__ == "__main__":
    main(*sys.argv[1:])
