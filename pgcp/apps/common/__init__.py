"""What several applications share: values of vertices read, drawn and written.

Imports what applications import. Doors: ``fields``, ``at_vertices``.
"""
