"""Procedural materials: a pattern in object coordinates, through a colour ramp, onto a surface."""

from collections.abc import Sequence

import bpy

Colour = tuple[float, float, float]  # linear Rec. 709


def linear(rgb: Sequence[int]) -> Colour:
    """The linear colour of an sRGB one, 0..255."""
    red, green, blue = (
        value / 255 / 12.92 if value <= 10 else ((value / 255 + 0.055) / 1.055) ** 2.4 for value in rgb
    )
    return red, green, blue


def plain(colour: Colour, roughness: float = 0.8) -> bpy.types.Material:
    """One flat colour."""
    material, shader = _new()
    shader.inputs["Base Color"].default_value = (*colour, 1)
    shader.inputs["Roughness"].default_value = roughness
    return material


def glowing(colour: Colour) -> bpy.types.Material:
    """Sends out exactly `colour` towards the camera and is no lamp."""
    material, shader = _new()
    shader.inputs["Base Color"].default_value = (0, 0, 0, 1)
    shader.inputs["Specular IOR Level"].default_value = 0
    shader.inputs["Emission Color"].default_value = (*colour, 1)
    shader.inputs["Emission Strength"].default_value = 1
    material.cycles.emission_sampling = "NONE"
    return material


def patterned(
    pattern: str,
    colours: list[Colour],
    roughness: float = 0.8,
    metallic: float = 0.0,
    **settings: float | str,
) -> bpy.types.Material:
    """A texture node ("Noise", "Voronoi", "Wave", "Magic", "Checker") through a ramp of colours.

    `settings` are the node's inputs, spaces written as underscores, such as `Scale=4`, or its properties,
    such as `wave_type="RINGS"`.
    """
    material, shader = _new()
    texture = _texture(material, pattern, settings)
    value = next(o for o in texture.outputs if o.identifier in ("Fac", "Distance"))
    _ramp(material, value, colours, shader.inputs["Base Color"])
    shader.inputs["Roughness"].default_value = roughness
    shader.inputs["Metallic"].default_value = metallic
    return material


def cells(scale: float, roughness: float = 0.5) -> bpy.types.Material:
    """Voronoi cells, each of another colour."""
    material, shader = _new()
    texture = _texture(material, "Voronoi", {"Scale": scale})
    _link(material, texture.outputs["Color"], shader.inputs["Base Color"])
    shader.inputs["Roughness"].default_value = roughness
    return material


def bricks(colours: list[Colour], **settings: float) -> bpy.types.Material:
    """Bricks between two colours, with the third as mortar."""
    material, shader = _new()
    texture = _texture(material, "Brick", settings)
    for socket, colour in zip(("Color1", "Color2", "Mortar"), colours, strict=True):
        texture.inputs[socket].default_value = (*colour, 1)
    _link(material, texture.outputs["Color"], shader.inputs["Base Color"])
    shader.inputs["Roughness"].default_value = 0.85
    return material


def weathered(
    material: bpy.types.Material, darkest: float = 0.5, scale: float = 3, roughness: float = 0.7
) -> bpy.types.Material:
    """The same material, its colour multiplied by noise of this scale and roughness, between `darkest` and 1:
    dirt, wear, grain."""
    tree = material.node_tree
    colour = next(n for n in tree.nodes if n.type == "BSDF_PRINCIPLED").inputs["Base Color"]
    noise = _texture(material, "Noise", {"Scale": scale, "Detail": 6, "Roughness": roughness})
    mix = tree.nodes.new("ShaderNodeMixRGB")
    mix.blend_type = "MULTIPLY"
    mix.inputs["Fac"].default_value = 1
    mix.inputs["Color1"].default_value = colour.default_value
    if colour.is_linked:
        _link(material, colour.links[0].from_socket, mix.inputs["Color1"])
    # Noise is seldom below 0.3 or above 0.7.
    _ramp(
        material,
        noise.outputs[0],
        [(f, f, f) for f in (darkest, darkest, (1 + darkest) / 2, 1.0, 1.0)],
        mix.inputs["Color2"],
    )
    _link(material, mix.outputs[0], colour)
    return material


def sky(radius: float) -> bpy.types.Material:
    """A glowing dome, `radius` in its object's units: haze below, blue above, clouds on both."""
    material, shader = _new()
    material.cycles.emission_sampling = "NONE"  # to be looked at, not to be a lamp
    tree = material.node_tree
    tree.nodes.remove(shader)
    glow = tree.nodes.new("ShaderNodeEmission")
    _link(material, glow.outputs[0], _output(material).inputs["Surface"])
    clouds = _texture(material, "Noise", {"Scale": 4 / radius, "Detail": 5, "Distortion": 0.6})
    height = tree.nodes.new("ShaderNodeSeparateXYZ")
    _link(material, _coordinates(material), height.inputs[0])
    level = tree.nodes.new("ShaderNodeMath")
    level.operation = "DIVIDE"
    level.inputs[1].default_value = 0.6 * radius
    _link(material, height.outputs["Z"], level.inputs[0])
    mix = tree.nodes.new("ShaderNodeMixRGB")
    mix.inputs["Color2"].default_value = (0.95, 0.93, 0.92, 1)
    _ramp(
        material,
        level.outputs[0],
        [(0.72, 0.70, 0.66), (0.30, 0.48, 0.80), (0.10, 0.24, 0.62)],
        mix.inputs["Color1"],
    )
    cover = [(c, c, c) for c in (0.0, 0.0, 0.2, 0.9, 0.95)]
    _ramp(material, clouds.outputs[0], cover, mix.inputs["Fac"])
    _link(material, mix.outputs[0], glow.inputs["Color"])
    return material


def _new() -> tuple[bpy.types.Material, bpy.types.Node]:
    material = bpy.data.materials.new("material")
    if material.node_tree is None:  # before Blender 5.0 nodes had to be asked for
        material.use_nodes = True
    shader = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    return material, shader


def _output(material: bpy.types.Material) -> bpy.types.Node:
    return next(n for n in material.node_tree.nodes if n.type == "OUTPUT_MATERIAL")


def _link(material, source, target) -> None:
    material.node_tree.links.new(source, target)


def _coordinates(material) -> bpy.types.NodeSocket:
    return material.node_tree.nodes.new("ShaderNodeTexCoord").outputs["Object"]


def _texture(material, pattern: str, settings: dict[str, float | str]) -> bpy.types.Node:
    node = material.node_tree.nodes.new(f"ShaderNodeTex{pattern}")
    for key, value in settings.items():
        if key.islower():
            setattr(node, key, value)
        else:
            node.inputs[key.replace("_", " ")].default_value = value
    _link(material, _coordinates(material), node.inputs["Vector"])
    return node


def _ramp(material, value, colours: list[Colour], target) -> None:
    """Spread `colours` evenly over 0..1 of `value`."""
    node = material.node_tree.nodes.new("ShaderNodeValToRGB")
    elements = node.color_ramp.elements
    while len(elements) < len(colours):
        elements.new(0.5)
    for index, colour in enumerate(colours):
        elements[index].position = index / (len(colours) - 1)
        elements[index].color = (*colour, 1)
    _link(material, value, node.inputs[0])
    _link(material, node.outputs["Color"], target)
