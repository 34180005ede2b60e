"""What people do with a map, each application in a file of its own, a command of ``pgcp`` and functions for Python.

Imports the library: api, result and the rooms below. Door: ``registry.APPS``.
"""
