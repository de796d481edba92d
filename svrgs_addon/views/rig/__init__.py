"""Cameras for a splat that comes without photographs."""

from .place import Rig, place_rig, quick_rig

__all__ = ["Rig", "place_rig", "quick_rig"]
