"""Parts of self-contained HTML pages: document, heading, note, table, figure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from lidar_emu.report.plot_style import Drawing, as_svg

_STYLE = """
:root { color-scheme: light dark; --paper: #fff; --ink: #1f2328; --faint: #6a727d; --rule: #d6dae0; }
@media (prefers-color-scheme: dark) {
  :root { --paper: #14171b; --ink: #dde1e6; --faint: #9aa2ad; --rule: #363c45; }
}
body { margin: 2rem auto; max-width: 62rem; padding: 0 1rem; background: var(--paper); color: var(--ink);
  font: 15px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.6rem; margin-bottom: 0.2rem; }
h2 { font-size: 1.15rem; margin-top: 2.4rem; border-bottom: 1px solid var(--rule); }
figure { margin: 0.8rem 0; overflow-x: auto; }
figure svg { width: 100%; min-width: 40rem; height: auto; color: var(--ink); }
svg text { font-family: system-ui, sans-serif !important; }
figcaption, .note { color: var(--faint); font-size: 0.88rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.88rem; }
th { text-align: left; font-weight: 600; }
td, th { padding: 0.15rem 0.9rem 0.15rem 0; vertical-align: top; border-bottom: 1px solid var(--rule);
  overflow-wrap: break-word; }
tbody td:last-child { min-width: 10rem; }
summary { cursor: pointer; font-weight: 600; }
pre { font-size: 0.8rem; line-height: 1.35; overflow-x: auto; }
thead th { white-space: nowrap; overflow-wrap: normal; }
tbody th { min-width: 6rem; max-width: 16rem; }
"""
_NOTHING_FROM_OUTSIDE = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


def page_document(title: str, parts: Iterable[str]) -> str:
    """A self-contained page of HTML elements, which loads nothing from outside."""
    body = "\n".join(parts)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{_NOTHING_FROM_OUTSIDE}">
<link rel="icon" href="data:,">
<title>{escape(title)}</title>
<style>{_STYLE}</style>
</head>
<body>
{body}
</body>
</html>
"""


def heading(text: str, level: int = 2) -> str:
    """A heading."""
    return f"<h{level}>{escape(text)}</h{level}>"


def note(text: str) -> str:
    """A paragraph in small print."""
    return f'<p class="note">{escape(text)}</p>'


def figure_element(drawing: Drawing) -> str:
    """Render a figure with its heading and caption."""
    svg = as_svg(drawing).replace("<svg", f'<svg role="img" aria-label="{escape(drawing.description)}"', 1)
    return (
        f'<h2>{escape(drawing.title)}</h2>\n<figure id="{drawing.name}">{svg}'
        f"<figcaption>{escape(drawing.description)}</figcaption></figure>"
    )


def html_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of texts; the first cell of a row is its heading. Names may be broken behind an underscore."""
    head = "".join(f'<th scope="col">{escape(text)}</th>' for text in heads)
    body = "\n".join(
        f'<tr><th scope="row">{_breakable(first)}</th>'
        + "".join(f"<td>{_breakable(cell)}</td>" for cell in rest)
        + "</tr>"
        for first, *rest in rows
    )
    begin = f"<thead><tr>{head}</tr></thead>" if heads else ""
    return f'<div class="wide"><table>{begin}<tbody>\n{body}\n</tbody></table></div>'


def _breakable(text: str) -> str:
    return escape(text).replace("_", "_<wbr>")
