"""A terrain of 770,000 points, mapped with its boundary free.

    python terrain.py [POINTS]

Heights come from noise with the spectrum of mountains. The map with a free boundary shears nothing, and a terrain is so
nearly flat that it hardly changes sizes either: a map sheet without a projection to choose.
"""

import sys

import numpy as np

import pgcp

side = round(int(sys.argv[1] if len(sys.argv) > 1 else 770_000) ** 0.5)
waves = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)) * side
noise = np.random.default_rng(7).standard_normal((side, side))
spectrum = np.fft.rfft2(noise) / np.maximum(waves, 2.0) ** 2.5 * np.exp(-((waves / (0.15 * side)) ** 2))
height = np.fft.irfft2(spectrum, (side, side))
height *= side / 6 / np.ptp(height)

row, column = np.mgrid[:side, :side]
points = np.column_stack([column.ravel(), row.ravel(), height.ravel()]).astype(float)
corner = (row * side + column)[:-1, :-1].ravel()
faces = np.concatenate([[corner, corner + 1, corner + side + 1], [corner, corner + side + 1, corner + side]], axis=1).T

result = pgcp.compute((points, faces))
print(result)
least, most = np.exp(np.quantile(result.log_scale - np.median(result.log_scale), [0.01, 0.99]))
print(f"98 % of the map's lengths are between {least:.2f} and {most:.2f} times the median")
result.picture().save("terrain.png")
