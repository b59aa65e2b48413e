"""The folder as a flight-software team copies it: alone, without site-packages."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import lidar_protocol

FOLDER = Path(lidar_protocol.__file__).parent
GOLDEN = Path(__file__).parent / "golden.json"
NOT_CODE = {"INTERFACE.md", "README.md", "altimeter.toml", "default.toml", "lidar.dbc", "lidar.h", "py.typed"}

ROUND_TRIP = """
import json, pathlib, sys
sys.path.insert(0, sys.argv[1])
before = set(sys.modules)
import lidar_protocol
from lidar_protocol import *
interface = default_interface()
for shot in json.loads(pathlib.Path(sys.argv[2]).read_text()):
    frame = bytes.fromhex(shot["frame"])
    (message,) = SerialReceiver(interface).receive(frame)
    assert Device(interface, shot["unit"]).serial_bytes(message.header, message.beams) == frame
load_file(pathlib.Path(lidar_protocol.__file__).parent / "altimeter.toml")
shipped_interface("altimeter")
loaded = set(sys.modules) - before
print(json.dumps(sorted(name for name in loaded if name.partition(".")[0] not in sys.stdlib_module_names)))
"""


@pytest.fixture(scope="module")
def loaded(tmp_path_factory):
    """The modules outside of the standard library that a host and a device load from a bare copy of the folder."""
    folder = tmp_path_factory.mktemp("vendored")
    shutil.copytree(FOLDER, folder / "lidar_protocol", ignore=shutil.ignore_patterns("__pycache__"))
    run = [sys.executable, "-S", "-I", "-W", "error", "-c", ROUND_TRIP, str(folder), str(GOLDEN)]
    done = subprocess.run(run, capture_output=True, check=False, text=True)
    assert done.stderr == ""
    return set(json.loads(done.stdout))


def test_a_bare_copy_needs_the_standard_library_alone(loaded):
    assert {name.partition(".")[0] for name in loaded} == {"lidar_protocol"}


def test_the_folder_holds_what_a_host_or_a_device_runs_and_nothing_else(loaded):
    files = {path.name for path in FOLDER.iterdir() if path.name != "__pycache__"}
    modules = {name.rpartition(".")[2] + ".py" for name in loaded - {"lidar_protocol"}}
    assert files == modules | {"__init__.py"} | NOT_CODE
