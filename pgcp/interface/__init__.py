"""Seams solved exactly: operators of patches merged into that of the whole mesh.

Imports patches and what it imports. Door: ``factor.InterfaceFactor``.
"""
