"""A Chromium without a display that stays open for many pages, spoken to by its DevTools protocol."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import io
import json
import shutil
import subprocess
import time
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np

PROGRAM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
# s that a page may take, and the browser's start
PATIENCE = 120.0


class Browser:
    """One window; `with Browser(folder) as browser`. The folder is for the browser's profile."""

    def __init__(self, folder: Path, size: tuple[int, int] = (800, 600)) -> None:
        if PROGRAM is None:
            raise RuntimeError("no Chromium found")
        self._loop = asyncio.new_event_loop()
        self._last = 0
        port = folder / "DevToolsActivePort"
        port.unlink(missing_ok=True)
        command = [PROGRAM, *FLAGS, "--remote-debugging-port=0", f"--user-data-dir={folder}", "about:blank"]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            deadline = time.monotonic() + PATIENCE
            while not (port.is_file() and port.read_text().count("\n")):
                if self._process.poll() is not None or time.monotonic() > deadline:
                    raise RuntimeError("Chromium did not start")
                time.sleep(0.05)
            address = f"http://127.0.0.1:{port.read_text().split()[0]}/json/list"
            with urllib.request.urlopen(address, timeout=PATIENCE) as answer:
                (target,) = [entry for entry in json.load(answer) if entry["type"] == "page"]
            self._socket = self._loop.run_until_complete(self._connect(target["webSocketDebuggerUrl"]))
            self.resize(*size)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(10.0)
        self._process.kill()
        self._process.wait()
        self._loop.close()

    async def _connect(self, address: str) -> Any:
        # meshcat brings Tornado
        from tornado.websocket import websocket_connect

        return await websocket_connect(address, max_message_size=1 << 28)

    async def _ask(self, method: str, arguments: dict[str, Any]) -> dict[str, Any]:
        self._last += 1
        await self._socket.write_message(json.dumps({"id": self._last, "method": method, "params": arguments}))
        while True:
            message = await asyncio.wait_for(self._socket.read_message(), PATIENCE)
            if message is None:
                raise RuntimeError("Chromium has gone")
            answer = json.loads(message)
            if answer.get("id") == self._last:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return dict(answer["result"])

    def call(self, method: str, **arguments: Any) -> dict[str, Any]:
        """A command of the DevTools protocol, and what it returns."""
        return self._loop.run_until_complete(self._ask(method, arguments))

    def resize(self, width: int, height: int, touch: bool = False) -> None:
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=touch)
        self.call("Emulation.setTouchEmulationEnabled", enabled=touch)

    def open(self, page: Path, anchor: str = "", listen: bool = True) -> None:
        """Open a replay and wait until it has drawn everything; `said` then collects what goes to the console."""
        if listen:
            script = (
                "window.said = []; for (const kind of ['warn', 'error']) console[kind] = (...words) => "
                "said.push(words.join(' ')); window.addEventListener('error', (event) => said.push(event.message));"
            )
            self.call("Page.enable")
            self.call("Page.addScriptToEvaluateOnNewDocument", source=script)
        # a page that differs in its anchor only would not be loaded again
        self.call("Page.navigate", url="about:blank")
        self.call("Page.navigate", url=page.as_uri() + anchor)
        deadline = time.monotonic() + PATIENCE
        while not self.run("location.protocol === 'file:' && document.readyState === 'complete'"):
            if time.monotonic() > deadline:
                raise TimeoutError(f"{page} is not loaded after {PATIENCE} s")
            time.sleep(0.05)
        # everything unpacked, and two pictures later
        self.run("ready.then(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))))")

    def run(self, script: str) -> Any:
        """The value of an expression in the page, or what its promise brings."""
        answer = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(answer["exceptionDetails"].get("exception", {}).get("description", str(answer)))
        return answer["result"].get("value")

    def press(self, x: float, y: float, *way: tuple[float, float]) -> None:
        """Press the mouse there, and let go, after a way if there is one."""
        button = {"button": "left", "buttons": 1, "clickCount": 1}
        self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
        self.call("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, **button)
        for x, y in way:
            self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y, button="left", buttons=1)
        self.call("Input.dispatchMouseEvent", type="mouseReleased", x=x, y=y, **button)

    def picture(self) -> np.ndarray:
        """(height, width, 3) what the window shows."""
        from PIL import Image

        data = self.call("Page.captureScreenshot", format="png")["data"]
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"), dtype=int)
