"""Mutation testing of the core: which small faults in the source would no test notice?

    python tools/mutants.py map          # which tests execute which lines; half an hour
    python tools/mutants.py run          # a seeded sample of mutants, against the tests that execute their lines

A mutant is one operator, comparison, number or condition changed in one place (operators of cosmic-ray). It is
killed if a test fails or runs for far longer than it did. Kernels are interpreted in the folders of tests named in
INTERPRETED, so that coverage sees their lines and nothing is recompiled; a module with kernels is judged by those
tests, if there are any. Lines that only child processes execute, which coverage does not see, are left to the tests
in BY_PROCESSES.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
KEPT = ROOT / ".mutants"
CORE = (
    "emulator/lidar_emu/beams",
    "emulator/lidar_emu/campaign",
    "emulator/lidar_emu/device",
    "emulator/lidar_emu/faults",
    "emulator/lidar_emu/measurement.py",
    "emulator/lidar_emu/numerics",
    "emulator/lidar_emu/plan",
    "emulator/lidar_emu/receiver",
    "emulator/lidar_emu/recording",
    "emulator/lidar_emu/runtime",
    "emulator/lidar_emu/scenario",
    "emulator/lidar_emu/scene",
    "emulator/lidar_emu/session.py",
    "emulator/lidar_emu/shots",
    "emulator/lidar_emu/trajectory",
    "emulator/lidar_emu/wire.py",
    "protocol/lidar_protocol",
)
COMPILED = (
    "bench",
    "campaign",
    "cli",
    "device",
    "faults",
    "protocol",
    "recording",
    "report",
    "runtime",
    "scenario",
    "transports",
    "wire",
)
INTERPRETED = (
    "dynamics",
    "receiver",
    "ground",
    "numerics",
    "probability",
    "scanner",
    "scene",
    "shots",
    "stability",
    "trajectory",
    "reference",
)
"""Folders of tests whose lines are mapped."""
BY_PROCESSES = tuple(f"tests/integration/test_{name}.py" for name in ("pty_serial", "commands", "live_truth"))
REPLACED = {
    "ReplaceBinaryOperator": "Add_Sub Sub_Add Mul_Div Div_Mul Mul_Add FloorDiv_Div FloorDiv_Mul Mod_FloorDiv Pow_Mul "
    "LShift_RShift RShift_LShift BitAnd_BitOr BitOr_BitAnd BitXor_BitOr",
    "ReplaceComparisonOperator": "Lt_LtE Lt_GtE LtE_Lt LtE_Gt Gt_GtE Gt_LtE GtE_Gt GtE_Lt Eq_NotEq NotEq_Eq "
    "Is_IsNot IsNot_Is",
    "ReplaceUnaryOperator": "USub_UAdd Delete_Not Delete_Invert",
}
OPERATORS = (
    *(f"{operator}_{pair}" for operator, pairs in REPLACED.items() for pair in pairs.split()),
    *("AddNot", "NumberReplacer", "ReplaceTrueWithFalse", "ReplaceFalseWithTrue"),
    *("ReplaceAndWithOr", "ReplaceOrWithAnd", "ReplaceBreakWithContinue", "ReplaceContinueWithBreak"),
)
TEST_LIMIT_S = 4
"""A test that takes longer interpreted maps no lines."""
BUDGET_S = 20.0
"""Test time of a mutant by the times of the map; the shortest tests come first."""
LIMIT_S = 600.0
"""Limit on all tests of a mutant, far above their time on a busy machine: a mutant that exceeds it counts as killed.
A file of tests that takes longer to map, e.g. for a fixture that is interpreted, maps nothing."""


class Mutant(NamedTuple):
    """One change in one place."""

    path: str
    line: int
    operator: str
    occurrence: int


class Verdict(NamedTuple):
    """Result of the tests of a mutant."""

    mutant: Mutant
    killed: bool
    how: str
    change: str


def main() -> None:
    """Map the tests, or run a sample of mutants."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("step", choices=["map", "run"])
    parser.add_argument("--count", type=int, default=300, help="mutants in the sample")
    parser.add_argument("--seed", type=int, default=1, help="seed of the sample")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="mutants or workers at a time")
    parser.add_argument("--only", help="mutants of paths that contain this")
    arguments = parser.parse_args()
    KEPT.mkdir(exist_ok=True)
    if arguments.step == "map":
        _map_lines(arguments.jobs)
        return
    sample = [
        m for m in draw(arguments.count, arguments.seed) if not arguments.only or arguments.only in m.path
    ]
    tests = TestMap()
    with ThreadPoolExecutor(arguments.jobs) as pool, (KEPT / "verdicts.jsonl").open("w") as file:
        verdicts = []
        for verdict in pool.map(lambda mutant: judge(mutant, tests), sample):
            verdicts.append(verdict)
            file.write(json.dumps(verdict._asdict() | {"mutant": verdict.mutant._asdict()}) + "\n")
            file.flush()
            print(f"{'killed  ' if verdict.killed else 'SURVIVED'} {verdict.mutant.path}:{verdict.mutant.line}"
                  f" {verdict.mutant.operator}: {verdict.how}", flush=True)  # fmt: skip
    killed = sum(verdict.killed for verdict in verdicts)
    print(f"{killed} of {len(verdicts)} killed: {killed / max(len(verdicts), 1):.1%}")


