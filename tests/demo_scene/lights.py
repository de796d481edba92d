"""The light of a scene: a sun, and a sky that is not seen itself."""

import math

import bpy


def sun(
    scene: bpy.types.Scene,
    energy: float,
    angle: float,
    colour: tuple[float, float, float],
    turn: tuple[float, float, float],
) -> None:
    """A sun of `angle` degrees; `turn`, in degrees, leads from straight down to its direction."""
    light = bpy.data.lights.new("sun", "SUN")
    light.energy, light.angle, light.color = energy, math.radians(angle), colour
    lamp = bpy.data.objects.new("sun", light)
    lamp.rotation_euler = [math.radians(value) for value in turn]
    scene.collection.objects.link(lamp)


def sky(scene: bpy.types.Scene, colour: tuple[float, float, float], strength: float) -> None:
    """Even light from everywhere."""
    scene.world = bpy.data.worlds.new("world")
    if scene.world.node_tree is None:
        scene.world.use_nodes = True
    background = next(n for n in scene.world.node_tree.nodes if n.type == "BACKGROUND")
    background.inputs["Color"].default_value = (*colour, 1)
    background.inputs["Strength"].default_value = strength
