"""What several applications share: values at vertices, pictures of them, two surfaces brought into correspondence.

Imports the library: api, result and the rooms below. Doors: ``at_vertices``, ``fields``, ``matching.matched``.
"""
