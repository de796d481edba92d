"""Selects the objects that an operator has made, and where new ones are put."""


def select(context, objects):
    """Selects only these objects and makes the last one active. In modes other than Object Mode nothing
    happens."""
    if context.mode == "OBJECT":
        for obj in context.selected_objects:
            obj.select_set(False)
        for obj in (obj for obj in objects if in_view_layer(context, obj)):
            obj.select_set(True)
            context.view_layer.objects.active = obj


def in_view_layer(context, obj) -> bool:
    """Whether the object can be selected. Its collection may be excluded, or belong to another scene."""
    return obj in context.view_layer.objects.values()


def open_collection(context):
    """The active collection; the scene's own if that one is of another file, linked or overridden."""
    foreign = context.collection.library or context.collection.override_library
    return context.scene.collection if foreign else context.collection