def draw(count: int, seed: int) -> list[Mutant]:
    """A sample of places, each with one of the changes possible there."""
    places: dict[tuple[str, Any], list[Mutant]] = {}
    for path in sorted(file for root in CORE for file in _sources(root)):
        for place, mutant in _mutants(path):
            places.setdefault((mutant.path, place), []).append(mutant)
    generator = random.Random(seed)
    return [
        generator.choice(places[key]) for key in generator.sample(sorted(places), min(count, len(places)))
    ]


def _sources(root: str) -> Iterator[Path]:
    """All modules of a part of the core, which must exist: a part that was renamed would go unseen."""
    path = ROOT / root
    if not path.exists():
        raise FileNotFoundError(f"{root}, in CORE: mend the list")
    return path.rglob("*.py") if path.is_dir() else iter([path])


def _mutants(path: Path) -> Iterator[tuple[Any, Mutant]]:
    from cosmic_ray.ast import get_ast
    from cosmic_ray.plugins import get_operator

    source = path.read_text()
    skipped = _typed_lines_and_columns(source)

    operators = {name: get_operator(f"core/{name}")() for name in OPERATORS}
    found: Counter[str] = Counter()
    place = str(path.relative_to(ROOT))
    for node in _nodes(get_ast(source)):
        for name, operator in operators.items():
            for start, _ in operator.mutation_positions(node):
                if not any(first <= start < last for first, last in skipped):
                    yield start, Mutant(place, start[0], name, found[name])
                found[name] += 1


def _nodes(node: Any) -> Iterator[Any]:
    """Yield all nodes in the order in which cosmic-ray counts occurrences."""
    yield node
    for child in getattr(node, "children", ()):
        yield from _nodes(child)


def _typed_lines_and_columns(source: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Spans of annotations and decorators: a mutant there changes no behaviour, or every kernel's compiler options."""
    parts: list[Any] = []
    for node in ast.walk(ast.parse(source)):
        parts += [getattr(node, "annotation", None), getattr(node, "returns", None)]
        parts += getattr(node, "decorator_list", [])
    return [((p.lineno, p.col_offset), (p.end_lineno, p.end_col_offset)) for p in parts if p is not None]


def _statement_lines(source: str, line: int) -> range:
    """Lines of the statement at a line, without its body: an operand on a separate line may not be traced."""
    spans = [
        range(node.lineno, max(node.lineno, body[0].lineno - 1 if body else node.end_lineno) + 1)
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.stmt)
        for body in [getattr(node, "body", None)]
    ]
    return min((span for span in spans if line in span), key=len, default=range(line, line + 1))


class TestMap:
    """Tests by the lines that they execute, and the time that each took."""

    def __init__(self) -> None:
        from coverage import CoverageData

        self._seconds: dict[str, float] = {}
        self._modes = {}
        for mode in ("interpreted", "compiled"):
            data = CoverageData(str(KEPT / f"coverage-{mode}"))
            data.read()
            self._modes[mode] = data
            for line in (KEPT / f"seconds-{mode}.jsonl").read_text().splitlines():
                test, seconds, passed = json.loads(line)
                if passed:
                    self._seconds[test] = seconds

    def of(self, mutant: Mutant, mode: str) -> list[str]:
        """Tests of a mode that execute the mutant's line, the shortest first, within the budget.

        A line that runs at import, e.g. a constant, is left to the tests that execute any line of its module.
        """
        by_line = self._modes[mode].contexts_by_lineno(str(ROOT / mutant.path))
        lines = _statement_lines((ROOT / mutant.path).read_text(), mutant.line)
        contexts = [each for line in lines for each in by_line.get(line, [])]
        if set(contexts) == {""}:
            contexts = [each for contexts in by_line.values() for each in contexts]
        tests = {context.partition("|")[0] for context in contexts} & self._seconds.keys()
        chosen, total_s = [], 0.0
        for test in sorted(tests, key=self._seconds.__getitem__):
            total_s += self._seconds[test]
            if chosen and total_s > BUDGET_S:
                break
            chosen.append(test)
        return chosen


