"""`new`, `doctor` and `help`, the commands of the first ten minutes."""

from __future__ import annotations

import json
import re
import socket
import tomllib
from importlib import import_module, metadata
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import click
import pytest
from click.testing import CliRunner, Result

from lidar_emu.campaign.description import prepare
from lidar_emu.cli import cli
from lidar_emu.runtime.realtime_priority import RealtimePrivileges
from lidar_emu.scenario.load import load, shipped_scenarios

doctor = import_module("lidar_emu.cli.doctor")
ROOT = Path(__file__).resolve().parents[2]
FOR_DEVELOPERS = {"all", "dev", "fprime", "mutants", "peers", "site", "yamcs"}


def run(*words: str) -> Result:
    done = CliRunner().invoke(cli, words, standalone_mode=False)
    if done.exception is not None:
        raise done.exception
    return done


@pytest.mark.parametrize("name", [*shipped_scenarios(), "dispersed_descent"])
def test_what_is_new_is_the_shipped_one_under_another_name(name: str, tmp_path: Path) -> None:
    run("new", str(tmp_path / "my.yaml"), "--from", name)
    read = load if name in shipped_scenarios() else lambda path: prepare(Path(path), [], None).campaign
    made, shipped = read(tmp_path / "my.yaml"), read(name)
    assert made.name == "my"
    assert made.model_copy(update={"name": shipped.name}) == shipped


def test_each_key_has_its_meaning_of_the_reference(tmp_path: Path) -> None:
    """The pages are made by another program, from the same schema."""
    run("new", str(tmp_path / "my.yaml"), "--from", "powered_descent")
    pages = (ROOT / "docs" / "reference").glob("*.md")
    page = "\n".join(each.read_text(encoding="utf-8") for each in pages)
    text = (tmp_path / "my.yaml").read_text(encoding="utf-8")
    meanings = re.findall(r"^ *(\w+):.* # (.+?)(?: One of: .*| Shipped: .*| \[.*\])?$", text, re.MULTILINE)
    assert len(meanings) == len(re.findall(r"^ *\w+:", text, re.MULTILINE)) > 30
    for key, begun in meanings:
        assert key in ("base", "kind") or re.search(rf"\| `{key}` \|.*\| {re.escape(begun)}", page), key
    assert "mass_kg: 1500                       # Mass at the start. [kg]" in text


@pytest.mark.parametrize("name", ["true", "1e3", "on", "a: b #c", "ñ", "null", "-", "x" * 100])
def test_any_name_of_a_file_is_a_name(name: str, tmp_path: Path) -> None:
    run("new", str(tmp_path / f"{name}.yaml"), "--from", "bench")
    assert load(tmp_path / f"{name}.yaml").name == name


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The folder of a machine with a bus, a port and a cache; the test's process requests no privileges."""
    for file, text in {
        "port": "",
        "net/can7/type": "280",
        "net/can7/flags": "0x41",
        "kernels/one": "one",
    }.items():
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_text(text)
    ports = [SimpleNamespace(device=str(tmp_path / "port"), description="UART")]
    privileges = RealtimePrivileges(["timer_slack"], {"fifo": "sudo this"})
    monkeypatch.setattr(doctor, "_NETWORKS", tmp_path / "net")
    monkeypatch.setattr(socket, "socket", Mock())
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: ports)
    monkeypatch.setattr("lidar_emu.runtime.realtime_priority.request_realtime", lambda: privileges)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    return tmp_path


def diagnosis() -> tuple[int, str]:
    done = run("doctor")
    assert all(line.startswith(("ok  ", "missing  ", "needed  ")) for line in done.stdout.splitlines()[:-1])
    return done.return_value, done.stdout


def test_a_machine_that_has_everything(machine: Path) -> None:
    code, said = diagnosis()
    assert code == 0
    for there in (
        f"numba {metadata.version('numba')}",
        f"extra geo (maps: GeoTIFF, PDS, ESRI ASCII): rasterio {metadata.version('rasterio')}",
        f"cache {machine / 'kernels'}: 1 kernels, 0 MB, writable",
        "CAN can7: up",
        f"serial port {machine / 'port'} (UART)",
        "real time: timer slack\nmissing  real time, fifo: sudo this",
    ):
        assert f"\nok       {there}\n" in said
    assert said.endswith("\na run is possible\n")


