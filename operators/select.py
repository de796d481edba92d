"""What an operator made becomes the selection."""


def select(context, objects):
    """Selects these alone and makes the last one active, in the modes that know a selection of objects."""
    if context.mode == "OBJECT":
        for obj in context.selected_objects:
            obj.select_set(False)
        for obj in (obj for obj in objects if in_view_layer(context, obj)):
            obj.select_set(True)
            context.view_layer.objects.active = obj


def in_view_layer(context, obj) -> bool:
    """Whether the object can be selected: its collection may be excluded, or be another scene's."""
    return obj in context.view_layer.objects.values()
