"""What is tried to map a mesh, one attempt after the other, and what takes the place of a map that fails or folds.

Imports methods, targets, finish, folds and what they import. Doors: ``course.map_mesh``, ``decide.next_attempt``.
"""
