"""The pages docs/scenario-reference.md and docs/reference: keys of scenarios and campaigns, with type and meaning."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lidar_emu.scenario.campaign import Campaign
from lidar_emu.scenario.json_schema import Node, choices, models_schema, shipped_parts, target
from lidar_emu.scenario.load import shipped_scenarios
from lidar_emu.scenario.parts import PART_FOLDERS
from lidar_emu.scenario.schema import BenchScenario, FlightScenario

_PAGE_OF = {"plume": "site", "wire": "device"} | dict.fromkeys(("mounting", "vibration"), "scanner")
_PAGE_OF |= dict.fromkeys(("FlightScenario", "BenchScenario", "timing", "bench_pattern"), "scenario")
_PAGE_OF |= dict.fromkeys(("Campaign", "dispersions", "joint_normals", "correlations"), "campaign")
"""Page by the first step of a dotted key, or by the model that has none; else the page is named as the step."""
_INTRODUCTION = """\
# Scenario reference

A scenario is one YAML 1.2 file. It states a flight (instrument, site, trajectory and scanner) or a bench pattern. A
campaign is a separate file that names a scenario and dotted keys of it (`KEY` on its page) that are set or drawn.
Unknown keys, text in place of numbers, infinities and NaN are refused with the file, the key and what it must be.
`lidar-emu schema` prints the same as JSON Schema (`--campaign`: of a campaign), with which editors complete and check:

```yaml
# yaml-language-server: $schema=lidar-emu.schema.json
```

**Units.** A key ends in its unit: `_m`, `_s`, `_mps` (m/s), `_hz`, `_deg`, `_mrad`, `_radps` (rad/s), `_w`,
`_k`, `_db`. Lengths and coordinates are at most 1e9 m, times 1e9 s, frequencies 1e15 Hz, speeds 3e8 m/s, angles
1e6 deg, powers 1e9 W and levels 1000 dB. Positions are in the site frame: east, north and up from the landing point.

**Parts by reference.** {parts} can each be written in
place, or named: `site: mare` takes `mare.yaml` from the scenario's folder, else the shipped one. A mapping with `base`
takes a named file and replaces some of its keys:

```yaml
site:
  base: mare
  surface: {{reflectance: 0.12}}
```

Mappings are merged key by key, except that a mapping of another `kind` replaces the base's; lists are replaced whole.
A named file may have a `base` itself: with `base: ndl_four_beam` and the keys that differ, `my_lidar.yaml` is a custom
instrument for any scenario beside it. File names inside a part are relative to the file that states them;
in `--set` on a shipped scenario, to the working directory.

{shipped}

**`--set`** replaces single values of any scenario, with dotted keys and entries of lists by number from 0
(`N` on the pages). It reaches into parts named by reference:

