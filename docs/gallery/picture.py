"""A picture on a surface.

    python picture.py [MESH [IMAGE]]

`pgcp texture` puts a picture on the surface through its map, here a checkerboard, and says how many texels there are for a unit
of length. Squares keep their right angles everywhere. Without MESH, it is the built-in bust.
"""

import sys
import tempfile
from pathlib import Path

import pgcp
from pgcp.cli.apps import main
from pgcp.surface.demo import demo_mesh

with tempfile.TemporaryDirectory() as folder:
    words = sys.argv[1:]
    if not words:
        pgcp.write_mesh(Path(folder, "bust.ply"), demo_mesh())
        words = [str(Path(folder, "bust.ply"))]
    status = main(["texture", *words, "-o", "textured.glb", "-o", "picture_density.png"])
Path("picture_density.png").replace("picture.png")
sys.exit(status)
