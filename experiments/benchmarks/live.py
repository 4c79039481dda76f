"""Headless Chromium on the page of `periscopy view` and `watch`.

It needs Playwright and a Chromium of the system's (Debian: chromium). On a machine without a GPU
the browser draws in software, and takes its part of the cores.
"""

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread
from typing import Any

import numpy as np

import periscopy_sim as ps
from periscopy_sim.live.session import LiveSession

PATIENCE = 120.0
CHROMIUM = "chromium-headless-shell", "chromium", "chromium-browser"
SOFTWARE_GL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")

COUNT = """() => {
    window.pictures = 0;
    new MutationObserver(() => window.pictures++).observe(
        document.querySelector("#panels img"), {attributes: true, attributeFilter: ["src"]});
}"""
"""Counts the pictures on the page, in its own language."""


@contextmanager
def chromium() -> Iterator[Any]:
    """Open a headless Chromium; a PeriscopyError says what is missing."""
    program = next(filter(None, map(shutil.which, CHROMIUM)), None)
    try:
        from playwright.sync_api import sync_playwright
    except ModuleNotFoundError:
        raise ps.PeriscopyError("this needs Playwright: pip install playwright") from None
    if program is None:
        raise ps.PeriscopyError("this needs Chromium (Debian: apt-get install chromium)")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=list(SOFTWARE_GL))
        yield browser
        browser.close()


@contextmanager
def running(session: LiveSession) -> Iterator[None]:
    """Run a session in a thread of its own; at the end nothing of that is left."""
    thread = Thread(target=session.run)
    thread.start()
    try:
        yield
    finally:
        session.stop()
        thread.join(60)
        if thread.is_alive():
            raise RuntimeError("the session did not stop")


def visit(session: LiveSession, browser: Any, requests: list[str] | None = None) -> Any:
    """Open the page, and wait for its full pictures; what it asks the network for is noted."""
    page = browser.new_page(viewport={"width": 1200, "height": 800})
    page.set_default_timeout(1000 * PATIENCE)
    if requests is not None:
        page.on("request", lambda request: requests.append(request.url))
        page.on("websocket", lambda websocket: requests.append(websocket.url))
    page.goto(session.gate.url)
    page.get_by_text("full pictures").wait_for()
    page.wait_for_timeout(2000)  # the scene's first frames
    return page


def drag(session: LiveSession, page: Any, name: str, seconds: float) -> None:
    """Drag a handle to and fro along x for some seconds, and let it go 4 cm away."""
    at = session.handles[name].position(session.choice.values)
    arrow = page.evaluate("state.room.arrow")
    start, end = (
        np.array(page.evaluate("onScreen", [at[0] + 0.75 * arrow + dx, *at[1:]]))
        for dx in (0, 0.04)
    )
    page.mouse.move(*start)
    page.wait_for_timeout(300)
    page.mouse.down()
    begun = time.monotonic()
    while (now := time.monotonic() - begun) < seconds:
        page.mouse.move(*(start + np.sin(now) * (end - start)))
        time.sleep(0.02)
    page.mouse.move(*end)
    page.mouse.up()
