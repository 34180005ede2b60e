"""A cortex on the sphere, and where angles and areas change.

    python brain.py [MESH]

The surface of a brain is closed, so it goes to the sphere. A conformal map keeps the angles of its folds. The Moebius
correction spreads its area as evenly as angles allow. Without MESH, a ball with folds takes the brain's place.
"""

import sys

import numpy as np
import trimesh

import pgcp

if len(sys.argv) > 1:
    source = sys.argv[1]
else:
    ball = trimesh.creation.icosphere(subdivisions=5)
    x, y, z = 9.0 * ball.vertices.T
    folds = np.sin(x + np.sin(y)) * np.sin(y + np.sin(z)) * np.sin(z + np.sin(x))
    source = ball.vertices * (1.0 + 0.12 * folds)[:, None], ball.faces

result = pgcp.parameterize(source, target="sphere", moebius="area")
print(result)
print(f"half of all faces change their area by less than {np.exp(np.median(np.abs(np.log(result.area_ratio)))):.2f} times")
result.picture().save("brain.png")