def test_what_is_missing_comes_with_its_remedy(machine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (machine / "net/can7/flags").write_text("0x40")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(machine / "port"))
    monkeypatch.setattr("os.access", lambda *_: False)
    monkeypatch.setattr(metadata, "distributions", lambda name: [] if name == "rasterio" else [Mock()])
    code, said = diagnosis()
    assert code == 0
    for remedy in (
        r"CAN can7: sudo ip link set can7 up type can bitrate 500000",
        r"serial port .*: sudo usermod -aG \w+ \$USER, then log in again",
        r"cache: set XDG_CACHE_HOME to a folder that you may write; Not a directory",
        r"extra geo \(.*\): .*pip install .*\[geo\].*",
    ):
        assert re.search(rf"^missing  {remedy}$", said, re.MULTILINE)


@pytest.mark.parametrize(
    ("replaced", "error", "said"),
    [
        ("socket.socket", OSError(97, "no such family"), "CAN in the kernel: sudo modprobe -a can_raw vcan"),
        ("pathlib.Path.home", RuntimeError(), "cache: set XDG_CACHE_HOME to a folder"),
        ("importlib.metadata.requires", metadata.PackageNotFoundError("lidar-emu"), "packages: No package"),
        ("serial.tools.list_ports.comports", ImportError("no such system"), "serial ports: no such system"),
    ],
)
@pytest.mark.usefixtures("machine")
def test_nothing_that_is_missing_ends_it(
    replaced: str, error: Exception, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for variable in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(replaced, Mock(side_effect=error))
    code, printed = diagnosis()
    assert (code, f"\nmissing  {said}" in printed) == (0, True), printed


@pytest.mark.usefixtures("machine")
def test_no_run_is_possible_without_its_libraries(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "import_module", lambda name: __import__(f"no_{name}"))
    code, said = diagnosis()
    assert code == 1
    assert "needed   scipy: pip install scipy; No module named 'no_scipy'\n" in said
    assert said.endswith("\nno run is possible\n")


def test_each_extra_for_users_has_its_use() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["optional-dependencies"].keys() <= doctor._USES.keys() | FOR_DEVELOPERS


@pytest.mark.parametrize("words", ["", "run", "bench", "bench accuracy", "help"])
def test_help_is_the_help_of_the_command(words: str) -> None:
    shown = run("help", *words.split()).stdout
    assert shown == CliRunner().invoke(cli, [*words.split(), "--help"], prog_name="lidar-emu").stdout
    assert shown.startswith(f"Usage: lidar-emu {words}")


def test_the_summary_of_a_run_counts_what_was_left_out(tmp_path: Path) -> None:
    summary = tmp_path / "summary.json"
    printed = run("run", "descent", "--duration", "0.1", "--pace", "max", "--summary", str(summary)).stdout
    count = len(json.loads(summary.read_text())["left_out"])
    assert f"\nleft out   {count} effects, each below its bound (lidar-emu plan)\n" in printed


@pytest.mark.parametrize("name", ["run", "replay", "listen", "send"])
def test_help_has_each_option_once_below_a_subject(name: str) -> None:
    shown = re.split(r"\n\n(?=[A-Z]\w+:\n)", run("help", name).stdout, maxsplit=1)[1]
    for option in (each for each in cli.commands[name].params if isinstance(each, click.Option)):
        assert len(re.findall(rf"^  (?:-\w, )?{option.opts[-1]}\b(?!-)", shown, re.MULTILINE)) == 1
    assert shown.partition("Other options:\n")[2].split()[0] == "-h,"


def test_a_text_is_completed_as_a_file() -> None:
    scenario = next(each for each in cli.commands["run"].params if each.name == "scenario")
    assert [item.type for item in scenario.shell_complete(click.Context(cli), "de")] == ["file"]
