"""For all tests."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Generator
from pathlib import Path

import pytest
from allowed_skips import fail_unless_allowed
from hypothesis import settings
from twins import write_all
from waiting import eventually as _eventually

from lidar_emu.recording.read import Recording, read_recording
from lidar_emu.recording.write import Recorder
from lidar_emu.runtime.options import RunOptions
from lidar_emu.runtime.port.packets import Pace
from lidar_emu.runtime.run import Run
from lidar_emu.scenario.load import load
from lidar_emu.shots.model import build_model
from lidar_emu.transports.spec import PortSpec

# A shell's background job ignores Ctrl-C, `nohup` the end of the terminal, and so would every process that is started.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

SEED = (Path(__file__).parent / "hypothesis_seed.txt").read_text().strip()

# The first example of a test may compile a kernel; no test is about time. What failed elsewhere is not tried first: the
# seed alone decides what is drawn.
settings.register_profile("by_seed", deadline=None, database=None)
settings.load_profile("by_seed")


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    """Draw the examples of property tests by the committed seed, unless one is given."""
    if config.option.hypothesis_seed is None:
        config.option.hypothesis_seed = SEED


def pytest_report_header(config: pytest.Config) -> str:
    """State the seed, so that a failure can be repeated."""
    return f"examples: --hypothesis-seed={config.option.hypothesis_seed}"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Fail a test that is skipped without being allowed to."""
    report = yield
    fail_unless_allowed(report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Fail a file that is skipped without being allowed to."""
    report = yield
    fail_unless_allowed(report)
    return report


@pytest.fixture(scope="session")
def record(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Recording]:
    """Fly a scenario on the in-memory loopback as fast as it goes, and read what was recorded."""

    def record(name: str, /, **settings: str) -> Recording:
        scenario = load(name, {key.replace("__", "."): value for key, value in settings.items()})
        path: Path = tmp_path_factory.mktemp("recording") / "r.mcap"
        options = RunOptions(PortSpec(), Pace.MAX)
        with Recorder(path, scenario, options) as recorder:
            Run(scenario, build_model(scenario), options, [recorder]).fly()
        assert recorder.error is None
        return read_recording(path)

    return record


@pytest.fixture(scope="session")
def public_data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of public maps and flights: the one named by LIDAR_EMU_REAL_DATA, or synthetic twins."""
    if named := os.environ.get("LIDAR_EMU_REAL_DATA"):
        return Path(named)
    folder = tmp_path_factory.mktemp("public_data")
    write_all(folder)
    return folder


@pytest.fixture
def eventually() -> Callable[..., object]:
    """See `waiting.eventually`."""
    return _eventually
