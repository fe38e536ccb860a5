"""Browsers that open a page from a file, without a window and without a network.

Chromium is driven by playwright, Firefox by Mozilla's marionette-driver; both are Debian's. A page
gets scripts as text and gives JSON; what it says on its console, what it asks for and what goes
wrong in it is kept.
"""

from __future__ import annotations

import gc
import json
import shutil
import socket
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import pytest

WIDE, NARROW = (1400, 900), (400, 800)


class Page(Protocol):
    """An open page."""

    def run(self, script: str) -> Any:
        """Value of an expression, awaited, as JSON has it."""


class ChromiumPage:
    """A page of Chromium: `requests`, `console` (kind, text) and `errors` since it was opened."""

    def __init__(self, browser: Any, path: Path, size: tuple[int, int]) -> None:
        self.requests: list[str] = []
        self.console: list[tuple[str, str]] = []
        self.errors: list[str] = []
        width, height = size
        self.page = browser.new_page(viewport={"width": width, "height": height})
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("console", lambda said: self.console.append((said.type, said.text)))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(path.as_uri())
        self.run("ready.then(() => true)")

    def run(self, script: str) -> Any:
        return json.loads(self.page.evaluate(f"(async () => JSON.stringify(await ({script})))()"))

    def wait(self, condition: str) -> None:
        """Until a condition holds; playwright's own way is a script that the page forbids."""
        self.run(
            "new Promise((done) => { const wait = setInterval(() => { "
            f"if ({condition}) {{ clearInterval(wait); done(true); }} }}, 20); }})"
        )


class FirefoxPage:
    """A page of Firefox. Scripts run in the page itself, as marionette's own see no constants."""

    _ASK = """
        const [script, done] = arguments, name = `answer${Math.random()}`;
        addEventListener(name, (event) => done(event.detail), { once: true });
        const made = document.createElement("script");
        made.textContent = `(async () => JSON.stringify(await (${script})))().then(
            (found) => dispatchEvent(new CustomEvent("${name}", { detail: found })),
            (error) => dispatchEvent(new CustomEvent("${name}", { detail: '"' + error + '"' })))`;
        document.body.append(made);
        made.remove();
    """

    def __init__(self, browser: Any, path: Path) -> None:
        self._browser = browser
        browser.navigate(path.as_uri())
        self.run("ready.then(() => true)")

    def run(self, script: str) -> Any:
        return json.loads(self._browser.execute_async_script(self._ASK, script_args=[script]))


@contextmanager
def chromium() -> Iterator[Any]:
    """Debian's Chromium; skips the test where it is not installed."""
    path = shutil.which("chromium")
    if path is None:
        pytest.skip("needs Chromium: apt-get install chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        # Tests run as root in CI, where Chromium has no sandbox.
        browser = driver.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()


@contextmanager
def firefox() -> Iterator[Any]:
    """Debian's Firefox; skips the test where it is not installed."""
    path = shutil.which("firefox-esr")
    if path is None:
        pytest.skip("needs Firefox: apt-get install firefox-esr")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with tempfile.TemporaryDirectory() as folder:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of how it looks for the system
            from marionette_driver.marionette import Marionette

            # A log of its own: an old one is removed, and os.devnull would be, too.
            log = str(Path(folder, "log"))
            browser = Marionette(
                bin=path, headless=True, host="127.0.0.1", port=port, gecko_log=log
            )
        try:
            browser.start_session()
            browser.timeout.script = 300.0
            yield browser
        finally:
            browser.quit()
            browser.cleanup()
            gc.collect()  # sockets that it leaves open are told of here, not in another test
