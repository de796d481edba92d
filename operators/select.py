"""What an operator made becomes the selection."""


def select(context, objects):
    """Selects these alone and makes the last one active, in the modes that know a selection of objects."""
    if context.mode == "OBJECT":
        for obj in context.selected_objects:
            obj.select_set(False)
        for obj in objects:
            obj.select_set(True)
        context.view_layer.objects.active = objects[-1]
