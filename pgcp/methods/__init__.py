"""Methods that map a mesh, each in a file of its own.

Imports interface, patches and what they import. Door: ``registry``.
"""
