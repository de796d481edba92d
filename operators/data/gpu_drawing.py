"""Drawing with the graphics card: one quad per Gaussian, blended in display sRGB as in training; and textures
over the viewport."""

from __future__ import annotations

import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from ...svrgs_addon.native.library import thresholds

WIDTH = 4096  # texels in a row of a texture that stores a list
# push constants of the quads beside the matrix modelview, as vectors of 4: smaller ones would be padded
CONSTANTS = {
    "lens": "focal lengths and centre, in pixels",
    "view": "width and height in pixels, nearest distance, factor on covariances",
    "mode": (
        "1 for parallel rays, 1 for an antialiased scene, scale and shift from -z to the depth buffer times w"
    ),
}

# Ellipse and alpha of a Gaussian are computed as in native/src/kernels/. Names in capitals: thresholds of the
# native library.
VERTEX = """
ivec2 place(int k) { return ivec2(k % WIDTH, k / WIDTH); }

void main() {
  int id = int(texelFetch(order, place(gl_InstanceID), 0).r + 0.5);
  vec4 a = texelFetch(geometry, place(3 * id), 0);
  vec3 b = texelFetch(geometry, place(3 * id + 1), 0).xyz, c = texelFetch(geometry, place(3 * id + 2), 0).xyz;
  color = texelFetch(colors, place(id), 0).rgb;
  vec2 size = view.xy;
  float near = view.z, enlarge = view.w;
  bool parallel = mode.x > 0.5, antialiased = mode.y > 0.5;
  vec3 t = (modelview * vec4(a.xyz, 1.0)).xyz;
  float z = -t.z;
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);  // outside the viewport: not drawn
  corner = vec2(0.0);
  opacity = 0.0;
  if (z < near || a.w < ALPHA_CUT) return;
  vec2 focal = lens.xy, centre = lens.zw;
  float w = parallel ? 1.0 : z;
  vec2 ray = vec2(t.x, -t.y) / w;
  vec2 limit = parallel ? vec2(0.0) : 0.5 * FRUSTUM_MARGIN * size / focal
    + max(centre, size - centre) / focal;
  vec2 near_ray = clamp(ray, -limit, limit);
  mat3 W = mat3(modelview);
  mat3 S = mat3(b, vec3(b.y, c.x, c.y), vec3(b.z, c.y, c.z));
  S = W * (S * enlarge) * transpose(W);
  vec3 jx = vec3(focal.x, 0.0, focal.x * near_ray.x) / w, jy = vec3(0.0, -focal.y, focal.y * near_ray.y) / w;
  float xx = dot(jx, S * jx), xy = dot(jx, S * jy), yy = dot(jy, S * jy);
  float sharp = max(xx * yy - xy * xy, 0.0);
  xx += BLUR;
  yy += BLUR;
  opacity = a.w * (antialiased ? sqrt(max(sharp / (xx * yy - xy * xy), COMPENSATION_FLOOR)) : 1.0);
  if (opacity < ALPHA_CUT) return;
  float middle = 0.5 * (xx + yy), spread = sqrt(max(0.25 * (xx - yy) * (xx - yy) + xy * xy, 1e-12));
  vec2 axis = abs(xy) < 1e-6 ? (xx >= yy ? vec2(1.0, 0.0) : vec2(0.0, 1.0))
    : normalize(vec2(xy, middle + spread - xx));
  float reach = sqrt(2.0 * log(opacity / ALPHA_CUT));
  corner = reach * pos;
  vec2 offset = corner.x * sqrt(middle + spread) * axis
    + corner.y * sqrt(max(middle - spread, 0.0)) * vec2(-axis.y, axis.x);
  vec2 pixel = centre + focal * ray + offset;
  gl_Position = vec4(2.0 * pixel.x / size.x - 1.0, 1.0 - 2.0 * pixel.y / size.y,
    (mode.z * t.z + mode.w) / w, 1.0);
}
"""

FRAGMENT = """
void main() {
  float alpha = min(ALPHA_MAX, opacity * exp(-0.5 * dot(corner, corner)));
  if (alpha < ALPHA_CUT || gl_FragCoord.z > texelFetch(hidden, ivec2(gl_FragCoord.xy), 0).r) discard;
  blended = vec4(color * alpha, alpha);
}
"""

