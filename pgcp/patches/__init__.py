"""The steps of PGCP on patches, and their tasks beside them.

Imports runtime, elimination, plane, surface and the ground. Doors: ``stored.store_parts``, ``tasks``.
"""
