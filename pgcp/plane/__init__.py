"""Curves and Moebius maps of the plane, the disk and the sphere; the zipper and the natural boundary.

Imports surface and the ground. Doors: ``zipper``, ``natural.natural_boundary``, ``geodesic.geodesic_map``.
"""
