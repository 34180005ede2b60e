"""Meshes and maps in files, each format in a file of its own; files written whole or not at all.

Imports the ground only. Doors: ``formats``, ``read.read_mesh``, ``write.write_outputs``, ``files``.
"""
