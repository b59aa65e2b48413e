"""The documentation site: it is built without a warning, has all pages, and sends no request to another host."""

from __future__ import annotations

import json
import os
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
from filelock import FileLock

pytest.importorskip("zensical", reason="make site installs what the site needs")

ROOT = Path(__file__).resolve().parents[2]
CHROMIUM = shutil.which("chromium")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built once, by the first of the processes that share the tests."""
    is_shared = "PYTEST_XDIST_WORKER" in os.environ
    folder = tmp_path_factory.getbasetemp().parent if is_shared else tmp_path_factory.getbasetemp()
    with FileLock(folder / "site.lock"):
        if not (folder / "documents" / "site").exists():
            command = [sys.executable, ROOT / "tools" / "build_site.py", folder / "documents"]
            subprocess.run(command, check=True)
    return folder / "documents" / "site"


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


WIDTHS = """
<pre id="widths"></pre>
<script>
const shown = document.getElementById("widths");
(async () => {
    for (const page of PAGES) {
        const frame = document.createElement("iframe");
        frame.style.width = "400px";
        frame.src = page;
        await new Promise(loaded => { frame.onload = loaded; document.body.appendChild(frame); });
        shown.textContent += `${page} ${frame.contentDocument.documentElement.scrollWidth}\\n`;
        frame.remove();
    }
    shown.textContent += "all";
})();
</script>
"""


class QuietHandler(SimpleHTTPRequestHandler):
    """Serves files and prints nothing."""

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing."""


@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine")
@pytest.mark.parametrize("page", ["index.html", "api.html"])
def test_a_browser_sends_no_request_to_another_host(page: str, address: str, tmp_path: Path) -> None:
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


@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine")
def test_no_page_is_wider_than_a_telephone(site: Path, address: str, tmp_path: Path) -> None:
    pages = sorted(str(page.relative_to(site)) for page in site.rglob("*.html") if "files" not in page.parts)
    (site / "widths.html").write_text(WIDTHS.replace("PAGES", json.dumps(pages)))
    done = subprocess.run(
        [
            str(CHROMIUM),
            *("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--dump-dom"),
            f"--user-data-dir={tmp_path / 'profile'}",
            "--virtual-time-budget=600000",
            f"{address}/widths.html",
        ],
        check=True,
        capture_output=True,
        text=True,
    )
    (shown,) = re.findall(r'<pre id="widths">(.*?)all</pre>', done.stdout, re.DOTALL)
    widths_px = {page: int(width) for page, width in (line.split() for line in shown.splitlines())}
    assert len(widths_px) > 50
    assert {page: width for page, width in widths_px.items() if width > 400} == {}
