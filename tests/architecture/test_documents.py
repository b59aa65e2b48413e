"""Documents for maintainers name modules, files, functions and records that exist."""

from __future__ import annotations

import importlib
import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
DECISIONS = sorted((DOCS / "decisions").glob("0*.md"))
AUTOMATION = [ROOT / ".ci" / "run", ROOT / "Dockerfile", *sorted((ROOT / ".github").glob("*/*.yml"))]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]


def named(page: str, pattern: str) -> list[str]:
    found = re.findall(pattern, (ROOT / page).read_text(encoding="utf-8"))
    assert found, f"{page} names none"
    return found


def anchors(page: Path) -> set[str]:
    """Anchors as GitHub makes them of headings."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", ["docs/glossary.md", "docs/how-to-add.md"])
def test_every_file_named_exists(page: str) -> None:
    roots = ROOT, ROOT / "emulator" / "lidar_emu", ROOT / "protocol"
    for path in named(page, r"`([\w./]+\.(?:py|md|toml))`"):
        assert any((root / path).is_file() for root in roots), path


def test_every_call_of_the_walk_throughs_exists() -> None:
    for name in named("docs/architecture.md", r"`((?:lidar_emu|lidar_protocol)\.[\w.]+)`"):
        parts = name.split(".")
        for length in range(len(parts), 0, -1):
            try:
                found = importlib.import_module(".".join(parts[:length]))
            except ModuleNotFoundError:
                continue
            for part in parts[length:]:
                found = getattr(found, part)
            break
        else:
            pytest.fail(name)


def test_the_layers_are_those_of_the_import_contract() -> None:
    contract = re.findall(r'^    "lidar_emu\.(\w+)",$', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    layers = contract[: contract.index("errors") + 1]
    assert named("docs/architecture.md", r"(?m)^\| `(\w+)` \|")[: len(layers)] == layers


def test_every_decision_is_in_the_index() -> None:
    assert named("docs/decisions/README.md", r"\((0[\w-]+\.md)\)") == [path.name for path in DECISIONS]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\((?!https?:)([^)\s]+)\)", page.read_text(encoding="utf-8")):
        file, _, anchor = target.partition("#")
        path = page.parent / file if file else page
        assert path.exists(), target
        assert not anchor or anchor in anchors(path), target


@pytest.mark.parametrize("script", AUTOMATION, ids=lambda script: script.name)
def test_what_ci_and_the_image_call_exists(script: Path) -> None:
    text = script.read_text(encoding="utf-8")
    tools, targets = re.findall(r"tools/\w+\.py", text), re.findall(r"\bmake ([.\w][\w./-]*)", text)
    assert tools or targets
    for tool in tools:
        assert (ROOT / tool).is_file()
    subprocess.run(["make", "--dry-run", *targets], cwd=ROOT, check=True, capture_output=True)
