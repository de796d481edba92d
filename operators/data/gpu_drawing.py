"""Pictures as textures of the graphics card, drawn over viewports; and the depth buffer of a viewport."""

from __future__ import annotations

import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

VERTEX = "void main() { uv = 0.5 * vec2(pos.x, -pos.y) + 0.5; gl_Position = vec4(pos, 0.0, 1.0); }"

# From display sRGB times alpha to linear times alpha: Blender encodes the viewport for the display
# afterwards.
FRAGMENT = """
void main() {
  vec4 c = texture(image, uv);
  vec3 s = c.rgb / max(c.a, 1e-5);
  vec3 curve = pow((max(s, 0.0) + 0.055) / 1.055, vec3(2.4));
  result = vec4(mix(s / 12.92, curve, vec3(greaterThan(s, vec3(0.04045)))) * c.a, c.a);
}
"""

# Takes away what Gaussians hide. depth: z of the picture; lines: the viewport's depth buffer; lens: of the
# projection, rows and columns 2 and 3; depths: length of a unit of z, and what z has more than the distance
# from the eye.
HIDING_FRAGMENT = """
void main() {
  float z = texelFetch(depth, ivec2(uv * vec2(textureSize(depth, 0))), 0).r * depths.x - depths.y;
  float buffered = 0.5 * (lens.y - lens.x * z) / (lens.w - lens.z * z) + 0.5;
  float line = texelFetch(lines, ivec2(uv * vec2(textureSize(lines, 0))), 0).r;
  if (buffered >= line - NEAR) discard;
  result = vec4(0.0);
}
"""
NEAR = 1e-5  # of the depth buffer: as near as a mesh that the picture and Blender both draw


def picture_shader() -> gpu.types.GPUShader:
    """The shader of draw_over_viewport(); to be compiled in a drawing context."""
    return gpu.shader.create_from_info(_shader_info("svrgs_picture", FRAGMENT, ("image",)))


def hiding_shader() -> gpu.types.GPUShader:
    """The shader of draw_hiding(); to be compiled in a drawing context."""
    info = _shader_info("svrgs_hiding", HIDING_FRAGMENT, ("depth", "lines"))
    info.push_constant("VEC4", "lens")
    info.push_constant("VEC2", "depths")
    info.define("NEAR", str(NEAR))
    return gpu.shader.create_from_info(info)


def _shader_info(name: str, fragment: str, textures: tuple[str, ...]) -> gpu.types.GPUShaderCreateInfo:
    info, passed = gpu.types.GPUShaderCreateInfo(), gpu.types.GPUStageInterfaceInfo(name)
    passed.smooth("VEC2", "uv")
    for slot, texture in enumerate(textures):
        info.sampler(slot, "FLOAT_2D", texture)
    info.vertex_in(0, "VEC2", "pos")
    info.vertex_out(passed)
    info.fragment_out(0, "VEC4", "result")
    info.vertex_source(VERTEX)
    info.fragment_source(fragment)
    return info


def scene_depth(width: int, height: int) -> np.ndarray | None:
    """The viewport's depth buffer (H, W), in [0, 1], rows from the top. None if Blender draws in another
    size, as for a render of the viewport."""
    frame = gpu.state.active_framebuffer_get()
    if tuple(frame.viewport_get()) != (0, 0, width, height):
        return None
    values = frame.read_depth(0, 0, width, height)
    values.dimensions = width * height
    return np.array(values, np.float32).reshape(height, width)[::-1]


def farthest(depth: np.ndarray, reduction: int) -> np.ndarray | None:
    """The largest depths of blocks of reduction x reduction pixels of a depth buffer (H, W); None if it is
    empty.

    So a line of one pixel, as those of the grid, hides nothing in a reduced picture. With one pixel of the
    block it would show as dots.
    """
    height, width = (max(1, side // reduction) for side in depth.shape)
    rows, columns = depth.shape[0] // height, depth.shape[1] // width
    blocks = depth[: height * rows, : width * columns].reshape(height, rows, width, columns)
    found = blocks.max(axis=(1, 3))
    return found if found.min() < 1 else None


def picture_texture(picture: np.ndarray) -> gpu.types.GPUTexture:
    """(H, W, 4) colours, or (H, W) depths; float32, rows from the top."""
    pixels, stored = np.ascontiguousarray(picture).reshape(-1), "RGBA16F" if picture.ndim == 3 else "R32F"
    data = gpu.types.Buffer("FLOAT", pixels.size, pixels)
    return gpu.types.GPUTexture(picture.shape[1::-1], format=stored, data=data)


def draw_over_viewport(
    shader: gpu.types.GPUShader, image: gpu.types.GPUTexture, columns: tuple[float, float] = (0.0, 1.0)
):
    """Draws a texture of display sRGB times alpha over the viewport.

    shader: picture_shader(). columns: only from this to this share of its width.
    """
    gpu.state.blend_set("ALPHA_PREMULT")
    gpu.state.depth_test_set("NONE")
    shader.bind()
    shader.uniform_sampler("image", image)
    batch_for_shader(shader, "TRIS", {"pos": _corners(*columns)}).draw(shader)
    gpu.state.blend_set("NONE")


def draw_hiding(
    shader: gpu.types.GPUShader, textures: dict, constants: dict, columns: tuple[float, float] = (0.0, 1.0)
):
    """Takes away from Blender's overlays what Gaussians hide.

    shader: hiding_shader(). textures, constants: by name, see HIDING_FRAGMENT. columns: as in
    draw_over_viewport.
    """
    gpu.state.blend_set("NONE")
    gpu.state.depth_test_set("NONE")
    shader.bind()
    for name, texture in textures.items():
        shader.uniform_sampler(name, texture)
    for name, value in constants.items():
        shader.uniform_float(name, value)
    batch_for_shader(shader, "TRIS", {"pos": _corners(*columns)}).draw(shader)


def draw_linear(
    image: gpu.types.GPUTexture, width: int, height: int, columns: tuple[float, float] = (0.0, 1.0)
):
    """Draws a texture of linear colours times alpha over a region of a render engine. columns: as in
    draw_over_viewport."""
    shader, share = gpu.shader.from_builtin("IMAGE"), 0.5 * np.array(_corners(*columns)) + 0.5
    corners = {"pos": share * (width, height), "texCoord": share * (1, -1) + (0, 1)}
    gpu.state.blend_set("ALPHA_PREMULT")
    shader.bind()
    shader.uniform_sampler("image", image)
    places = {name: values.astype(np.float32) for name, values in corners.items()}
    batch_for_shader(shader, "TRIS", places).draw(shader)
    gpu.state.blend_set("NONE")


def _corners(first: float, last: float) -> tuple[tuple[float, float], ...]:
    """Two triangles that cover the columns from one share of the width to another; x and y from -1 to 1."""
    left, right = 2 * first - 1, 2 * last - 1
    return ((left, -1), (right, -1), (right, 1), (left, -1), (right, 1), (left, 1))
