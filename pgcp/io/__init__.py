"""Reading meshes and writing maps. Vertex and face order are those of the file."""

from __future__ import annotations

from pgcp.io.read import READABLE, read_cuts, read_mesh
from pgcp.io.write import write_mesh, write_outputs

__all__ = ["READABLE", "read_cuts", "read_mesh", "write_mesh", "write_outputs"]
