"""What is said and shown of a run: report.json and the picture.

Imports methods, finish, surface and the ground. Doors: ``record``, ``picture.draw``.
"""
