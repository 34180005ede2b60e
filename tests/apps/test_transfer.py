"""Values carried between surfaces: one surface meshed twice and turned corresponds to itself."""

from __future__ import annotations

import json

import numpy as np
import pytest
from meshes import SHARED, even_sphere, grid, hilly_disk, icosphere, lifted, lumpy
from scipy.spatial.transform import Rotation

import pgcp
from pgcp.apps.common.matching import matched
from pgcp.apps.transfer import transfer
from pgcp.cli.apps import main
from pgcp.io.values import read_values

TURN = Rotation.from_euler("xyz", [2.0, -0.7, 1.1])
SHIFT = np.array([1.0, 2.0, 3.0])


def elsewhere(points):
    """A similarity of space."""
    return 2.0 * TURN.apply(points) + SHIFT


def edges(mesh):
    """Lengths of all edges."""
    corners = mesh.vertices[mesh.faces]
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)


def meshes_of(kind):
    """One surface meshed twice, the second elsewhere."""
    if kind == "closed":
        one, two = icosphere(3), even_sphere(700)
        one, two = pgcp.Mesh(lumpy(one.vertices), one.faces, "one"), pgcp.Mesh(lumpy(two.vertices), two.faces, "two")
    else:
        one, two = hilly_disk(800), hilly_disk(600, 0.4)
    return one, pgcp.Mesh(elsewhere(two.vertices), two.faces, "two")


@pytest.fixture(scope="module", params=["closed", "open"])
def maps(request):
    target = {"closed": "sphere", "open": "disk"}[request.param]
    return [pgcp.parameterize(mesh, target=target, patches=2) for mesh in meshes_of(request.param)]


@pytest.fixture(scope="module")
def done(maps):
    a, b = maps
    return transfer(a, b, values={"height": a.mesh.vertices[:, 2]})


def test_a_surface_meshed_twice_and_turned_corresponds_to_itself_within_half_an_edge(done):
    a, b = done.a.mesh, done.b.mesh
    assert np.linalg.norm(done.on_b.points - elsewhere(a.vertices), axis=1).max() < 0.5 * edges(b).mean()
    assert np.linalg.norm(elsewhere(done.on_a.points) - b.vertices, axis=1).max() < edges(a).mean()
    assert done.record["is_sure"]
    assert done.record["rms_difference"] < 0.02 < 0.1 < done.record["rms_difference_of_next_turn"]


def test_places_are_faces_weights_and_points(done):
    corners = done.b.mesh.vertices[done.b.faces[done.on_b.faces]]
    assert np.allclose(np.einsum("nk,nkd->nd", done.on_b.weights, corners), done.on_b.points)
    assert np.allclose(done.on_b.weights.sum(axis=1), 1.0)
    assert done.on_b.weights.min() >= 0.0


def test_the_round_trip_moves_nothing_farther_than_an_edge_and_is_stated(done):
    a, b = done.a.mesh, done.b.mesh
    back = done.there_and_back(a.vertices)
    away = np.linalg.norm(back - a.vertices, axis=1)
    assert 0.0 < away.max() < 0.5 * (edges(a).max() + 0.5 * edges(b).max())
    said = done.round_trip()
    size = np.linalg.norm(np.ptp(a.vertices, axis=0))
    assert said["positions"]["max"] == pytest.approx(away.max() / size)
    assert said["positions"]["mean"] < said["positions"]["p95"] < said["positions"]["max"] < 0.03
    heights = np.abs(back[:, 2] - a.vertices[:, 2]) / np.ptp(a.vertices[:, 2])
    assert said["values"]["height"]["mean"] == pytest.approx(heights.mean())


def test_a_field_is_carried_to_where_it_belongs(done):
    heights = TURN.inv().apply((done.b.mesh.vertices - SHIFT) / 2.0)[:, 2]
    assert np.abs(done.on_b_values["height"] - heights).max() < 0.06 * np.ptp(heights)
    assert np.abs(done.on_b_values["height"] - heights).mean() < 0.005 * np.ptp(heights)
    labels = (done.a.mesh.vertices[:, 0] > 0.0).astype(np.int64) * 7
    assert set(np.unique(done.to_b(labels))) == {0, 7}


def test_values_of_both_turn_the_maps_as_well(maps):
    a, b = maps
    there = TURN.inv().apply((b.mesh.vertices - SHIFT) / 2.0)
    found = transfer(a, b, values={"x": a.mesh.vertices[:, 0]}, other_values={"x": there[:, 0]}, align="values")
    assert found.record["by"] == "values"
    assert np.linalg.norm(found.on_b.points - elsewhere(a.mesh.vertices), axis=1).max() < edges(b.mesh).mean()


