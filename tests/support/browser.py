"""A headless Chromium with software WebGL, and pictures of what it shows."""

from __future__ import annotations

import asyncio
import base64
import io
import json
import shutil
import subprocess
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from tornado.websocket import websocket_connect
from waiting import LIMIT_S, eventually

PROGRAM = shutil.which("chromium")
_OPTIONS = [
    "--headless=new",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--hide-scrollbars",
    "--window-size=1400,800",
    "--remote-debugging-port=0",
]


class Browser:
    """A page in a browser."""

    def __init__(self, socket_url: str) -> None:
        self._socket_url = socket_url

    def picture(self) -> np.ndarray[Any, Any]:
        """(rows, columns, 3) What the page shows."""
        from PIL import Image

        encoded = asyncio.run(self._ask("Page.captureScreenshot"))["data"]
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(encoded))).convert("RGB"))

    def click(self, x: int, y: int) -> None:
        """Press and release the left button at a place of the page."""
        for what in ("mouseMoved", "mousePressed", "mouseReleased"):
            place = {"type": what, "x": x, "y": y, "button": "left", "clickCount": 1}
            asyncio.run(self._ask("Input.dispatchMouseEvent", **place))

    async def _ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        socket = await websocket_connect(self._socket_url, max_message_size=1 << 28)
        await socket.write_message(json.dumps({"id": 1, "method": method, "params": parameters}))
        while (answer := json.loads(await socket.read_message() or "{}")).get("id") != 1:
            pass
        socket.close()
        # Until the browser has closed it, too: the end of the loop would leave it open.
        while await socket.read_message() is not None:
            pass
        return dict(answer["result"])


@contextmanager
def browser(url: str, folder: Path, *options: str) -> Iterator[Browser]:
    """A browser that shows a page, with its profile in a folder, and with further options."""
    assert PROGRAM is not None
    command = [PROGRAM, *_OPTIONS, *options, f"--user-data-dir={folder}", url]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        try:
            chosen = folder / "DevToolsActivePort"
            eventually(lambda: chosen.is_file() and chosen.read_text().count("\n") >= 1)
            port = chosen.read_text().split("\n")[0]
            yield Browser(eventually(lambda: _socket_url(port)))
        finally:
            process.terminate()


def _socket_url(port: str) -> str | None:
    """Address at which the first page is controlled; None before there is one."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=LIMIT_S) as answer:
            targets = json.load(answer)
    except (urllib.error.URLError, ConnectionError):
        return None
    return next((each["webSocketDebuggerUrl"] for each in targets if each["type"] == "page"), None)
