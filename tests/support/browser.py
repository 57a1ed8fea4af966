"""A headless browser for tests of pages: Debian's chromium, driven by playwright."""

import io
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
import pytest
from PIL import Image

SIZE = (1200, 640)
_SOFTWARE = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


class Page:
    """A page of the server, with the controls found by their labels."""

    def __init__(self, page: Any):
        self.page = page
        self.errors: list[str] = []
        self.outside: list[str] = []
        page.set_default_timeout(60_000)
        page.on("console", lambda m: self.errors.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda e: self.errors.append(str(e)))
        page.on("request", lambda r: self._note(r.url))

    def _note(self, url: str) -> None:
        if not url.startswith(
            ("http://localhost:", "http://127.0.0.1:", "data:", "blob:", "file:")
        ):
            self.outside.append(url)

    def picture(self, left: int = 0, right: int = SIZE[0]) -> np.ndarray:
        """Return what the page shows between two columns, uint8 [h, w, 3]."""
        clip = {"x": left, "y": 0, "width": right - left, "height": SIZE[1]}
        with Image.open(io.BytesIO(self.page.screenshot(clip=clip, timeout=60_000))) as image:
            return np.asarray(image.convert("RGB"))

    def settled(self, left: int = 0, right: int = SIZE[0]) -> np.ndarray:
        """Return what the page shows once it has stopped to change."""
        before = self.picture(left, right)
        for _ in range(40):
            time.sleep(0.5)
            now = self.picture(left, right)
            if changed(before, now) < 1e-3:
                return now
            before = now
        raise AssertionError("the page never comes to rest")

    def tab(self, name: str) -> None:
        self.page.get_by_role("tab", name=name).click()

    def click(self, name: str) -> None:
        self.page.get_by_role("button", name=name, exact=True).click()

    def check(self, label: str) -> None:
        self._after(label, '@type="checkbox"').click()

    def fill(self, label: str, value: object) -> None:
        """Type into the field of a label, and leave it."""
        field = self._after(label, 'not(@type="hidden")')
        field.fill(str(value))
        field.press("Enter")

    def choose(self, label: str, value: str) -> None:
        """Choose from a list."""
        self._after(label, 'not(@type="hidden")').click()
        self.page.get_by_role("option", name=value, exact=True).click()

    def waits_for(self, text: str, timeout_s: float = 60.0) -> None:
        """Wait until the page says a text."""
        self.page.get_by_text(text).first.wait_for(timeout=1000 * timeout_s)

    def _after(self, label: str, kind: str) -> Any:
        named = self.page.get_by_text(label, exact=True).first
        return named.locator(f"xpath=following::input[{kind}][1]")


@contextmanager
def opened(url: str, *, offline: bool = False) -> Iterator[Page]:
    """Open a page; the test is skipped where there is no browser.

    Args:
        url: of the page.
        offline: no network, for a page that is a file.
    """
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("there is no chromium: apt-get install chromium")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=[*_SOFTWARE])
        try:
            size = {"width": SIZE[0], "height": SIZE[1]}
            page = Page(browser.new_context(offline=offline, viewport=size).new_page())
            page.page.goto(url)
            page.page.wait_for_selector("canvas")
            if offline:
                yield page
                return
            # The note that there is no GPU lies over the picture, and takes the mouse.
            with suppress(sync_api.TimeoutError):
                note = page.page.get_by_role("alert").filter(has_text="Software WebGL")
                note.get_by_role("button").click(timeout=20_000)
                note.wait_for(state="hidden")
            yield page
        finally:
            browser.close()


def changed(a: np.ndarray, b: np.ndarray) -> float:
    """Return the share of pixels that differ between two pictures."""
    return float(np.mean(np.abs(a.astype(int) - b).max(axis=2) > 24))
