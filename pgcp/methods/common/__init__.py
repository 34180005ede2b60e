"""What several methods share: the frame of disk methods, energies of boundaries, descents.

Imports interface, patches and what they import. Door: ``disk.map_disk``.
"""
