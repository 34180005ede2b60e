"""Where and how tasks run: executors, the store, cached factors, sizes, forked workers. Knows no mathematics.

Imports io.files and the ground. Doors: ``executors``, ``store.PatchStore``, ``sizing.make_plan``.
"""