PICTURE_VERTEX = "void main() { uv = 0.5 * pos + 0.5; gl_Position = vec4(pos, 0.0, 1.0); }"

# From display sRGB times alpha to linear times alpha: Blender encodes the viewport for the display
# afterwards.
PICTURE_FRAGMENT = """
void main() {
  vec4 c = texture(image, uv);
  vec3 s = c.rgb / max(c.a, 1e-5);
  vec3 curve = pow((max(s, 0.0) + 0.055) / 1.055, vec3(2.4));
  result = vec4(mix(s / 12.92, curve, vec3(greaterThan(s, vec3(0.04045)))) * c.a, c.a);
}
"""


def defines() -> dict[str, float]:
    """The thresholds of the native library, by their names in the shaders."""
    found = thresholds()
    return {
        name.upper(): getattr(found, name)
        for name in ("alpha_cut", "alpha_max", "blur", "frustum_margin", "compensation_floor")
    }


class Shaders:
    """The shaders; to be compiled in a drawing context."""

    def __init__(self):
        self.quads = self._quads()
        self.picture = self._picture()
        self.corners = batch_for_shader(self.quads, "TRIS", {"pos": _corners(0.0, 1.0)})

    def _quads(self) -> gpu.types.GPUShader:
        info, passed = gpu.types.GPUShaderCreateInfo(), gpu.types.GPUStageInterfaceInfo("svrgs_quad")
        passed.smooth("VEC2", "corner")
        passed.flat("VEC3", "color")
        passed.flat("FLOAT", "opacity")
        # 112 bytes of push constants in all; every graphics card has 128
        info.push_constant("MAT4", "modelview")
        for name in CONSTANTS:
            info.push_constant("VEC4", name)
        for slot, name in enumerate(("order", "geometry", "colors", "hidden")):
            info.sampler(slot, "FLOAT_2D", name)
        for name, value in {"WIDTH": WIDTH, **defines()}.items():
            info.define(name, str(value))
        info.vertex_in(0, "VEC2", "pos")
        info.vertex_out(passed)
        info.fragment_out(0, "VEC4", "blended")
        info.vertex_source(VERTEX)
        info.fragment_source(FRAGMENT)
        return gpu.shader.create_from_info(info)

    def _picture(self) -> gpu.types.GPUShader:
        info, passed = gpu.types.GPUShaderCreateInfo(), gpu.types.GPUStageInterfaceInfo("svrgs_picture")
        passed.smooth("VEC2", "uv")
        info.sampler(0, "FLOAT_2D", "image")
        info.vertex_in(0, "VEC2", "pos")
        info.vertex_out(passed)
        info.fragment_out(0, "VEC4", "result")
        info.vertex_source(PICTURE_VERTEX)
        info.fragment_source(PICTURE_FRAGMENT)
        return gpu.shader.create_from_info(info)


class Target:
    """The texture that quads are drawn into. (Creating a GPUOffScreen instead would unbind the viewport that
    is being drawn.)"""

    def __init__(self, width: int, height: int):
        self.width, self.height = width, height
        self.texture = gpu.types.GPUTexture((width, height), format="RGBA16F")
        self.frame = gpu.types.GPUFrameBuffer(color_slots=(self.texture,))


