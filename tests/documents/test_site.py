"""The documentation site: it is built without a warning, has all pages, and asks no other host for anything."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

pytest.importorskip("zensical", reason="make site installs what the site needs")

ROOT = Path(__file__).resolve().parents[2]
CHROMIUM = shutil.which("chromium")
pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("site")]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("documents")
    subprocess.run([sys.executable, ROOT / "tools" / "build_site.py", folder], check=True)
    return folder / "site"


def test_navigation_reaches_every_page(site: Path) -> None:
    listed = set(re.findall(r"[\w/-]+\.md", (ROOT / "docs" / "mkdocs.yml").read_text(encoding="utf-8")))
    pages = {str(path.relative_to(site.parent / "pages")) for path in (site.parent / "pages").rglob("*.md")}
    assert {page for page in pages if not page.startswith("decisions/0")} == listed


def test_every_name_of_the_package_is_documented(site: Path) -> None:
    import lidar_emu

    page = (site / "api.html").read_text(encoding="utf-8")
    documented = set(re.findall(r'id="lidar_emu\.(\w+)"', page))
    assert documented == set(lidar_emu.__all__) - {"__version__"}


@pytest.fixture
def address(site: Path) -> Iterator[str]:
    """The site as a host on this machine serves it."""
    handler = partial(QuietHandler, directory=str(site))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


class QuietHandler(SimpleHTTPRequestHandler):
    """Serves files and prints nothing."""

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing."""


@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine")
@pytest.mark.parametrize("page", ["index.html", "api.html"])
def test_a_browser_asks_no_other_host(page: str, address: str, tmp_path: Path) -> None:
    log = tmp_path / "net.json"
    subprocess.run(
        [
            str(CHROMIUM),
            *("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run"),
            f"--user-data-dir={tmp_path / 'profile'}",
            f"--log-net-log={log}",
            f"--screenshot={tmp_path / 'page.png'}",
            f"{address}/{page}",
        ],
        check=True,
        capture_output=True,
    )
    requests = [event["params"] for event in json.loads(log.read_text())["events"] if "params" in event]
    asked = {request["url"] for request in requests if request.get("initiator") == address}
    assert f"{address}/search.json" in asked
    assert {url for url in asked if not url.startswith((f"{address}/", "data:", "blob:"))} == set()
