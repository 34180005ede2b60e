"""LDM: its last steps on curves that are known, and figures beside the printed ones."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import grid, lifted

import pgcp
from pgcp.errors import SolveFailedError
from pgcp.methods.ldm import on_the_circle


@pytest.mark.parametrize("count", [3, 4, 11, 40])
@pytest.mark.parametrize("centre", [0.0, 0.3 - 0.2j])
def test_a_circle_goes_to_the_circle_by_a_moebius_map(count, centre):
    gaps = np.random.default_rng(count).uniform(0.5, 1.5, count)
    exact = np.exp(2j * np.pi * np.cumsum(gaps) / gaps.sum())
    z = on_the_circle(0.7 * exact + centre)
    assert np.abs(np.abs(z) - 1).max() < 1e-14
    assert np.mod(np.angle(np.roll(z, -1) / z), 2 * np.pi).sum() == pytest.approx(2 * np.pi)
    if count > 3:

        def ratio(p):
            return (p[0] - p[2]) * (p[1] - p[3]) / ((p[0] - p[3]) * (p[1] - p[2]))

        assert ratio(z) == pytest.approx(ratio(exact), abs=0.02)


def test_a_boundary_in_one_point_is_refused():
    with pytest.raises(SolveFailedError, match="in one point"):
        on_the_circle(np.full(6, 0.5 + 0j))


def test_the_report_says_how_many_were_held():
    report = pgcp.parameterize(lifted(grid(12)), method="ldm", target="disk", patches=2).report
    assert report["interface"]["vertices"] >= 48 + 40
    assert report["iterations"] == []


@pytest.mark.parametrize(
    ("name", "mean", "sd", "energy"), [("chinese_lion_head", 1.42, 2.05, None), ("human_brain", 1.57, 1.62, 0.0244)]
)
def test_no_worse_than_printed(name, mean, sd, energy, mesh_folder):
    """CDCP Table 1 (LDCP), CCEM Table 1."""
    quality = pgcp.parameterize(pgcp.read_mesh(mesh_folder / "open" / f"{name}.ply"), method="ldm", patches=2).quality
    assert quality.folds == 0
    assert quality.angle_mean_deg < mean + 0.005
    assert quality.angle_sd_deg < sd + 0.005
    assert energy is None or quality.conformal_energy < energy + 0.00005
