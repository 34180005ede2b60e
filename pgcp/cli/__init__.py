"""The command ``pgcp-run``: the only place that prints and that sets an exit status.

Imports everything. Door: ``main.run``.
"""
