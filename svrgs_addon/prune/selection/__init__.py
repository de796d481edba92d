"""Selections: functions from a Scene to a mask (N,) bool, one for each criterion, and their combination."""
