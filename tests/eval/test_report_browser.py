"""The report in a real browser, headless Chromium: `pip install playwright` and the Debian package chromium."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pmc_sampler.eval import benchmark, images, report, results, suite

pytestmark = [
    pytest.mark.long,
    pytest.mark.needs("playwright", "chromium", "skimage", "pyarrow", "tomli_w", "OpenImageIO", "jinja2", "matplotlib"),
]

GIVEN: dict[str, Any] = {
    "name": "test",
    "about": "A scene that costs nothing.",
    "size": [40, 36],
    "spp": [4, 8],
    "seeds": 2,
    "renderer": "noisy",
    "reference_spp": 64,
    "baseline": "PT",
    "scene": [{"name": "diffuse"}],
    "method": [{"name": "PT", "sampler": "uniform"}, {"name": "PMC", "sampler": "pmc", "moves": 1}],
}


@pytest.fixture(params=[1400, 390])
def shown(request: pytest.FixtureRequest, require: Any, noisy: type, tmp_path: Path) -> Iterator[Any]:
    """The page in a window so wide, after which nothing was logged and nothing but the file was asked for."""
    from playwright.sync_api import sync_playwright

    hooks = benchmark.Renderers(lambda renderer, scene, *, sampler, size: noisy(*size), lambda renderer: "1")
    benchmark.run(suite.parse(GIVEN), results.Folder(tmp_path / "out"), hooks, cache=tmp_path / "cache")
    url = report.write(results.load(tmp_path / "out")).as_uri()
    with sync_playwright() as play:
        browser = play.chromium.launch(
            executable_path=require("chromium"), args=["--no-sandbox", "--disable-dev-shm-usage"]
        )
        page = browser.new_page(viewport={"width": request.param, "height": 900})
        said: list[str] = []
        asked: list[str] = []
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda sent: asked.append(sent.url))
        page.goto(url)
        page.wait_for_selector(".book[data-ready=true]")
        yield page
        assert said == []
        assert [one for one in asked if not one.startswith("data:")] == [url]
        browser.close()


def pixels(page: Any) -> str:
    return str(page.evaluate("document.querySelector('canvas').toDataURL()"))


def test_the_flip_book_works(shown: Any) -> None:
    canvas = shown.locator("canvas")
    states = [pixels(shown)]

    def changed() -> None:
        states.append(pixels(shown))
        assert states[-1] != states[-2]

    shown.locator(".right").select_option(label="PMC")
    changed()
    assert canvas.get_attribute("aria-label") == "diffuse: reference left, PMC right"
    shown.locator(".wipe").fill("20")
    changed()
    shown.locator(".exposure").fill("2")
    changed()
    assert shown.locator("output").text_content() == "2 EV"
    shown.get_by_label("Zoom in").click()
    changed()
    assert canvas.get_attribute("data-zoom") == "2"
    canvas.focus()
    for key, zoom in (("+", "4"), ("ArrowLeft", "4"), ("-", "2"), ("0", "1"), (" ", "1")):
        canvas.press(key)
        changed()
        assert canvas.get_attribute("data-zoom") == zoom
    assert canvas.get_attribute("aria-label") == "diffuse: PMC left, reference right"


def test_a_pixel_can_be_read(shown: Any, tmp_path: Path) -> None:
    """It is that of the reference's file within a step of the flip-book's eight bits; the other's is there, too."""
    shown.locator(".right").select_option(label="tvi error of PT")
    shown.locator("canvas").hover(position={"x": 2, "y": 2})
    said = shown.locator(".readout").text_content()
    start = r"Pixel \(0, 0\), linear RGB or tvi error\. reference: "
    read = re.fullmatch(start + r"([^;]+); tvi error of PT: [\d.e+-]+\.", said)
    assert read is not None, said
    reference = images.read(tmp_path / "out" / "images" / "diffuse" / "reference.exr").rgb
    np.testing.assert_allclose([float(value) for value in read[1].split(", ")], reference[0, 0], rtol=0.05)


def test_nothing_is_wider_than_the_window(shown: Any) -> None:
    shown.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    assert shown.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    images = shown.evaluate("[...document.images].map((one) => one.complete && one.naturalWidth > 0)")
    assert images
    assert all(images)
    if shown.viewport_size["width"] < 400:
        assert shown.locator(".scroll.more").count() > 0