def judge(mutant: Mutant, tests: TestMap) -> Verdict:
    """Run the tests of the mutant's line against a copy of the tree that holds it."""
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    source = (ROOT / mutant.path).read_text()
    mutated = mutate_code(source, get_operator(f"core/{mutant.operator}")(), mutant.occurrence)
    change = mutated.splitlines()[mutant.line - 1].strip()
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(".*", "__pycache__"), symlinks=True)
        (tree / mutant.path).write_text(mutated)
        runs = [(mode, tests.of(mutant, mode)) for mode in ("interpreted", "compiled")]
        runs = [run for run in runs if run[1]] or [("compiled", list(BY_PROCESSES))]
        if "@kernel" in source:  # compiled anew with all that calls it: minutes
            runs = runs[:1]
        for mode, chosen in runs:
            if how := _failure(tree, mode, chosen):
                return Verdict(mutant, True, how, change)
    return Verdict(mutant, False, " and ".join(f"{len(chosen)} {mode}" for mode, chosen in runs), change)


def _failure(tree: Path, mode: str, tests: list[str]) -> str | None:
    """How these tests fail; None: they pass."""
    try:
        done = _pytest(tree, mode, ["-x", *tests], limit_s=LIMIT_S)
    except subprocess.TimeoutExpired:
        return "too long"
    if done.returncode == 0:
        return None
    failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return failed[0][:160] if failed else f"exit code {done.returncode}"


def _pytest(
    tree: Path,
    mode: str,
    arguments: list[str],
    variables: Mapping[str, str] | None = None,
    limit_s: float | None = None,
) -> Any:
    environment = {**os.environ, **(variables or {})}
    environment["PYTHONPATH"] = os.pathsep.join(
        str(tree / part) for part in ("emulator", "protocol", "tools")
    )
    environment["PYTHONDONTWRITEBYTECODE"] = "1"
    if mode == "interpreted":
        environment["NUMBA_DISABLE_JIT"] = "1"
    elif tree != ROOT:
        # Mutants share a cache apart from the user's, since its files are named by the sources of the kernels.
        environment["XDG_CACHE_HOME"] = str(KEPT / "cache")
    environment["MUTANTS_LIMIT_S"] = str(TEST_LIMIT_S if tree == ROOT else 5 * TEST_LIMIT_S)
    command = [sys.executable, "-m", "pytest", "-q", "--no-header", "-p", "no:cacheprovider"]
    command += ["-p", "mutants_plugin", *arguments]
    return subprocess.run(
        command, cwd=tree, env=environment, timeout=limit_s, check=False, text=True, capture_output=True
    )


def _map_lines(jobs: int) -> None:
    """Map each file of tests by itself, so that a crash costs one file."""
    from coverage import Coverage

    for mode, folders in (("interpreted", INTERPRETED), ("compiled", COMPILED)):
        files = [file for folder in folders for file in sorted((ROOT / "tests" / folder).glob("test_*.py"))]
        with tempfile.TemporaryDirectory(dir=KEPT) as parts, ThreadPoolExecutor(jobs) as pool:
            for file, last_line in pool.map(partial(_map_file, mode, Path(parts)), files):
                print(mode, file.relative_to(ROOT), last_line, flush=True)
            combined = Coverage(data_file=str(KEPT / f"coverage-{mode}"))
            combined.combine([str(part) for part in Path(parts).glob("coverage-*")], strict=True)
            combined.save()
            seconds = [part.read_text() for part in Path(parts).glob("seconds-*")]
        (KEPT / f"seconds-{mode}.jsonl").write_text("".join(seconds))


def _map_file(mode: str, parts: Path, file: Path) -> tuple[Path, str]:
    """Run a file of tests under coverage; returns it with the last line of output."""
    name = f"{file.parent.name}-{file.stem}"
    parted = {
        "COVERAGE_FILE": str(parts / f"coverage-{name}"),
        "MUTANTS_SECONDS": str(parts / f"seconds-{name}"),
    }
    covered = [f"--cov={part}" for part in ("emulator/lidar_emu", "protocol/lidar_protocol")]
    arguments = [*covered, "--cov-context=test", "--cov-report=", str(file)]
    try:
        done = _pytest(ROOT, mode, arguments, parted, LIMIT_S)
    except subprocess.TimeoutExpired:
        return file, "too long"
    return file, done.stdout.splitlines()[-1] if done.stdout else f"exit code {done.returncode}"


if __name__ == "__main__":
    main()
