"""Targets of maps, each in a file of its own: boundary condition, coordinates, corrections and place.

Imports interface, finish, patches and what they import. Door: ``registry``.
"""
