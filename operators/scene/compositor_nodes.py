"""The compositor's nodes that put a picture of splats around a render: Gaussians in front, over the render,
over Gaussians behind.

They stand behind the Image of the render's own Render Layers node: what used that image before uses the
result. Colours are blended in display sRGB, as Gaussians are in training. Blender 5.0 has another place for a
scene's nodes, and other names of sockets.
"""

from __future__ import annotations

import bpy

# names of the two nodes; also of the second one's group
SPLATS, AROUND = "SVR-GS Splats", "SVR-GS Around Render"
RENDER, BEHIND, FRONT = "Render", "Behind", "In Front"  # inputs of the group
HAS_GROUPS = bpy.app.version >= (5, 0, 0)  # the nodes of a scene are a node group; else a tree of its own
DISPLAY = "sRGB"  # colour space in which colours are blended


def insert(scene: bpy.types.Scene, layer: bpy.types.Scene):
    """Adds the nodes to the scene, or sets them right. layer: the scene whose render has the splats."""
    scene.render.use_compositing = True
    tree = _tree(scene) or _new_tree(scene)
    render = _render_node(tree, scene)
    users = [link.to_socket for link in render.outputs["Image"].links if link.to_node.name != AROUND]
    splats = _node(tree, SPLATS, "CompositorNodeRLayers")
    around = _node(tree, AROUND, "CompositorNodeGroup")
    splats.scene, splats.layer, around.node_tree = layer, layer.view_layers[0].name, _group()
    tree.links.new(render.outputs["Image"], around.inputs[RENDER])
    tree.links.new(splats.outputs["Behind"], around.inputs[BEHIND])
    tree.links.new(splats.outputs["Image"], around.inputs[FRONT])
    for user in users:
        tree.links.new(around.outputs[0], user)
    if not around.outputs[0].links:
        tree.links.new(around.outputs[0], _output(tree).inputs[0])
    x, y = render.location
    splats.location, around.location = (x, y - 450), (x + 320, y - 150)
    for user in users:
        user.node.location.x = max(user.node.location.x, x + 560)


def remove(scene: bpy.types.Scene):
    """Removes the nodes again: what used the result uses the render's image."""
    tree = _tree(scene)
    if tree is None:
        return
    around = tree.nodes.get(AROUND)
    if around is not None and around.inputs[RENDER].is_linked:
        image = around.inputs[RENDER].links[0].from_socket
        for user in [link.to_socket for link in around.outputs[0].links]:
            tree.links.new(image, user)
    for name in (SPLATS, AROUND):
        if name in tree.nodes:
            tree.nodes.remove(tree.nodes[name])


def are_complete(scene: bpy.types.Scene, layer: bpy.types.Scene) -> bool:
    """Whether a render of the scene puts the splats of the layer around it."""
    tree = _tree(scene)
    if tree is None or not scene.render.use_compositing:
        return False
    splats, around = tree.nodes.get(SPLATS), tree.nodes.get(AROUND)
    if splats is None or splats.mute or splats.scene != layer:
        return False
    if around is None or around.mute or around.node_tree is None or not around.outputs[0].links:
        return False
    inputs = [around.inputs.get(name) for name in (RENDER, BEHIND, FRONT)]
    if not all(socket is not None and socket.is_linked for socket in inputs):
        return False
    return all(socket.links[0].from_node == splats for socket in inputs[1:])


def _tree(scene: bpy.types.Scene) -> bpy.types.NodeTree | None:
    if HAS_GROUPS:
        return scene.compositing_node_group
    return scene.node_tree if scene.use_nodes else None


def _new_tree(scene: bpy.types.Scene) -> bpy.types.NodeTree:
    if not HAS_GROUPS:
        scene.use_nodes = True  # Blender makes a tree with a Render Layers and a Composite node
        return scene.node_tree
    scene.compositing_node_group = bpy.data.node_groups.new(f"{scene.name} Compositing", "CompositorNodeTree")
    return scene.compositing_node_group


