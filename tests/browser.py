"""A headless Chromium with WebGL, driven by its own protocol."""

from __future__ import annotations

import base64
import io
import json
import shutil
import subprocess
import tempfile
import time
import urllib.request
from pathlib import Path

import numpy as np

SIZE = (900, 600)  # of its window
PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = (
    "--headless", "--no-sandbox", "--no-first-run", "--disable-background-networking", "--hide-scrollbars",
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--remote-debugging-port=0",
)  # fmt: skip


class Browser:
    """One page. requests: the addresses of all it asked for."""

    def __init__(self, url: str):
        from websockets.sync.client import connect

        self.requests: list[str] = []
        self._folder, self._number = tempfile.TemporaryDirectory(ignore_cleanup_errors=True), 0
        self._process = subprocess.Popen(
            [PROGRAM, *FLAGS, f"--user-data-dir={self._folder.name}", f"--window-size={SIZE[0]},{SIZE[1]}",
             "about:blank"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            self._socket = connect(self.until(self._page), max_size=None, ping_interval=None)
            for domain in ("Network", "Page", "Runtime"):
                self.call(f"{domain}.enable")
            self.call("Page.navigate", url=url)
        except BaseException:
            self._process.kill()
            raise

    def _page(self) -> str | None:
        """The address of the page's protocol; None while there is none."""
        port_file = Path(self._folder.name) / "DevToolsActivePort"
        if not port_file.exists() or "\n" not in port_file.read_text():
            return None
        port = port_file.read_text().splitlines()[0]
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list") as answer:
            pages = [one["webSocketDebuggerUrl"] for one in json.load(answer) if one["type"] == "page"]
        return pages[0] if pages else None

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_):
        self._socket.close()
        self._process.kill()
        self._process.wait()
        self._folder.cleanup()

    def call(self, method: str, **params) -> dict:
        """The answer of the page to a call of its protocol."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": params}))
        while True:
            message = json.loads(self._socket.recv(timeout=60))
            if message.get("method") == "Network.requestWillBeSent":
                self.requests.append(message["params"]["request"]["url"])
            if message.get("method") == "Network.webSocketCreated":
                self.requests.append(message["params"]["url"])
            if message.get("id") == self._number:
                assert "error" not in message, message
                return message["result"]

    def run(self, script: str):
        """The value of an expression in the page."""
        return self.call("Runtime.evaluate", expression=script, returnByValue=True)["result"].get("value")

    def picture(self) -> np.ndarray:
        """What the page shows, (H, W, 3) uint8."""
        from PIL import Image

        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.array(Image.open(io.BytesIO(data)).convert("RGB"))

    @staticmethod
    def until(done, seconds: float = 60):
        """Waits until done() is true, and returns it. Raises TimeoutError."""
        end = time.monotonic() + seconds
        while not (found := done()):
            if time.monotonic() > end:
                raise TimeoutError
            time.sleep(0.1)
        return found
