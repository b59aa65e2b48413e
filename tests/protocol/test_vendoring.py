"""The package as a flight-software team takes it: a bare copy, without site-packages, before any other of ours."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import lidar_protocol

GOLDEN = Path(__file__).parent / "golden.json"

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
loaded = {name.partition(".")[0] for name in set(sys.modules) - before}
print(json.dumps(sorted(loaded - set(sys.stdlib_module_names))))
"""


def test_a_bare_copy_works_with_the_standard_library_alone(tmp_path):
    folder = Path(lidar_protocol.__file__).parent
    shutil.copytree(folder, tmp_path / "lidar_protocol", ignore=shutil.ignore_patterns("__pycache__"))
    run = [sys.executable, "-S", "-I", "-W", "error", "-c", ROUND_TRIP, str(tmp_path), str(GOLDEN)]
    done = subprocess.run(run, capture_output=True, check=False, text=True)
    assert done.stderr == ""
    assert json.loads(done.stdout) == ["lidar_protocol"]


def test_it_says_that_it_is_typed():
    assert (Path(lidar_protocol.__file__).parent / "py.typed").exists()
