"""The schema for editors and the reference for people, against what `load` takes."""

import copy
import json
import re
import shlex
import sys
from pathlib import Path

import jsonschema
import pytest
from ruamel.yaml import YAML

from lidar_emu.errors import InputError
from lidar_emu.scenario import schema as _scenarios  # noqa: F401  (every Part is then known)
from lidar_emu.scenario.json_schema import json_schema
from lidar_emu.scenario.load import load, shipped_scenarios
from lidar_emu.scenario.parts import shipped
from lidar_emu.scenario.section import Part

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

from reference_page import markdown_pages

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGES = markdown_pages()
TEXT = "\n".join(PAGES.values())
SCHEMA = json_schema()
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)


def read(name):
    return YAML(typ="safe", pure=True).load((shipped("scenarios") / name).read_text())


def mappings(node, path=()):
    """The path of every mapping in a tree."""
    children = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    if isinstance(node, dict):
        yield path
    for key, child in children:
        yield from mappings(child, (*path, key))


def at(node, path):
    for key in path:
        node = node[key]
    return node


def models(model=Part):
    for below in model.__subclasses__():
        # Campaigns and requirements have pages of their own, docs/campaigns.md and docs/requirements.md.
        if below.__module__.startswith("lidar_emu.scenario.") and not below.__module__.endswith(".campaign"):
            yield below
        yield from models(below)


def taken_by_load(tree, folder):
    path = folder / "scenario.yaml"
    path.write_text(json.dumps(tree))
    try:
        load(path)
    except InputError:
        return False
    return True


