"""The compositor's nodes that put a picture of splats around a render: Gaussians in front, over the render, over Gaussians behind.

They stand behind the Image of the render's own Render Layers node: what used that image before uses the result. Blender 5.0 has another
place for a scene's nodes, and other names of sockets.
"""

from __future__ import annotations

import bpy

SPLATS, UNDER, OVER = "SVR-GS Splats", "SVR-GS Behind", "SVR-GS In Front"  # names of the nodes
HAS_GROUPS = bpy.app.version >= (5, 0, 0)  # the nodes of a scene are a node group; else a tree of its own


def insert(scene: bpy.types.Scene, layer: bpy.types.Scene):
    """Adds the nodes to the scene, or sets them right. layer: the scene whose render has the splats."""
    scene.render.use_compositing = True
    tree = _tree(scene) or _new_tree(scene)
    render = _render_node(tree, scene)
    users = [link.to_socket for link in render.outputs["Image"].links if link.to_node.name != UNDER]
    splats, under, over = (
        _node(tree, *kind) for kind in ((SPLATS, "CompositorNodeRLayers"), (UNDER, "CompositorNodeAlphaOver"), (OVER, "CompositorNodeAlphaOver"))
    )
    splats.scene = layer
    splats.layer = layer.view_layers[0].name
    for node, behind, front in ((under, splats.outputs["Behind"], render.outputs["Image"]), (over, under.outputs[0], splats.outputs["Image"])):
        for socket, source in zip(_images(node), (behind, front), strict=True):
            tree.links.new(source, socket)
    for user in users:
        tree.links.new(over.outputs[0], user)
    if not over.outputs[0].links:
        tree.links.new(over.outputs[0], _output(tree).inputs[0])
    x, y = render.location
    splats.location, under.location, over.location = (x, y - 450), (x + 300, y - 200), (x + 500, y - 200)
    for user in users:
        user.node.location.x = max(user.node.location.x, x + 700)


def remove(scene: bpy.types.Scene):
    """Removes the nodes again: what used the result uses the render's image."""
    tree = _tree(scene)
    if tree is None:
        return
    under, over = tree.nodes.get(UNDER), tree.nodes.get(OVER)
    if under is not None and over is not None and _images(under)[1].is_linked:
        image = _images(under)[1].links[0].from_socket
        for user in [link.to_socket for link in over.outputs[0].links]:
            tree.links.new(image, user)
    for name in (SPLATS, UNDER, OVER):
        if name in tree.nodes:
            tree.nodes.remove(tree.nodes[name])


def are_complete(scene: bpy.types.Scene, layer: bpy.types.Scene) -> bool:
    """Whether a render of the scene puts the splats of the layer around it."""
    tree = _tree(scene)
    if tree is None or not scene.render.use_compositing or any(name not in tree.nodes for name in (SPLATS, UNDER, OVER)):
        return False
    splats, under, over = (tree.nodes[name] for name in (SPLATS, UNDER, OVER))
    sources = [socket.links[0].from_node if socket.is_linked else None for node in (under, over) for socket in _images(node)]
    render = sources[1]
    known = splats.scene == layer and sources[0] == splats and sources[2] == under and sources[3] == splats
    return known and render is not None and bool(over.outputs[0].links) and not any(node.mute for node in (splats, under, over, render))


def _tree(scene: bpy.types.Scene) -> bpy.types.NodeTree | None:
    if HAS_GROUPS:
        return scene.compositing_node_group
    return scene.node_tree if scene.use_nodes else None


def _new_tree(scene: bpy.types.Scene) -> bpy.types.NodeTree:
    if not HAS_GROUPS:
        scene.use_nodes = True  # Blender makes a tree with a Render Layers and a Composite node
        return scene.node_tree
    tree = scene.compositing_node_group = bpy.data.node_groups.new(f"{scene.name} Compositing", "CompositorNodeTree")
    tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    return tree


def _render_node(tree: bpy.types.NodeTree, scene: bpy.types.Scene) -> bpy.types.Node:
    """The Render Layers node of the scene itself whose image is used; a new one if there is none."""
    own = [node for node in tree.nodes if node.type == "R_LAYERS" and node.name != SPLATS and node.scene in (scene, None)]
    used = [node for node in own if node.outputs["Image"].links]
    if used or own:
        return (used or own)[0]
    node = tree.nodes.new("CompositorNodeRLayers")
    node.scene = scene
    return node


def _output(tree: bpy.types.NodeTree) -> bpy.types.Node:
    """The node whose first input is the result."""
    kind, name = ("GROUP_OUTPUT", "NodeGroupOutput") if HAS_GROUPS else ("COMPOSITE", "CompositorNodeComposite")
    node = next((node for node in tree.nodes if node.type == kind), None) or tree.nodes.new(name)
    if not node.inputs or node.inputs[0].type == "CUSTOM":
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    return node


def _node(tree: bpy.types.NodeTree, name: str, kind: str) -> bpy.types.Node:
    node = tree.nodes.get(name)
    if node is None:
        node = tree.nodes.new(kind)
        node.name = node.label = name
    node.mute = False
    return node


def _images(node: bpy.types.Node) -> list[bpy.types.NodeSocket]:
    """Background and foreground of an Alpha Over node."""
    return [socket for socket in node.inputs if socket.type == "RGBA"]