def nearest(points, others):
    return np.array([int(np.argmin(np.linalg.norm(others - point, axis=1))) for point in points])


@pytest.mark.parametrize("fit", ["moebius", "rotation"])
def test_landmarks_are_used_instead(maps, fit):
    a, b = maps
    some = np.linspace(0, len(a.mesh.vertices) - 1, 9).astype(int)
    pairs = np.column_stack([some, nearest(elsewhere(a.mesh.vertices[some]), b.mesh.vertices)])
    found = matched(a, b, landmarks=pairs, fit=fit)
    assert np.linalg.norm(found.on_b.points - elsewhere(a.mesh.vertices), axis=1).max() < 1.5 * edges(b.mesh).max()
    assert found.record["max_distance"] < 0.03
    wrong = np.column_stack([some, np.roll(pairs[:, 1], 2)])
    assert matched(a, b, landmarks=wrong, fit=fit).record["mean_distance"] > 0.1


def test_landmarks_of_least_number_are_met_exactly(maps):
    a, b = maps
    count = {"sphere": 3, "disk": 2}[a.target]
    inner = np.flatnonzero(np.abs(a.mesh.vertices[:, 0]) < 0.5)
    inner = inner[np.linspace(0, len(inner) - 1, count).astype(int)]
    pairs = np.column_stack([inner, nearest(elsewhere(a.mesh.vertices[inner]), b.mesh.vertices)])
    record = matched(a, b, landmarks=pairs).record
    assert record["max_distance"] < (1e-6 if a.target == "sphere" else 0.02)
    with pytest.raises(
        pgcp.InputError, match=f"there are {count - 1} pairs of different landmarks; a fit by moebius needs {count} here"
    ):
        matched(a, b, landmarks=pairs[:-1])


def test_what_does_not_fit_is_refused(maps):
    a, b = maps
    count = len(a.mesh.vertices)
    other = pgcp.parameterize(lifted(grid(6)), target="disk") if a.target == "sphere" else pgcp.parameterize(icosphere(1))
    free = pgcp.parameterize(lifted(grid(6)))
    for call, words in (
        (lambda: transfer(a, other), "only two closed surfaces, or two open ones, correspond"),
        (lambda: transfer(free, free), "is mapped to the target free, which is no common domain; use target disk"),
        (lambda: transfer(a, b, values={"v": np.zeros(3)}), r"values 'v' have shape \(3,\)"),
        (lambda: transfer(a, b, values={"v": np.full(count, np.nan)}), "hold what is no finite number"),
        (lambda: transfer(a, b, align="values"), "to align by values, values of both surfaces are needed"),
        (lambda: transfer(a, b, align="luck"), "unknown alignment 'luck'"),
        (lambda: matched(a, b, landmarks=[[0, 0], [1, 1], [2, 99999]]), "pair 3 of the landmarks has vertex 99999"),
        (lambda: matched(a, b, landmarks=[[0, 0], [0, 1], [0, 2]]), "there are 1 pairs of different landmarks"),
        (lambda: matched(a, b, landmarks=[[0.5, 1.0]]), "expected"),
    ):
        with pytest.raises(pgcp.InputError, match=words):
            call()


def test_of_round_surfaces_no_turn_is_sure():
    found = matched(*(pgcp.parameterize(ball, patches=1) for ball in (icosphere(2), even_sphere(300))))
    assert not found.record["is_sure"]
    assert np.isfinite(found.on_b.points).all()


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one, two = icosphere(2), even_sphere(300)
    pgcp.write_mesh("one.ply", pgcp.Mesh(lumpy(one.vertices), one.faces))
    pgcp.write_mesh("two.ply", pgcp.Mesh(elsewhere(lumpy(two.vertices)), two.faces))
    pgcp.write_mesh("open.ply", lifted(grid(6)))
    heights = lumpy(one.vertices)[:, 2]
    np.savetxt("height.txt", heights)
    (tmp_path / "named.csv").write_text("z,label\n" + "\n".join(f"{z},{k % 3}" for k, z in enumerate(heights)))
    np.savez("other.npz", depth=np.arange(300.0), more=np.zeros((300, 2)), none=np.zeros(4))
    (tmp_path / "lh.sulc").write_bytes(
        b"\xff\xff\xff" + np.array([162, 320, 1], ">i4").tobytes() + heights.astype(">f4").tobytes()
    )
    return tmp_path


