"""What several applications share: two surfaces brought into correspondence, meshes and values that are given, pictures.

Imports the library: api, result and the rooms below. Door: ``matching.matched``.
"""
