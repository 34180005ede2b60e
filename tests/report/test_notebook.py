"""Results in notebooks: the frame with the report page, and the notebook of the documentation, which is run."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from browser import headless
from meshes import grid, lifted, spheroid
from PIL import Image

import pgcp
from pgcp.report.notebook import LIGHT_FACES
from pgcp.report.page import page

NOTEBOOK = Path(__file__).resolve().parents[2] / "docs" / "notebook.ipynb"
BLUE, CREAM = (51, 97, 158), (250, 240, 214)


@pytest.fixture(scope="module")
def plane():
    return pgcp.parameterize(lifted(grid(24)), patches=2)


@pytest.fixture(scope="module")
def ball():
    return pgcp.parameterize(spheroid(3, 1.5)[0], patches=2, target="sphere")


@pytest.fixture(scope="module")
def browser():
    with headless() as found:
        yield found


def inside(html):
    """The page in a frame."""
    return unescape(re.search(r'srcdoc="([^"]*)"', html)[1])


def test_a_result_and_its_plot_are_frames_with_the_page(plane, ball):
    for result in (plane, ball):
        assert result._repr_html_().startswith("<pre>pgcp.Result of ")
        assert inside(result._repr_html_()) == page(result, most=LIGHT_FACES, is_framed=True).decode()
        assert inside(result.plot()._repr_html_()) == page(result, is_framed=True).decode()
        assert 'class="framed"' in inside(result.plot()._repr_html_())
        assert 'class="framed"' not in result.page()
    assert "height: 400px" in plane.plot(height=400)._repr_html_()
    assert "Drawn with " in inside(plane.plot(faces=300)._repr_html_())


def test_a_frame_is_light():
    mesh = grid(225)
    few = pgcp.parameterize(grid(4), patches=1)
    patch, mu = np.zeros(len(mesh.faces), int), np.zeros(len(mesh.faces), complex)
    result = replace(few, mesh=mesh, coordinates=mesh.vertices[:, :2].copy(), patch=patch, mu=mu)
    assert len(result._repr_html_()) < 700_000
    assert len(result._repr_html_()) < len(result.plot()._repr_html_())


def test_a_plot_is_a_line_in_a_terminal_and_opens_nothing(plane, monkeypatch):
    monkeypatch.setattr("webbrowser.open", lambda *_: pytest.fail("a browser was opened"))
    assert repr(plane.plot()) == "plot of hills for a notebook; the result's page() and picture() are for files"


def test_names_are_escaped(plane):
    nasty = 'a "><script>alert(1)</script> & b'
    html = replace(plane, mesh=replace(plane.mesh, name=nasty))._repr_html_()
    assert "<script>alert" not in html.replace(re.search(r'srcdoc="[^"]*"', html)[0], "")
    assert html.count("<iframe") == html.count("</iframe>") == 1
    assert "<script>alert" not in inside(html)


def test_what_cannot_be_drawn_is_refused(plane):
    with pytest.raises(pgcp.InputError, match="faces is 0, it must be 1 or more"):
        plane.plot(faces=0)
    with pytest.raises(pgcp.InputError, match="height is 10, it must be from 200 to 4000 pixels"):
        plane.plot(height=10)


def shown(browser, html, folder):
    """Pixels of both views in the first frame of a page with this HTML, offline, and what the browser complained of."""
    (folder / "cell.html").write_text(f"<!DOCTYPE html><body style='width: 950px'>{html}</body>")
    context = browser.new_context(viewport={"width": 1000, "height": 900}, offline=True)
    tab, said = context.new_page(), []
    tab.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
    tab.on("pageerror", lambda problem: said.append(str(problem)))
    tab.on(
        "request",
        lambda request: said.append(request.url) if not request.url.startswith(("file:", "data:", "about:")) else None,
    )
    try:
        tab.goto((folder / "cell.html").as_uri())
        frame = tab.frames[1]
        ready = "document.body.dataset.ready || !document.getElementById('no-views').hidden"
        frame.wait_for_function(ready, timeout=60_000)
        images = []
        for view in ("#surface", "#map"):
            data = frame.locator(view).screenshot()
            images.append(np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int))
        box = frame.locator("#surface").bounding_box()
        tab.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        tab.mouse.down()
        tab.mouse.move(box["x"] + box["width"] / 2 + 90, box["y"] + box["height"] / 2, steps=4)
        tab.mouse.up()
        tab.mouse.move(2, 2)
        tab.wait_for_timeout(200)
        data = frame.locator("#surface").screenshot()
        images.append(np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int))
        return images, said
    finally:
        context.close()


def share(image, colour):
    """How much of an image has about this colour."""
    return float((np.abs(image - np.array(colour)).max(axis=-1) < 60).mean())


@pytest.mark.parametrize("kind", ["plane", "ball"])
def test_a_browser_draws_both_views_in_the_frame_and_turns_the_surface(kind, request, browser, tmp_path):
    (surface, image, turned), said = shown(browser, request.getfixturevalue(kind)._repr_html_(), tmp_path)
    for view in (surface, image):
        assert share(view, BLUE) > 0.05
        assert share(view, CREAM) > 0.05
    assert np.abs(turned - surface).mean() > 2.0
    assert said == []


def test_the_notebook_of_the_documentation_runs_and_shows_maps(browser, tmp_path):
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    book = nbformat.read(NOTEBOOK, 4)
    code = [cell for cell in book.cells if cell.cell_type == "code"]
    assert all(not cell.outputs and cell.execution_count is None for cell in code)
    nbclient.NotebookClient(book, timeout=120, kernel_name="python3", resources={"metadata": {"path": tmp_path}}).execute()
    framed = [out.data["text/html"] for cell in code for out in cell.outputs if "text/html" in out.get("data", {})]
    assert len(framed) == 2
    assert not [out for cell in code for out in cell.outputs if out.output_type == "error" or out.get("name") == "stderr"]
    (surface, image, _), said = shown(browser, framed[1], tmp_path)
    assert share(surface, BLUE) > 0.05
    assert share(image, CREAM) > 0.05
    assert said == []