def test_the_command_writes_places_values_and_a_picture(files, capsys):
    words = ["transfer", "one.ply", "two.ply", "--values", "named.csv", "--values-b", "other.npz", "--patches", "2", "--json"]
    assert main(words) == 0
    said = json.loads(capsys.readouterr().out)
    assert sorted(path.name for path in (files / "one_transfer").iterdir()) == [
        "one.csv", "one.npz", "one.png", "one_a.ply", "one_b.ply", "transfer.json",
    ]  # fmt: skip
    assert said["alignment"]["is_sure"]
    assert set(said["round_trip"]["values"]) == {"value_z", "label"}
    one, two = (pgcp.read_mesh(f"{name}.ply") for name in ("one", "two"))
    with np.load("one_transfer/one.npz") as data:
        places = np.einsum("nk,nkd->nd", data["a_weights"], two.vertices[data["a_corners"]])
        assert np.allclose(places, data["a_points"])
        assert np.array_equal(two.faces[data["a_faces"]], data["a_corners"])
        assert np.linalg.norm(places - elsewhere(one.vertices), axis=1).max() < edges(two).mean()
        assert np.abs(data["on_b_z"] - TURN.inv().apply((two.vertices - SHIFT) / 2.0)[:, 2]).max() < 0.1
        assert data["on_a_depth"].shape == (162,)
        assert data["on_a_more"].shape == (162, 2)
        depth, z = data["on_a_depth"], data["on_b_z"]
    table = np.genfromtxt("one_transfer/one.csv", delimiter=",", names=True)
    assert np.allclose(table["depth"], depth)
    assert len(table) == 162
    carried = pgcp.apps.common.pairs.surface_of("one_transfer/one_b.ply").source.of_vertices
    assert np.allclose(carried["value_z"], z)


def test_colours_of_a_file_are_carried(files):
    from pgcp.apps.common.values import mesh_with

    one = pgcp.read_mesh("one.ply")
    red = np.where(one.vertices[:, 2] > 0, 250, 10).astype(np.uint8)
    (files / "painted.ply").write_bytes(
        mesh_with("painted.ply", one, {"red": red, "green": red, "blue": 0 * red})["painted.ply"]
    )
    assert main(["transfer", "painted.ply", "two.ply", "--patches", "2", "--quiet", "-o", "on_b.ply", "-o", "it.png"]) == 0
    there = pgcp.apps.common.pairs.surface_of("on_b.ply").source.of_vertices
    height = TURN.inv().apply((pgcp.read_mesh("two.ply").vertices - SHIFT) / 2.0)[:, 2]
    assert there["red"].dtype == np.uint8
    assert (there["red"][height > 0.25] > 200).all()
    assert (there["red"][height < -0.25] < 60).all()
    assert np.array_equal(there["red"], there["green"])
    assert (files / "it.png").stat().st_size > 5000


def test_freesurfer_values_and_those_of_text_are_the_same(files):
    one, two = (read_values(name, 162)["value"] for name in ("height.txt", "lh.sulc"))
    assert np.allclose(one, two, atol=1e-6)
    assert np.allclose(one, pgcp.read_mesh("one.ply").vertices[:, 2], atol=1e-6)
    with pytest.raises(pgcp.BadFileError, match=r"lh\.sulc: it holds values of 162 vertices, and the mesh has 163"):
        read_values("lh.sulc", 163)


