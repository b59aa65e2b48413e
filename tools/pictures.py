"""Remake the pictures of docs/ that commands of this package make: all of them, or those that are named.

    python tools/pictures.py descent view

The report's page and the viewer are pictures of Chromium, and the viewer needs the extra `view`; Wireshark needs Xvfb,
xdotool and ImageMagick. foxglove.png is taken by hand; hazards.png, landings.png, navigate.png and their dark variants
are made by the commands beside them in docs/.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "support"))
LIDAR_EMU = Path(sys.executable).parent / "lidar-emu"
DARK = "--blink-settings=preferredColorScheme=0"
VIEWER_PORT = 9790
TIME_BAR = (540, 843)
"""Place of about 20 s in the viewer's bar of time, in a window of 1400 by 1000 pixels with its frame."""
LOADED_PIXELS, DRAWN_S = 100, 15.0


def lidar_emu(*arguments: str, folder: Path) -> None:
    """Run a command in a folder."""
    subprocess.run([LIDAR_EMU, *arguments], cwd=folder, check=True, stdout=subprocess.DEVNULL)


def plot(*paths: Path, folder: Path, command: str) -> None:
    """Run a command once, whose last option names a picture: light and dark ones show the same figures."""
    *words, option = command.split()
    lidar_emu(*words, *(f"{option}={path}" for path in paths), folder=folder)


def record(folder: Path) -> None:
    """Record the flight that the report and the viewer show."""
    lidar_emu("run", "powered_descent.yaml", "--pace", "max", "--record", "flight.mcap", folder=folder)


def report(*paths: Path, folder: Path) -> None:
    """Take pictures of the upper part of a report's page."""
    record(folder)
    lidar_emu("report", "flight.mcap", "--html", "flight.html", folder=folder)
    browser = ("chromium", "--headless", "--no-sandbox", "--hide-scrollbars", "--window-size=1000,2220")
    page = (folder / "flight.html").as_uri()
    for path in paths:
        theme = [DARK] if path.stem.endswith("-dark") else []
        command = [*browser, *theme, f"--user-data-dir={folder / 'profile'}", f"--screenshot={path}", page]
        subprocess.run(command, check=True, stderr=subprocess.DEVNULL)


def view(path: Path, folder: Path) -> None:
    """Take a picture of the viewer in flight."""
    import numpy as np
    from browser import browser
    from PIL import Image

    from lidar_emu.viewer.layouts import PATH_RGB

    record(folder)
    command = [LIDAR_EMU, "view", "flight.mcap", "--web", "--port", str(VIEWER_PORT)]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            url, _, _ = process.stdout.readline().partition(",")
            with browser(url, folder / "profile", DARK, "--window-size=1400,1000") as page:
                while (np.abs(page.picture() - np.array(PATH_RGB)).sum(axis=2) < 30).sum() < LOADED_PIXELS:
                    time.sleep(1.0)
                page.click(*TIME_BAR)
                time.sleep(DRAWN_S)  # software WebGL draws a few frames a second
                Image.fromarray(page.picture()).save(path, optimize=True)
        finally:
            process.send_signal(signal.SIGINT)


def wireshark(path: Path, folder: Path) -> None:
    """Take a picture of Wireshark with the fields of a shot."""
    record(folder)
    lidar_emu("report", "flight.mcap", "--out", "flight.pcap", folder=folder)
    lidar_emu("icd", "--out", ".", folder=folder)
    screen = ("xvfb-run", "-a", "-s", "-screen 0 1500x900x24")
    command = [*screen, str(ROOT / "tools" / "wireshark.sh"), "flight.pcap", "lidar.lua", str(path)]
    subprocess.run(command, cwd=folder, check=True, stderr=subprocess.DEVNULL)


PICTURES: dict[str, Callable[..., None]] = {
    "descent": partial(plot, command="simulate descent.yaml --plot"),
    "objects": partial(plot, command="simulate obstacles.yaml --plot"),
    "survey": partial(plot, command="ground descent.yaml --plot"),
    "ground": partial(plot, command="ground descent.yaml --set site=cratered --statistics"),
    "campaign": partial(plot, command="campaign dispersed_descent.yaml --out results --plot"),
    "sensitivity": partial(
        plot, command="campaign dispersed_descent.yaml --out sources --sensitivity --runs 3584 --plot"
    ),
    "levels": partial(plot, command="bench accuracy descent.yaml --plot"),
    "report": report,
    "view": view,
    "wireshark": wireshark,
}
WITH_DARK = {"descent", "objects", "survey", "ground", "campaign", "sensitivity", "levels", "report"}


def main(names: list[str]) -> int:
    """Remake the named pictures, or all; returns the exit code."""
    if unknown := set(names) - set(PICTURES):
        print(f"{', '.join(sorted(unknown))}: must be among {', '.join(PICTURES)}", file=sys.stderr)
        return 2
    chosen = names or list(PICTURES)
    for name in chosen:
        paths = [ROOT / "docs" / f"{stem}.png" for stem in (name, f"{name}-dark")[: 1 + (name in WITH_DARK)]]
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            PICTURES[name](*paths, folder=Path(folder))
        for path in paths:
            print(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1e3:.0f} kB", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