```sh
lidar-emu simulate descent.yaml --out descent.csv --set timing.rate_hz=100 \\
    --set instrument.detection.peak=hann
lidar-emu simulate descent.yaml --out descent.csv --set site=flat \\
    --set trajectory.waypoints.0.altitude_m=1500
```
"""


def markdown_pages() -> dict[str, str]:
    """The pages by their names in docs: introduction and contents, then tables of keys, a section for each model."""
    schema = models_schema(FlightScenario | BenchScenario | Campaign)
    definitions: Node = schema["$defs"]
    places: dict[str, list[str]] = {}
    for choice in choices(schema):
        for model, place in _models_below(target(choice), "", definitions):
            places.setdefault(model, []).append(place)
    pages: dict[str, list[str]] = {}
    for model, (first, *_) in places.items():
        step = first.split(".")[0] or model
        pages.setdefault(f"reference/{_PAGE_OF.get(step, step)}.md", []).append(model)
    files = {_anchor(model): Path(page).name for page, found in pages.items() for model in found}
    written = {"scenario-reference.md": f"{_introduction()}\n{_contents(pages)}"}
    for page, found in pages.items():
        text = "\n".join(_section(definitions[model], places[model]) for model in found)
        text = re.sub(r"(?<=\]\()#([\w-]+)", lambda link: files[link[1]] + link[0], text)
        written[page] = f"# Keys: {Path(page).stem}\n\n{text}"
    return written


def _introduction() -> str:
    parts = [f"`{part}`" for part in PART_FOLDERS]
    rows = [f"| scenario | {_listed(name.removesuffix('.yaml') for name in shipped_scenarios())} |"]
    rows += [f"| `{part}` | {_listed(shipped_parts(part))} |" for part in PART_FOLDERS if shipped_parts(part)]
    table = "\n".join(["| part | shipped |", "|---|---|", *rows])
    return _INTRODUCTION.format(parts=f"{', '.join(parts[:-1])} and {parts[-1]}", shipped=table)


def _listed(names: Iterator[str] | list[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _models_below(model: str, place: str, definitions: Node) -> Iterator[tuple[str, str]]:
    """The model and the models that its keys refer to, in the order of the keys, each with its dotted key."""
    yield model, place
    for key, node in definitions[model]["properties"].items():
        below = f"{place}.{key}" if place else key
        own = [(choice, below) for choice in choices(node)]
        listed = [(item, f"{below}.N") for choice, _ in own for item in choices(choice.get("items", {}))]
        named = [(value, f"{below}.KEY") for choice, _ in own for value in choices(_named(choice))]
        for choice, where in own + listed + named:
            if "$ref" in choice:
                yield from _models_below(target(choice), where, definitions)


def _named(node: Node) -> Node:
    below: Node | bool = node.get("additionalProperties", False)
    return below if isinstance(below, dict) else {}


def _contents(pages: dict[str, list[str]]) -> str:
    lines = ["| page | sections |", "|---|---|"]
    for page, found in pages.items():
        # Sections keep the anchors that they had when all were on one page.
        links = [f'<a id="{_anchor(each)}"></a>[{_heading(each)}]({page}#{_anchor(each)})' for each in found]
        lines.append(f"| [Keys: {Path(page).stem}]({page}) | {', '.join(links)} |")
    return "\n".join([*lines, ""])


def _section(model: Node, places: list[str]) -> str:
    where = _listed([place for place in dict.fromkeys(places) if place])
    kind = model["properties"].get("kind", {}).get("const")
    if kind:
        where += f" with `kind: {kind}`"
    required = model.get("required", [])
    return "\n".join(
        [
            f"{'##' if places[0].count('.') == 0 else '###'} {_heading(model['title'])}",
            "",
            *([f"At {where}.", ""] if where else []),
            _cell_text(model["description"]),
            "",
            "| key | type, allowed | default | meaning |",
            "|---|---|---|---|",
            *(_row(key, node, key in required, places) for key, node in model["properties"].items()),
            "",
        ]
    )


def _row(key: str, node: Node, required: bool, places: list[str]) -> str:
    kind = _type(node)
    if places[0] == "" and key in PART_FOLDERS:
        kind += ", a name, or a `base`"
    default = "required" if required else _default(node)
    return f"| `{key}` | {kind} | {default} | {_cell_text(node['description'])} |"


def _default(node: Node) -> str:
    value = node["default"]
    if value is None:
        return "left out"
    return "its defaults" if "$ref" in node else f"`{_value(value)}`"


def _type(node: Node) -> str:
    alternatives = [choice for choice in choices(node) if choice.get("type") != "null"]
    if len(alternatives) > 1:
        return " or ".join(_type(choice) for choice in alternatives)
    node = alternatives[0]
    if "$ref" in node:
        return _link(target(node))
    if "const" in node or "enum" in node:
        return ", ".join(f"`{_value(value)}`" for value in node.get("enum", [node.get("const")]))
    if "prefixItems" in node:
        return f"[{'; '.join(_type(item) for item in node['prefixItems'])}]"
    if not node:
        return "anything"
    if node["type"] == "object":
        return f"mapping of keys to {_type(_named(node))}"
    if node["type"] == "array":
        return f"list{_length(node)} of {_type(node['items'])}"
    if node.get("format") == "date-time":
        return "date and time with zone"
    return {"string": "text"}.get(node["type"], str(node["type"])) + _bounds(node)


def _length(node: Node) -> str:
    lower, upper = node.get("minItems"), node.get("maxItems")
    if upper is not None:
        return f" ({lower} to {upper})"
    return f" (at least {lower})" if lower else ""


def _bounds(node: Node) -> str:
    signs = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
    bounds = [f"{sign} {_value(node[word])}" for word, sign in signs.items() if word in node]
    return f" {', '.join(bounds)}" if bounds else ""


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.12g}"
    if isinstance(value, list):
        return f"[{', '.join(_value(item) for item in value)}]"
    return str(value)


def _cell_text(description: str) -> str:
    return " ".join(description.split()).replace("|", "\\|")


def _heading(title: str) -> str:
    """`LengthColumn` as `Length column`."""
    return re.sub(r"(?<=[a-z])[A-Z]", lambda capital: " " + capital[0].lower(), title)


def _anchor(title: str) -> str:
    return _heading(title).lower().replace(" ", "-")


def _link(title: str) -> str:
    return f"[{_heading(title)}](#{_anchor(title)})"


if __name__ == "__main__":
    for name, text in markdown_pages().items():
        Path("docs", name).write_text(text, encoding="utf-8")
