"""All methods on one surface, with one judge.

    python methods.py [MESH]

Every method that maps to the disk maps the same mesh. The table has the mean and the spread of their angle errors, their
folds and their times. The picture has a map and its errors for each of them, on one scale of colours.
"""

import sys
from pathlib import Path

import pgcp
from pgcp.options import Options
from pgcp.report.comparison import as_picture, as_text
from pgcp.surface.demo import demo_mesh

mesh = pgcp.read_mesh(sys.argv[1]) if len(sys.argv) > 1 else demo_mesh(60)
rows = pgcp.compare(mesh, options=Options(target="disk", patches=4))
print(as_text(rows))
Path("methods.png").write_bytes(as_picture(rows))