def _render_node(tree: bpy.types.NodeTree, scene: bpy.types.Scene) -> bpy.types.Node:
    """The Render Layers node of the scene itself, best one whose image is used; a new one if there is
    none."""
    layers = (node for node in tree.nodes if node.type == "R_LAYERS" and node.name != SPLATS)
    if own := [node for node in layers if node.scene in (scene, None)]:
        return max(own, key=lambda node: bool(node.outputs["Image"].links))
    node = tree.nodes.new("CompositorNodeRLayers")
    node.scene = scene
    return node


def _output(tree: bpy.types.NodeTree) -> bpy.types.Node:
    """The node whose first input is the result."""
    if HAS_GROUPS:
        sockets = (item for item in tree.interface.items_tree if item.item_type == "SOCKET")
        if not any(socket.in_out == "OUTPUT" for socket in sockets):
            tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    kind = "NodeGroupOutput" if HAS_GROUPS else "CompositorNodeComposite"
    node = next((node for node in tree.nodes if node.bl_idname == kind), None)
    if node is None:
        node = tree.nodes.new(kind)
        node.location = (600, 0)
    return node


def _node(tree: bpy.types.NodeTree, name: str, kind: str) -> bpy.types.Node:
    node = tree.nodes.get(name)
    if node is None:
        node = tree.nodes.new(kind)
        node.name = node.label = name
    node.mute = False
    return node


# --- the group


def _group() -> bpy.types.NodeTree:
    """The group of nodes that blends the three images."""
    group = bpy.data.node_groups.get(AROUND)
    if group is not None and group.bl_idname == "CompositorNodeTree" and len(group.nodes):
        return group
    group = bpy.data.node_groups.new(AROUND, "CompositorNodeTree")
    for name in (RENDER, BEHIND, FRONT):
        group.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketColor")
    group.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    into = group.nodes.new("NodeGroupInput")
    render, behind, front = (
        _converted(group, into.outputs[name], True, 200, -220 * row)
        for row, name in enumerate((RENDER, BEHIND, FRONT))
    )
    under, over = (group.nodes.new("CompositorNodeAlphaOver") for _ in range(2))
    under.location, over.location = (800, -100), (1000, -100)
    for node, images in ((under, (behind, render)), (over, (under.outputs[0], front))):
        background_and_foreground = (socket for socket in node.inputs if socket.type == "RGBA")
        for socket, image in zip(background_and_foreground, images, strict=True):
            group.links.new(image, socket)
    out = group.nodes.new("NodeGroupOutput")
    out.location = (1800, -100)
    group.links.new(_converted(group, over.outputs[0], False, 1200, -100), out.inputs[0])
    return group


def _converted(
    group: bpy.types.NodeTree, image: bpy.types.NodeSocket, to_display: bool, x: float, y: float
) -> bpy.types.NodeSocket:
    """An image times alpha, converted from the scene's linear colours to display sRGB, or back."""
    kinds = ("PremulKey", "ConvertColorSpace", "PremulKey")
    straight, convert, multiplied = (group.nodes.new(f"CompositorNode{kind}") for kind in kinds)
    if "Type" in straight.inputs:
        straight.inputs["Type"].default_value = "To Straight"
        multiplied.inputs["Type"].default_value = "To Premultiplied"
    else:
        straight.mapping, multiplied.mapping = "PREMUL_TO_STRAIGHT", "STRAIGHT_TO_PREMUL"
    side = "to_color_space" if to_display else "from_color_space"  # the other one is scene linear by default
    # else another colour configuration is in use: colours are blended linear
    if DISPLAY in convert.bl_rna.properties[side].enum_items:
        setattr(convert, side, DISPLAY)
    for place, node in enumerate((straight, convert, multiplied)):
        node.location = (x + 180 * place, y)
        group.links.new(image, node.inputs["Image"])
        image = node.outputs["Image"]
    return image
