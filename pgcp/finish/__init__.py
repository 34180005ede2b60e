"""What is done with a map of the whole mesh: Moebius correction, place, quality.

Imports patches, plane, surface and the ground. Doors: ``correct.correct``, ``place.placed``, ``quality.measure_quality``.
"""
