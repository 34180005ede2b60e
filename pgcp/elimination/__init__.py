"""Interiors eliminated, boundary last: sparse Laplacians reduced to dense operators.

Imports surface and the ground. Door: ``dirichlet``.
"""
