"""A headless browser for tests of pages, where there is one."""

from __future__ import annotations

import contextlib
import shutil

import pytest

_NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
_OPTIONS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]


@contextlib.contextmanager
def headless():
    """A browser that draws without a graphics card; skips where there is none."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="the package playwright is not installed")
    program = next(filter(None, map(shutil.which, _NAMES)), None)
    if program is None:
        pytest.skip("there is no Chromium: apt-get install chromium-headless-shell")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=_OPTIONS)
        try:
            yield browser
        finally:
            browser.close()


@contextlib.contextmanager
def opened(browser, path, scheme="light"):
    """A page of a file, drawn; its attribute ``said`` has errors and requests beyond the file."""
    context = browser.new_context(viewport={"width": 1200, "height": 900}, color_scheme=scheme, offline=True)
    page = context.new_page()
    page.said = []
    page.on("console", lambda message: page.said.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda problem: page.said.append(str(problem)))
    page.on("dialog", lambda dialog: page.said.append(dialog.message))
    page.on(
        "request", lambda request: page.said.append(request.url) if not request.url.startswith(("file:", "data:")) else None
    )
    page.goto(path.as_uri())
    page.wait_for_function("document.body.dataset.ready || !document.getElementById('no-views').hidden", timeout=60_000)
    try:
        yield page
    finally:
        context.close()
