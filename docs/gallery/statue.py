"""A statue cut open, with texture coordinates that a painter would take.

    python statue.py [MESH]

A closed surface has no map to the plane. `cut="auto"` cuts it open along short edges in hidden places, out to the tips that
would be squeezed most, until the areas of the map differ by a factor of at most 20 on 98 % of the surface.
"""

import sys

import numpy as np
import trimesh

import pgcp

if len(sys.argv) > 1:
    source = sys.argv[1]
else:
    ball = trimesh.creation.icosphere(subdivisions=5)
    limbs = np.array([[1, 0, 0.2], [-1, 0.2, 0.4], [0, 0.3, 1], [0.5, -1, -0.6], [-0.5, -1, -0.6]])
    towards = ball.vertices @ (limbs / np.linalg.norm(limbs, axis=1)[:, None]).T
    source = ball.vertices * (1.0 + 2.5 * np.exp(18.0 * (towards - 1.0)).sum(axis=1))[:, None], ball.faces

result = pgcp.parameterize(source, cut="auto")
print(result)
cut = result.report["cut"]
print(f"cut along {cut['edges']} edges through {cut['tips']} tips; scale ratio {cut['scale_ratio']:.1f}")
result.picture().save("statue.png")
