"""Build the documentation site from README, docs/, and the pages that lie beside what they describe.

python tools/build_site.py [FOLDER]      pages in FOLDER/pages, the site in FOLDER/site; FOLDER is `build` by default

Notebooks are executed. Links to other files of the repository (headers, definitions, programs) lead to copies of these
files. A link that leads nowhere, a notebook that fails and a warning of the site generator end the build.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COPIED = {".css", ".gif", ".png", ".svg", ".webp"}
FOR_GITHUB = re.compile(r'<picture>.*<img alt="([^"]*)" src="([^"]*)"></picture>')
SHOWN = re.compile(r"(!\[[^]]*\]\([^)]*)\.png\)")
LINK = re.compile(r"(\]\()(?![a-z]+:)([^)#\s]+)(#[^)\s]*)?(\))")
ELSEWHERE = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "docs/decisions/README.md": "decisions.md",
    "docs/evidence/README.md": "evidence.md",
    "protocol/lidar_protocol/INTERFACE.md": "interface.md",
}


def places() -> dict[Path, Path]:
    """Where each page and picture lies in the site, by its file in the repository."""
    found = dict[Path, Path]()
    for readme in (ROOT / "examples").glob("*/README.md"):
        found[readme] = Path("examples") / f"{readme.parent.name}.md"
    docs = ROOT / "docs"
    for path in docs.rglob("*"):
        if path.suffix in {".md", ".ipynb", *COPIED}:
            page = path.relative_to(docs)
            found[path] = page.with_suffix(".md") if path.suffix == ".ipynb" else page
    return found | {ROOT / source: Path(page) for source, page in ELSEWHERE.items()}


def in_both_themes(text: str, folder: Path) -> str:
    """Return a page on which each picture that has a dark variant has both: the theme hides one."""

    def both(match: re.Match[str]) -> str:
        begin = match[1]
        is_dark_there = (folder / f"{begin.partition('](')[2]}-dark.png").is_file()
        return f"{begin}.png#only-light){begin}-dark.png#only-dark)" if is_dark_there else match[0]

    return SHOWN.sub(both, FOR_GITHUB.sub(r"![\1](\2)", text))


def linked(text: str, source: Path, places: dict[Path, Path]) -> tuple[str, set[Path]]:
    """Return a page with its links as the site needs them, and the other files that it links to."""
    others: set[Path] = set()
    here = places[source].parent

    def replaced(match: re.Match[str]) -> str:
        opening, target, anchor, closing = match.groups()
        path = (source.parent / target).resolve()
        if path.is_dir():
            path /= "README.md"
        if not path.is_file():
            sys.exit(f"{source}: {target} leads nowhere")
        if path not in places:
            others.add(path)
        page = places.get(path, Path("files") / path.relative_to(ROOT))
        return f"{opening}{os.path.relpath(page, here)}{anchor or ''}{closing}"

    return LINK.sub(replaced, text), others


def executed(notebook: Path, page: Path) -> str:
    """Execute a notebook and return it as a page; its pictures are written beside the page."""
    import nbformat
    from nbclient import NotebookClient
    from nbconvert import MarkdownExporter

    print(f"executing {notebook.relative_to(ROOT)}", flush=True)
    content = nbformat.read(notebook, as_version=4)
    NotebookClient(content, timeout=600, resources={"metadata": {"path": str(notebook.parent)}}).execute()
    resources = {"unique_key": page.stem, "output_files_dir": f"{page.stem}_files"}
    text, resources = MarkdownExporter().from_notebook_node(content, resources)
    # Tables of pandas are wider than a telephone.
    text = text.replace("<div>\n<style scoped>", '<div style="overflow-x: auto">\n<style scoped>')
    for name, picture in resources["outputs"].items():
        (page.parent / name).parent.mkdir(exist_ok=True)
        (page.parent / name).write_bytes(picture)
    return text


def gather(folder: Path) -> None:
    """Write all pages, pictures and linked files into a folder."""
    where = places()
    files: set[Path] = set()
    for source, page in where.items():
        target = folder / page
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.suffix in COPIED:
            shutil.copyfile(source, target)
            continue
        text = executed(source, target) if source.suffix == ".ipynb" else source.read_text(encoding="utf-8")
        others: set[Path] = set()
        if source.suffix == ".md":
            text, others = linked(in_both_themes(text, source.parent), source, where)
        target.write_text(text, encoding="utf-8")
        files |= others
    for source in files:
        target = folder / "files" / source.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)


def build(folder: Path) -> None:
    """Build the site into `site` in the folder."""
    for made in ("pages", "site"):
        shutil.rmtree(folder / made, ignore_errors=True)
    gather(folder / "pages")
    shutil.copyfile(ROOT / "docs" / "mkdocs.yml", folder / "mkdocs.yml")
    command = [str(Path(sys.executable).parent / "zensical"), "build", "--strict", "--clean"]
    subprocess.run(command, cwd=folder, check=True)
    print(f"to view it: python -m http.server --bind 127.0.0.1 --directory {folder / 'site'}")


if __name__ == "__main__":
    build(Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "build").resolve())
