"""Folds found on a finished map and taken away.

Imports elimination, plane, surface and the ground. Door: ``repair.repair_folds``.
"""
