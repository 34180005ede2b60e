"""Is it a mesh that can be mapped, and if not, how it is mended.

Imports surface and the ground. Doors: ``check.check_mesh``, ``mend.mend``.
"""
