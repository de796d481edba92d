"""glTF whose splat is packed as an SPZ: the extension KHR_gaussian_splatting_compression_spz_2, a draft of
Khronos. Written as .spz.glb, only where that is asked for; read by glb.py.

The extension stands in KHR_gaussian_splatting and names the buffer view with the bytes of an SPZ of version
2. The accessors of the attributes have no values. The axes of the SPZ are right, up, back and those of glTF
left, up, forward, so whoever unpacks it turns it around.
"""

from __future__ import annotations

import os

from ..scene.gaussians import Scene
from . import glb, spz, zstd
from .atomic import check_space, write_bytes
from .axes import turned_around, turned_over
from .glb_container import glb_of
from .sh_rounding import SeenFrom
from .splat_format import SplatFormat

VERSION = 2  # of the SPZ


def write(path: str | os.PathLike, scene: Scene, quantise: float = 1.0, seen: SeenFrom | None = None):
    """Writes the scene atomically, in Morton order. quantise, seen: as of an SPZ. Raises SceneError."""
    data = spz.content(path, scene, VERSION, quantise, lambda part: turned_around(turned_over(part)), seen)
    contents = glb.contents(scene)
    for accessor in contents["accessors"]:
        del accessor["bufferView"]
    contents["meshes"][0]["primitives"][0]["extensions"][glb.EXTENSION]["extensions"] = {
        glb.PACKED[0]: {"bufferView": 0}
    }
    contents["extensionsUsed"] = contents["extensionsRequired"] = [glb.EXTENSION, glb.PACKED[0]]
    head = glb_of(contents, [len(data)], arrays=False)
    check_space(path, len(head) + len(data))
    write_bytes(path, head + data + bytes(-len(data) % 4))


FORMAT = SplatFormat(
    name="glb-spz",
    label="glTF, SPZ inside (draft)",
    suffixes=(".spz.glb",),
    sniff=glb.FORMAT.sniff,
    read_parts=glb.read_parts,
    write=write,
    quantises=True,
    limits=spz.limits,
    carries=("antialiased",),
    needs=zstd.lack,
)
