"""The mesh as a surface: topology, operators, angles, Beltrami coefficients, the demo.

Imports the ground only (errors, types, options, parallel). Door: ``topology.examine``.
"""
