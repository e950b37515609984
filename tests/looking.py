"""Look at what a person sees: rerun and Chromium without a screen."""

import base64
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, Any

from rerun.experimental import ViewerClient
from websockets.sync.client import ClientConnection, connect

SETTLING = 1.5  # s, until a view has drawn what it was told
PATIENCE = 30.0  # s


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextmanager
def headless_viewer(recording: Path, size: tuple[int, int] = (1600, 1000)) -> Iterator[ViewerClient]:
    """Rerun with a recording open, on a free port of this machine alone.

    Raises:
        RuntimeError: it does not start; with what it said last.
    """
    port = free_port()
    with tempfile.TemporaryDirectory() as scratch, tempfile.TemporaryFile("w+") as log:
        command = [sys.executable, "-m", "rerun", "--headless", "--bind", "127.0.0.1", "--port", str(port)]
        command += ["--window-size", f"{size[0]}x{size[1]}"]
        # `rerun` is a wrapper: ending it alone would leave the viewer running.
        process = subprocess.Popen(
            command,
            env=os.environ | {"XDG_RUNTIME_DIR": scratch, "HOME": scratch},
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
        try:
            _wait_for_port(port, process, log)
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            client.open(str(recording.resolve()))
            until = time.monotonic() + PATIENCE
            while client.get_state().loading and time.monotonic() < until:
                time.sleep(0.1)
            time.sleep(SETTLING)
            yield client
        finally:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait(timeout=10)


def _wait_for_port(port: int, process: subprocess.Popen[bytes], log: IO[str]) -> None:
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        if process.poll() is not None:
            break
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.1)
    log.seek(0)
    raise RuntimeError(f"rerun did not start: {log.read()[-500:]}")


@dataclass(frozen=True)
class Browsed:
    """What Chromium saw of a page.

    Attributes:
        complaints: of its console. requests: addresses that the page asked the network for.
        width: that the page needs [pixels].
    """

    complaints: list[str]
    requests: list[str]
    width: int


def browse(page: Path, picture: Path, size: tuple[int, int] = (1100, 900), dark: bool = False) -> Browsed:
    """Open a page in Chromium without a screen, with a window of a size, and take a picture of all of it.

    Raises:
        RuntimeError: Chromium does not start, or the page does not set `data-drawn` of its body at its end.
    """
    with browser() as visit:
        return visit(page, picture, size, dark)


@contextmanager
def browser() -> Iterator[Callable[..., Browsed]]:
    """Chromium without a screen, for several pages one after another; yields what is called as `browse` is.

    Raises:
        RuntimeError: it does not start.
    """
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = ["chromium", "--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run"]
        command += [
            "--hide-scrollbars",
            "--remote-debugging-port=0",
            f"--user-data-dir={profile}",
            "about:blank",
        ]
        process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
        try:
            with connect(_page_address(Path(profile), process), max_size=None) as socket_:
                yield partial(_visit, _Tab(socket_))
        finally:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait(timeout=10)


class _Tab:
    """A page's end of the DevTools protocol; events are kept."""

    def __init__(self, socket_: ClientConnection):
        self.socket, self.count, self.events = socket_, 0, []

    def __call__(self, method: str, **parameters: Any) -> dict[str, Any]:
        self.count += 1
        self.socket.send(json.dumps({"id": self.count, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self.socket.recv(timeout=PATIENCE))
            if answer.get("id") == self.count:
                return answer["result"]
            self.events.append(answer)

    def evaluate(self, expression: str) -> Any:
        return self("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")


def _visit(tab: _Tab, page: Path, picture: Path, size: tuple[int, int], dark: bool = False) -> Browsed:
    tab("Page.navigate", url="about:blank")
    tab.events.clear()
    for domain in ("Page", "Runtime", "Log", "Network"):
        tab(f"{domain}.enable")
    metrics = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": size[0] < 600}
    tab("Emulation.setDeviceMetricsOverride", **metrics)
    scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
    tab("Emulation.setEmulatedMedia", features=[scheme])
    address = page.resolve().as_uri()
    tab("Page.navigate", url=address)
    until = time.monotonic() + PATIENCE
    while not tab.evaluate("document.body && document.body.dataset.drawn"):
        if time.monotonic() > until:
            raise RuntimeError(f"{page}: not ready after {PATIENCE:.0f} s")
        time.sleep(0.2)
    time.sleep(0.5)
    shot = tab("Page.captureScreenshot", captureBeyondViewport=True)
    picture.write_bytes(base64.b64decode(shot["data"]))
    width = int(tab.evaluate("document.documentElement.scrollWidth"))
    asked = [e["params"]["request"]["url"] for e in tab.events if e["method"] == "Network.requestWillBeSent"]
    complaints = [
        json.dumps(e["params"])[:300]
        for e in tab.events
        if e["method"] in ("Runtime.exceptionThrown", "Log.entryAdded", "Runtime.consoleAPICalled")
    ]
    outside = [url for url in asked if url != address and not url.startswith("data:")]
    return Browsed(complaints, outside, width)


def _page_address(profile: Path, browser: subprocess.Popen[bytes]) -> str:
    """Of the page's DevTools socket."""
    port, until = profile / "DevToolsActivePort", time.monotonic() + PATIENCE
    while time.monotonic() < until and browser.poll() is None:
        if port.exists() and (lines := port.read_text().splitlines()):
            with urllib.request.urlopen(f"http://127.0.0.1:{lines[0]}/json/list") as answer:
                pages = [target for target in json.load(answer) if target["type"] == "page"]
            if pages:
                return pages[0]["webSocketDebuggerUrl"]
        time.sleep(0.1)
    raise RuntimeError("chromium did not start")