@pytest.mark.parametrize(
    ("words", "content", "message"),
    [
        (["open.ply"], "", "one.ply is closed and open.ply is open; only two closed surfaces, or two open ones, correspond"),
        (["two.ply", "--values", "x.txt"], "1\n2\n", "x.txt: it holds values of 2 vertices, and the mesh has 162"),
        (["two.ply", "--values", "x.txt"], "a b\n1 2\n3 x\n", "x.txt: line 3 of its values is not 2 numbers: '3 x'"),
        (["two.ply", "--values", "x.txt"], "nan\n" * 162, "x.txt: value of vertex 0 is no finite number"),
        (["two.ply", "--values", "x.txt"], "", "x.txt: the file holds no values"),
        (["two.ply", "--values", "lost.txt"], "", "lost.txt: the values cannot be read: No such file or directory"),
        (
            ["two.ply", "--values", "other.npz"],
            "",
            "other.npz: no array has a row for each of the 162 vertices; it holds depth",
        ),
        (
            ["two.ply", "--align", "values"],
            "",
            "to align by values, values of both surfaces are needed: --values and --values-b",
        ),
        (["two.ply", "--landmarks", "x.txt"], "1 2 3\n", "x.txt: line 1 is not a pair of vertex ids: '1 2 3'"),
        (["two.ply", "--landmarks", "x.txt"], "# none\n", "x.txt: the file holds no landmarks"),
        (
            ["two.ply", "--landmarks", "x.txt"],
            "1 2\n162 3",
            "x.txt: pair 2 of the landmarks has vertex 162, but one.ply has 162 vertices",
        ),
        (
            ["two.ply", "--landmarks", "x.txt"],
            "0 0\n5 5\n",
            "x.txt: there are 2 pairs of different landmarks; a fit by moebius",
        ),
        (["two.ply", "--landmarks", "lost.txt"], "", "lost.txt: there is no such file of landmarks"),
        (["two.ply", "--component", "all"], "", "component all is several surfaces; two that correspond are one each"),
        (["two.ply", "--target", "disk"], "", "this needs a map to the target sphere, and --target disk asks for another"),
        (["lost.ply"], "", "lost.ply: there is no such file"),
    ],
)
def test_mistakes_are_said_in_one_sentence_before_anything_is_mapped(files, capsys, monkeypatch, words, content, message):
    def mapped(*_):
        pytest.fail("a mesh was mapped")

    monkeypatch.setattr("pgcp.api.map_surface", mapped)
    (files / "x.txt").write_text(content)
    before = sorted(path.name for path in files.iterdir())
    assert main(["transfer", "one.ply", *words]) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith(f"pgcp transfer: {message}")
    assert sorted(path.name for path in files.iterdir()) == before


def test_numbers_are_those_of_the_input_where_a_part_of_it_is_mapped(files, capsys):
    """Beside a small other component, the vertices of the surface have other numbers than in its map."""
    small, one, two = icosphere(0), pgcp.read_mesh("one.ply"), pgcp.read_mesh("two.ply")
    shift = len(small.vertices)
    both = pgcp.Mesh(np.vstack([small.vertices + 9.0, one.vertices]), np.vstack([small.faces, one.faces + shift]))
    pgcp.write_mesh("both.ply", both)
    np.savetxt("both.txt", both.vertices[:, 2])
    words = ["transfer", "both.ply", "two.ply", "--values", "both.txt", "--patches", "1", "--quiet", "-o", "it.npz"]
    assert main([*words, "-o", "it.csv"]) == 0
    with np.load("it.npz") as data:
        assert np.array_equal(data["a_vertices"], np.arange(shift, len(both.vertices)))
        places = np.einsum("nk,nkd->nd", data["b_weights"], both.vertices[data["b_corners"]])
        assert np.allclose(places, data["b_points"])
        assert np.array_equal(both.faces[data["b_faces"]], data["b_corners"])
        assert np.linalg.norm(elsewhere(places) - two.vertices, axis=1).max() < edges(two).mean()
        assert np.allclose(data["on_b_value"], places[:, 2])
    assert np.array_equal(np.genfromtxt("it.csv", delimiter=",", names=True)["vertex"], np.arange(shift, len(both.vertices)))
    some = np.arange(0, 162, 20)
    pairs = np.column_stack([some + shift, nearest(elsewhere(one.vertices[some]), two.vertices)])
    np.savetxt("pairs.txt", pairs, "%d")
    assert main([*words, "--landmarks", "pairs.txt"]) == 0
    np.savetxt("pairs.txt", [*pairs, [3, 299]], "%d")
    capsys.readouterr()
    assert main([*words, "--landmarks", "pairs.txt"]) == 2
    assert "is a landmark, but no face that is mapped has it" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "target", "most"), [("closed/max_planck", "sphere", 0.2), ("open/max_planck_disk", "disk", 0.2)]
)
def test_a_real_surface_decimated_and_turned_corresponds_to_itself(name, target, most):
    pyvista = pytest.importorskip("pyvista")
    if not (SHARED / f"{name}.ply").exists():
        pytest.skip("needs the shared meshes")
    whole = pgcp.read_mesh(SHARED / f"{name}.ply")
    corners = np.column_stack([np.full(len(whole.faces), 3), whole.faces]).ravel()
    few = pyvista.PolyData(whole.vertices, corners).decimate(0.4)
    turned = pgcp.Mesh(elsewhere(np.asarray(few.points, float)), few.regular_faces.copy())
    found = matched(*(pgcp.compute(mesh, pgcp.Options(target=target)) for mesh in (whole, turned)))
    away = np.linalg.norm(found.on_b.points - elsewhere(whole.vertices), axis=1) / (2.0 * edges(whole).mean())
    assert away.mean() < most
    assert np.quantile(away, 0.95) < 2.0 * most
