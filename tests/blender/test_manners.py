"""A guest in Blender: enabled and disabled without a trace, nothing written where it does not belong."""

from __future__ import annotations

import sys

import bpy
from extension import PACKAGE

MENUS = ("TOPBAR_MT_file_import", "TOPBAR_MT_file_export")
HANDLERS = [name for name in dir(bpy.app.handlers) if isinstance(getattr(bpy.app.handlers, name), list)]


def traces() -> dict:
    """What an add-on can leave behind."""
    return {
        "types": {name for name in dir(bpy.types) if "SVRGS" in name.upper()},
        "subclasses": {
            c.__name__
            for base in (bpy.types.Operator, bpy.types.Panel, bpy.types.FileHandler)
            for c in base.__subclasses__()
            if c.is_registered and "SVRGS" in c.__name__
        },
        "handlers": {name: len(getattr(bpy.app.handlers, name)) for name in HANDLERS},
        "menus": {name: len(getattr(bpy.types, name).draw._draw_funcs) for name in MENUS},
        "operators": set(dir(bpy.ops.svrgs)),
        "properties": {
            (kind, name)
            for kind in ("Scene", "Object", "WindowManager")
            for name in getattr(bpy.types, kind).bl_rna.properties.keys()
            if "svrgs" in name
        },
    }  # fmt: skip


def test_enabled_and_disabled_50_times_leaves_nothing_behind(installed):
    files = {path for path in installed.rglob("*") if "__pycache__" not in path.parts}
    enabled = traces()
    bpy.ops.preferences.addon_disable(module=PACKAGE)
    disabled = traces()
    assert not disabled["types"] and not disabled["operators"] and not disabled["subclasses"]
    assert enabled["operators"]
    # three times by Blender, which unpacks the wheels each time; else what it does beside that
    for number in range(50):
        bpy.ops.preferences.addon_enable(module=PACKAGE) if number < 3 else sys.modules[PACKAGE].register()
        assert traces() == enabled
        bpy.ops.preferences.addon_disable(module=PACKAGE) if number < 3 else sys.modules[PACKAGE].unregister()
        assert traces() == disabled
    bpy.ops.preferences.addon_enable(module=PACKAGE)
    assert traces() == enabled
    # nothing is written into the add-on
    assert {path for path in installed.rglob("*") if "__pycache__" not in path.parts} == files


def test_enabling_loads_nothing_heavy():
    assert not {"torch", "pycolmap", "scipy"} & set(sys.modules)


def test_every_operator_and_panel_explains_itself():
    for name in dir(bpy.ops.svrgs):
        rna = getattr(bpy.ops.svrgs, name).get_rna_type()
        assert all(
            word.lstrip("(")[0].isupper() or word in ("3D", "from", "in", "of", "to")
            for word in rna.name.split()
        ), rna.name
        assert (
            rna.description and not rna.description.endswith(".") and "undocumented" not in rna.description
        ), rna.identifier
        for prop in rna.properties:
            if prop.identifier != "rna_type" and not prop.is_hidden:
                assert not prop.description.endswith("."), (rna.identifier, prop.identifier)


def test_every_setting_explains_itself():
    files = (bpy.ops.svrgs.import_ply, bpy.ops.svrgs.import_colmap, bpy.ops.svrgs.export_ply)
    settings = (bpy.context.scene.svrgs_view.bl_rna, bpy.context.scene.svrgs_prune.bl_rna)
    for rna in (*settings, *(operator.get_rna_type() for operator in files)):
        for prop in rna.properties:
            if prop.identifier not in ("rna_type", "name") and not prop.is_hidden:
                assert prop.description and not prop.description.endswith("."), (
                    rna.identifier,
                    prop.identifier,
                )
                items = prop.enum_items if prop.type == "ENUM" else ()
                assert all(
                    item.name and item.description and not item.description.endswith(".") for item in items
                ), (rna.identifier, prop.identifier)