def test_schema_is_a_schema():
    VALIDATOR.check_schema(SCHEMA)
    assert SCHEMA["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    assert SCHEMA["title"]


@pytest.mark.parametrize("name", shipped_scenarios())
def test_shipped_scenarios_are_accepted(name):
    VALIDATOR.validate(read(name))


@pytest.mark.parametrize("name", shipped_scenarios())
def test_an_unknown_key_is_refused_wherever_it_stands(name):
    tree = read(name)
    for path in mappings(tree):
        changed = copy.deepcopy(tree)
        at(changed, path)["no_such_key"] = 1
        assert not VALIDATOR.is_valid(changed), path


@pytest.mark.parametrize("part", ["instruments", "sites", "scanners"])
def test_shipped_parts_are_accepted_in_place(part):
    for path in shipped(part).glob("*.yaml"):
        tree = read("descent.yaml")
        tree[part.removesuffix("s")] = YAML(typ="safe", pure=True).load(path.read_text())
        VALIDATOR.validate(tree)


PARTS = [
    ("site", {"base": "mare", "surface": {"reflectance": 0.12}}, True),
    ("site", {"base": "flat", "ground": {"slope_deg": 5}}, True),
    ("site", {"base": "flat", "atmosphere": None}, True),
    ("site", {"base": "flat", "surface": {"reflectance": 1.5}}, False),
    ("site", {"base": "flat", "surface": {"albedo": 0.2}}, False),
    ("site", {"base": 3}, False),
    ("site", {"surface": {"reflectance": 0.12}}, False),
    ("instrument", {"base": "ndl_fine", "waveform": {"fft_length": 65536}}, True),
    ("instrument", {"base": "ndl_fine", "waveform": {"fft_length": "long"}}, False),
    ("instrument", {"base": "ndl_fine", "base_": 1}, False),
    ("instrument", {}, True),
    ("instrument", 7, False),
    ("scanner", {"base": "ndl_three_beam", "pattern": {"count": 5}}, True),
    ("scanner", {"base": "ndl_three_beam", "pattern": {"kind": "square", "angle_deg": 10}}, True),
    ("scanner", {"base": "ndl_four_beam", "switches": []}, True),
    ("scanner", {"base": "ndl_four_beam", "switches": [{"kind": "time", "at_s": 1}]}, False),
    ("scanner", {"base": "ndl_four_beam", "firing": "sometimes"}, False),
    ("trajectory", {"base": "leg", "path_angle_deg": 45}, True),
    ("trajectory", "leg", True),
]


@pytest.mark.parametrize(("part", "value", "usable"), PARTS, ids=[f"{p}-{v}" for p, v, _ in PARTS])
def test_parts_by_reference_are_judged_as_load_judges_them(part, value, usable, tmp_path):
    tree = read("descent.yaml")
    (tmp_path / "leg.yaml").write_text(json.dumps(tree["trajectory"]))
    tree[part] = value
    assert VALIDATOR.is_valid(tree) is usable
    assert taken_by_load(tree, tmp_path) is usable


@pytest.mark.parametrize("word", ["on", "off", "yes", "no", True, False, "maybe", 1])
def test_switches_are_words_or_booleans(word, tmp_path):
    tree = read("bench.yaml")
    tree["bench_pattern"]["beams"][0]["valid"] = word
    # Python's 1 == True, JSON's does not.
    usable = word in ("on", "off", "yes", "no") or word is True or word is False
    assert VALIDATOR.is_valid(tree) is usable
    assert taken_by_load(tree, tmp_path) is usable


def test_schema_is_the_same_however_often_it_is_made():
    assert json.dumps(json_schema()) == json.dumps(SCHEMA)


def test_every_key_and_model_is_documented():
    undocumented = [
        *(model.__name__ for model in models() if not model.__doc__),
        *(
            f"{name}.{key}"
            for name, node in SCHEMA["$defs"].items()
            for key, below in node.get("properties", {}).items()
            if not below.get("description")
        ),
    ]
    assert undocumented == []


def test_pages_of_the_reference_are_up_to_date():
    assert {path: (DOCS / path).read_text() for path in PAGES} == PAGES, "run: make docs"
    assert {f"reference/{path.name}" for path in (DOCS / "reference").iterdir()} == PAGES.keys() - {
        "scenario-reference.md"
    }


def test_reference_has_every_key_of_every_model():
    sections = dict(re.findall(r"^##+ (.+?)\n(.*?)(?=^#|\Z)", TEXT, re.MULTILINE | re.DOTALL))
    for model in models():
        if not model.__subclasses__():
            heading = re.sub(r"(?<!^)(?=[A-Z])", " ", model.__name__).capitalize()
            keys = re.findall(r"^\| `(\w+)` \|", sections[heading], re.MULTILINE)
            assert keys == list(model.model_fields)


def test_every_section_keeps_its_anchor_of_the_single_page():
    """tests/architecture follows the links to the sections."""
    contents = re.findall(
        r'<a id="([\w-]+)"></a>\[.*?\]\(reference/\w+\.md#([\w-]+)\)', PAGES["scenario-reference.md"]
    )
    headings = re.findall(r"^##+ (.+)$", TEXT, re.MULTILINE)
    assert contents == [(anchor, anchor) for anchor in (h.lower().replace(" ", "-") for h in headings)]
    assert {"flight-scenario", "dropout", "powered-descent"} <= dict(contents).keys()


def test_tables_of_the_reference_have_four_cells_in_each_row():
    for row in re.findall(r"^\| `\w+` \|.*$", TEXT.partition("\n## ")[2], re.MULTILINE):
        assert len(re.findall(r"(?<!\\)\|", row)) == 5, row


def test_commands_of_the_reference_work():
    commands = re.findall(r"^lidar-emu simulate .*$", TEXT.replace("\\\n", ""), re.MULTILINE)
    assert commands
    for command in commands:
        words = shlex.split(command)
        settings = [words[k + 1].split("=", 1) for k, word in enumerate(words) if word == "--set"]
        scenario = load(words[2], dict(settings))
        for key, text in settings:
            node = scenario
            for step in key.split("."):
                node = node[int(step)] if step.isdigit() else getattr(node, step)
            assert str(getattr(node, "name", node)).removesuffix(".0") == text
