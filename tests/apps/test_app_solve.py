"""pgcp solve: equations with known solutions, energies that fall, and the map against the surface."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from meshes import cap, grid, icosphere, lifted, spheroid
from PIL import Image

import pgcp
from pgcp.apps.solve import needed_degree, solve
from pgcp.cli.apps import main
from pgcp.plane.harmonics import real_harmonics
from pgcp.result import Result
from pgcp.surface.elements import Elements, lumped_areas
from pgcp.surface.equations import EQUATIONS, Constants, evolve, rise_of
from pgcp.surface.operators import face_areas

pytest.importorskip("ducc0")
CONSTANTS = Constants(0.3, 0.0, 0.0)


def known_map(mesh, image):
    """A result whose map is known exactly."""
    made = pgcp.compute(mesh)
    values = {name: getattr(made, name) for name in ("patch", "mu", "quality", "target", "coordinates_name")}
    return Result(mesh=mesh, coordinates=image, **values)


def unit_sphere(degree, rho=None):
    """The harmonic domain of the unit sphere itself, or of one with a ratio of areas rho(points)."""
    from pgcp.plane.sphere_grid import HarmonicDomain, SphereGrid

    grid = SphereGrid(degree)
    return HarmonicDomain(grid, np.ones(len(grid.points)) if rho is None else rho(grid.points), grid.points, lambda w: w)


def disk(n):
    """A mesh of the flat unit disk."""
    _, z = cap(n, 1.2)
    z = z / np.abs(z).max()
    z = z / np.maximum(np.abs(z), 1e-300) * np.round(np.abs(np.arctan(np.abs(z) * np.tan(0.6)) / 0.6) * n) / n
    return np.column_stack([z.real, z.imag, np.zeros(len(z))]), cap(n, 1.2)[0].faces


def norm(values, areas):
    return float(np.sqrt(areas @ np.abs(values) ** 2))


def test_heat_on_the_sphere_decays_each_harmonic_at_its_own_rate():
    domain, time = unit_sphere(8), 0.1
    for degree, order in ((1, 0), (3, -2), (6, 5)):
        place = degree * degree + degree + order
        start, rate = real_harmonics(degree, domain.grid.points)[:, place], degree * (degree + 1)
        errors = []
        for steps in (80, 160):
            end = evolve(EQUATIONS["heat"], CONSTANTS, domain, start, time, steps, 2).frames[-1]
            assert end == pytest.approx((1 + time / steps * rate) ** -steps * start, abs=1e-6)
            errors.append(np.abs(end - np.exp(-rate * time) * start).max())
        assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.1)  # first order in the step
        expected = 0.5 * rate**2 * time * time / 160 * np.exp(-rate * time) * np.abs(start).max()
        assert errors[1] == pytest.approx(expected, rel=0.1)


def test_heat_on_a_mesh_of_the_sphere_decays_alike():
    mesh = icosphere(3)
    areas = lumped_areas(face_areas(mesh.vertices, mesh.faces), mesh.faces, len(mesh.vertices))
    start = real_harmonics(2, mesh.vertices)[:, 6]
    end = evolve(EQUATIONS["heat"], CONSTANTS, Elements(mesh.vertices, mesh.faces, areas), start, 0.1, 100, 2).frames[-1]
    assert norm(end - (1 + 0.006) ** -100 * start, areas) < 0.01 * norm(end, areas)


def test_poisson_on_the_sphere_is_a_division_in_harmonics_and_elements_converge_to_it():
    domain = unit_sphere(5)
    basis = real_harmonics(4, domain.grid.points)
    state = domain.poisson(basis[:, 5] + 3.0 * basis[:, 20] + 7.0)
    assert domain.nodes(state) == pytest.approx(basis[:, 5] / 6 + 3.0 * basis[:, 20] / 20, abs=1e-12)
    errors = []
    for levels in (2, 3, 4):
        mesh = icosphere(levels)
        areas = lumped_areas(face_areas(mesh.vertices, mesh.faces), mesh.faces, len(mesh.vertices))
        wanted = real_harmonics(3, mesh.vertices)[:, 14]
        found = Elements(mesh.vertices, mesh.faces, areas).poisson(12.0 * wanted)
        errors.append(norm(found - wanted, areas))
    assert errors[2] < 0.01
    assert errors[0] / errors[1] > 3.3
    assert errors[1] / errors[2] > 3.3


def test_poisson_on_a_disk_with_0_at_its_edge_converges_to_the_exact_solution():
    errors = []
    for n in (6, 12, 24):
        points, faces = disk(n)
        areas = lumped_areas(face_areas(points, faces), faces, len(points))
        radius = np.hypot(points[:, 0], points[:, 1])
        domain = Elements(points, faces, areas, radius > 1 - 1e-9)
        x = points[:, 0]
        found = domain.poisson(4.0 + 8.0 * x)
        errors.append(np.abs(found - (1 - radius**2) * (1 + x)).max())
    assert errors[2] < 0.01
    assert errors[0] / errors[1] > 3.0
    assert errors[1] / errors[2] > 3.0


@pytest.mark.parametrize("equation", ["allen-cahn", "ginzburg-landau"])
def test_energies_fall_and_a_step_on_the_sphere_is_solved_where_areas_differ_much(equation):
    domain = unit_sphere(12, lambda points: np.exp(2.0 * points[:, 2]))
    random = np.random.default_rng(0).standard_normal((2, len(domain.grid.points)))
    start = 0.5 * (random[0] + 1j * random[1] if EQUATIONS[equation].is_complex else random[0])
    history = evolve(EQUATIONS[equation], CONSTANTS, domain, start, 2.0, 20, 5)
    assert (np.diff(history.energies) < 0).all()
    assert len(history.frames) == 5
    state, values = domain.start(start), domain.nodes(domain.start(start))
    c = 0.1 * 0.09 * (1.0 + 0.5j if EQUATIONS[equation].is_complex else 1.0)
    after = domain.stepper(c)(state, values)
    eigenvalues = domain.grid.degrees * (domain.grid.degrees + 1)
    left = domain.grid.analysis(domain.rho * (domain.nodes(after) - values)) + c * eigenvalues * after
    assert np.abs(left).max() < 1e-5
    assert domain.unsolved == 0


def test_an_energy_that_rises_is_seen():
    assert rise_of(np.array([3.0, 2.0, 1.0])) == 0.0
    assert rise_of(np.array([3.0, 1.0, 2.0])) == pytest.approx(0.5)
    long = solve(pgcp.compute(icosphere(2)), "allen-cahn", epsilon=0.5, time=30.0, step=1.5)
    assert long.problem.startswith("the energy on the ")


def test_the_sphere_and_the_surface_agree_on_an_ellipsoid_the_better_the_finer_the_mesh():
    differences = []
    for levels in (2, 3):
        mesh, image = spheroid(levels, 1.5)
        result = known_map(mesh, image)
        start = np.tanh(3.0 * mesh.vertices[:, 0] + mesh.vertices[:, 2])
        solution = solve(result, "allen-cahn", epsilon=0.4, time=1.0, step=0.05, source=start)
        differences.append(solution.difference)
        assert solution.problem == ""
    assert differences[1] < 0.02
    assert differences[1] < 0.4 * differences[0]


@pytest.mark.parametrize(("target", "most"), [("disk", 0.02), ("free", 0.02)])
@pytest.mark.parametrize("equation", ["allen-cahn", "heat", "poisson"])
def test_the_flat_map_and_the_surface_agree_but_for_the_angle_errors(hills, target, most, equation):
    result = pgcp.compute(hills, pgcp.Options(target=target, patches=2))
    times = {} if equation == "poisson" else {"time": 0.05, "step": 0.01}
    solution = solve(result, equation, **times)
    assert 0.0 < solution.difference < most
    assert solution.record["energy_rises"] == [0.0, 0.0]


def test_a_flat_map_with_the_surfaces_own_angles_gives_the_surfaces_own_solution():
    mesh = grid(8)
    result = known_map(mesh, 3.0 * mesh.vertices[:, :2])
    for edge in ("neumann", "dirichlet"):
        solution = solve(result, "ginzburg-landau", epsilon=0.3, time=1.0, edge=edge)
        assert solution.difference < 1e-9
        rim = (np.abs(mesh.vertices[:, :2] - 0.5) > 0.5 - 1e-9).any(axis=1)
        assert (np.abs(solution.values[rim]).max() == 0.0) == (edge == "dirichlet")


def test_seeds_give_the_noise_and_split_vertices_are_one(tmp_path):
    result = pgcp.compute(spheroid(2, 1.2)[0])
    one, same, other = (solve(result, "allen-cahn", time=0.2, seed=seed).values for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert np.abs(one - other).max() > 0.1
    mesh, _ = spheroid(2, 1.2)
    vertices = np.vstack([mesh.vertices, mesh.vertices[:9], [[9.0, 9.0, 9.0]]])
    faces = mesh.faces.copy()
    moved = faces[::2]
    moved[moved < 9] += len(mesh.vertices)
    split = pgcp.compute(pgcp.Mesh(vertices, faces))
    solution = solve(split, "heat", time=0.02, step=0.01)
    assert solution.values.shape == (len(split.mesh.vertices),)
    assert np.isfinite(solution.values).all()
    assert np.array_equal(solution.values[:9], solution.values[len(mesh.vertices) : len(mesh.vertices) + 9])


def test_the_degree_that_is_needed_is_that_of_the_edges_on_the_sphere():
    result = pgcp.compute(icosphere(3))
    edge = np.linalg.norm(result.coordinates[result.faces[:, 0]] - result.coordinates[result.faces[:, 1]], axis=1)
    assert np.pi / edge.max() < needed_degree(result) < np.pi / edge.min()
    assert solve(result, "poisson").record["degree"] == needed_degree(result)
    assert solve(result, "poisson", degree=9).record["degree"] == 9


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pgcp.write_mesh("ball.ply", spheroid(2, 1.5)[0])
    pgcp.write_mesh("bust.ply", lifted(grid(8)))
    Path("short.txt").write_text("1\n2\n")
    np.savetxt("start.txt", np.sin(3 * pgcp.read_mesh("bust.ply").vertices[:, :2]))
    return tmp_path


def names(path):
    return sorted(str(file.relative_to(path)) for file in path.rglob("*") if file.is_file())


def test_the_command_writes_fields_a_picture_and_an_animation(folder, capsys):
    assert main(["solve", "bust.ply", "--time", "0.4", "--source", "start.txt", "--target", "disk"]) == 0
    assert "relative difference in L2 from finite elements on the surface" in capsys.readouterr().out
    endings = (".gif", ".npz", ".ply", ".png", ".vtp")
    assert names(folder / "bust_solve") == sorted([*(f"bust{end}" for end in endings), "solve.json"])
    said = json.loads(Path("bust_solve/solve.json").read_text())
    with np.load("bust_solve/bust.npz") as data:
        fields = {name: data[name] for name in data.files}
    assert fields["start"] == pytest.approx(np.loadtxt("start.txt") @ [1, 1j])
    assert fields["frames"].shape == (len(fields["frame_times"]), len(fields["w"]))
    assert said["difference"] == pytest.approx(fields["differences"][-1])
    assert Image.open("bust_solve/bust.gif").n_frames == len(fields["frames"])
    plyfile = pytest.importorskip("plyfile")
    vertex = plyfile.PlyData.read("bust_solve/bust.ply")["vertex"]
    assert np.array_equal(np.asarray(vertex["w_real"]), fields["w"].real)
    assert np.array_equal(np.asarray(vertex["w_surface_imag"]), fields["w_surface"].imag)
    pyvista = pytest.importorskip("pyvista")
    assert np.array_equal(pyvista.read("bust_solve/bust.vtp").point_data["w_imag"], fields["w"].imag)


def test_a_steady_equation_has_no_animation(folder, capsys):
    assert main(["solve", "ball.ply", "--equation", "poisson", "-o", "w.npz", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["degree_needed"] >= 15
    assert main(["solve", "ball.ply", "--equation", "poisson", "-o", "w.gif"]) == 2
    assert names(folder) == ["ball.ply", "bust.ply", "short.txt", "start.txt", "w.npz"]


def test_a_step_that_is_too_long_ends_with_a_numerical_failure(folder, capsys):
    assert main(["solve", "bust.ply", "--equation", "ginzburg-landau", "--step", "50", "--time", "500", "-o", "a.npz"]) == 3
    assert "grows out of bounds" in capsys.readouterr().err
    assert not Path("a.npz").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["ball.ply", "--equation", "waves"], "argument --equation: invalid choice: 'waves'"),
        (["ball.ply", "--time", "-1"], "time is -1.0; it must be more than 0"),
        (["ball.ply", "--step", "nan"], "step is nan; it must be more than 0"),
        (["ball.ply", "--step", "1e-9"], "2e+10 steps are more than 1,000,000"),
        (["ball.ply", "--epsilon", "0"], "epsilon is 0.0; it must be more than 0"),
        (["ball.ply", "--equation", "heat", "--beta", "1"], "the equation heat has no constant beta"),
        (["ball.ply", "--equation", "poisson", "--time", "1"], "the equation poisson is steady; it has no time"),
        (["ball.ply", "--boundary-condition", "neumann"], "a closed surface has no boundary"),
        (["bust.ply", "--degree", "20"], "degree is that of spherical harmonics, and this surface is mapped to the plane"),
        (["ball.ply", "--degree", "0"], "degree is 0; it must be from 1 to 2000"),
        (["ball.ply", "--source", "short.txt"], "short.txt: it holds values of 2 vertices, and the mesh has 162"),
        (["bust.ply", "--source", "start.txt", "--equation", "heat"], "start.txt: it holds 2 values a line"),
        (["bust.ply", "--target", "sphere"], "bust.ply is an open surface (a disk)"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_sentence(folder, capsys, words, message):
    before = names(folder)
    assert main(["solve", *words]) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith(f"pgcp solve: {message}")
    assert names(folder) == before


def test_from_python_unknown_names_and_sources_are_refused():
    result = pgcp.compute(lifted(grid(6)))
    for keywords in ({"equation": "waves"}, {"edge": "robin"}, {"source": np.zeros(3)}, {"source": np.full(49, np.nan)}):
        with pytest.raises(pgcp.InputError):
            solve(result, **{"equation": "heat", **keywords})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "target"), [("open/camel_head", "disk"), ("open/camel_head", "free"), ("closed/max_planck", "sphere")]
)
def test_maps_of_real_surfaces_give_the_solutions_of_the_surfaces(mesh_folder, name, target):
    result = pgcp.compute(mesh_folder / f"{name}.ply", pgcp.Options(target=target, moebius="area"))
    for equation, times in (("poisson", {}), ("heat", {"time": 0.05, "step": 0.01})):
        assert solve(result, equation, **times).difference < 0.01
