"""Surfaces of polygons: cut into triangles to be mapped, and put together again afterwards.

Imports the ground. Doors: ``triangulate.triangulated``, ``together.polygons_of``."""