def texture(rows: np.ndarray, form: str) -> gpu.types.GPUTexture:
    """A list (n, ...) of numbers as a texture of 1 or 4 channels, WIDTH texels in a row, padded with 0."""
    rows = rows.reshape(len(rows), -1)
    count, channels = len(rows), 1 if form == "R32F" else 4
    height = max(1, -(-count // WIDTH))
    padded = np.zeros((height * WIDTH, channels), np.float32)
    padded[:count, : rows.shape[1]] = rows
    return gpu.types.GPUTexture(
        (WIDTH, height), format=form, data=gpu.types.Buffer("FLOAT", padded.size, padded.reshape(-1))
    )


def scene_depth(width: int, height: int) -> np.ndarray | None:
    """The viewport's depth buffer (H, W), in [0, 1], rows from the top. None if Blender draws in another
    size, as for a render of the viewport."""
    frame = gpu.state.active_framebuffer_get()
    if tuple(frame.viewport_get()) != (0, 0, width, height):
        return None
    values = frame.read_depth(0, 0, width, height)
    values.dimensions = width * height
    return np.array(values, np.float32).reshape(height, width)[::-1]


def depth_texture(depth: np.ndarray, reduction: int) -> gpu.types.GPUTexture:
    """A depth buffer (H, W), rows from the top, as a texture whose pixels are the largest depths of blocks of
    reduction x reduction pixels.

    So a line of one pixel, as those of the grid, hides nothing in a reduced picture. With one pixel of the
    block it would show as dots.
    """
    rows, columns = (min(reduction, side) for side in depth.shape)
    height, width = depth.shape[0] // rows, depth.shape[1] // columns
    blocks = depth[::-1][: height * rows, : width * columns].reshape(height, rows, width, columns)
    values = np.ascontiguousarray(blocks.max(axis=(1, 3)), np.float32).reshape(-1)
    return gpu.types.GPUTexture(
        (width, height), format="R32F", data=gpu.types.Buffer("FLOAT", values.size, values)
    )


def picture_texture(rgba: np.ndarray) -> gpu.types.GPUTexture:
    """(H, W, 4) float32, rows from the top."""
    height, width, _ = rgba.shape
    pixels = np.ascontiguousarray(rgba[::-1]).reshape(-1)
    return gpu.types.GPUTexture(
        (width, height), format="RGBA16F", data=gpu.types.Buffer("FLOAT", pixels.size, pixels)
    )


def draw_quads(
    shaders: Shaders, target: Target, lists: dict, hidden: gpu.types.GPUTexture, constants: dict, count: int
):
    """Blends `count` quads into the target. lists: textures order, geometry, colors; constants: modelview and
    CONSTANTS by name."""
    with target.frame.bind():
        target.frame.clear(color=(0.0, 0.0, 0.0, 0.0))
        gpu.state.blend_set("ALPHA_PREMULT")
        gpu.state.depth_test_set("NONE")
        gpu.state.depth_mask_set(False)
        shader = shaders.quads
        shader.bind()
        for name, value in constants.items():
            shader.uniform_float(name, value)
        for name, item in {**lists, "hidden": hidden}.items():
            shader.uniform_sampler(name, item)
        shaders.corners.draw_instanced(shader, instance_count=count)
        gpu.state.blend_set("NONE")


def draw_over_viewport(
    shaders: Shaders, image: gpu.types.GPUTexture, columns: tuple[float, float] = (0.0, 1.0)
):
    """Draws a texture of display sRGB times alpha over the viewport. columns: only from this to this share of
    its width."""
    gpu.state.blend_set("ALPHA_PREMULT")
    gpu.state.depth_test_set("NONE")
    shaders.picture.bind()
    shaders.picture.uniform_sampler("image", image)
    batch_for_shader(shaders.picture, "TRIS", {"pos": _corners(*columns)}).draw(shaders.picture)
    gpu.state.blend_set("NONE")


def draw_linear(
    image: gpu.types.GPUTexture, width: int, height: int, columns: tuple[float, float] = (0.0, 1.0)
):
    """Draws a texture of linear colours times alpha over a region of a render engine. columns: as in
    draw_over_viewport."""
    shader, share = gpu.shader.from_builtin("IMAGE"), 0.5 * np.array(_corners(*columns), np.float32) + 0.5
    gpu.state.blend_set("ALPHA_PREMULT")
    shader.bind()
    shader.uniform_sampler("image", image)
    batch_for_shader(
        shader, "TRIS", {"pos": (share * (width, height)).astype(np.float32), "texCoord": share}
    ).draw(shader)
    gpu.state.blend_set("NONE")


def _corners(first: float, last: float) -> tuple[tuple[float, float], ...]:
    """Two triangles that cover the columns from one share of the width to another; x and y from -1 to 1."""
    left, right = 2 * first - 1, 2 * last - 1
    return ((left, -1), (right, -1), (right, 1), (left, -1), (right, 1), (left, 1))
