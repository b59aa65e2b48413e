"""Simulate runs: `python -m simulated_runtime 1000` those of seeds 0 to 999, `17` to `18` as `17:18`."""

from __future__ import annotations

import re
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from time import monotonic

from simulated_runtime.plan import Plan, draw
from simulated_runtime.shorten import shorten
from simulated_runtime.simulation import Result, simulate


def failure_of(plan: Plan) -> str | None:
    """Why a run of the plan fails; None: it does not."""
    try:
        simulate(plan)
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return None


def shortened(plan: Plan, failure: str) -> Plan:
    """The shortest plan found that fails for the same reason."""
    reason = failure.partition(": ")[2].split(":")[0]
    return shorten(plan, lambda fewer: reason in (failure_of(fewer) or ""))


def simulated(seed: int) -> Result | str:
    """The result of a seed's run, or what the user is told about its failure."""
    plan = draw(seed)
    try:
        return simulate(plan)._replace(trace="")
    except Exception as error:
        failure = f"{type(error).__name__}: {error}"
        short = shortened(plan, failure)
        return f"FAILED {failure}\n{short}\nrepeat: make simulate-runtime SEEDS={seed}:{seed + 1}"


def main(seeds: range) -> int:
    """Simulate the runs of these seeds on all cores; print what fails, shortened, and what was done."""
    packets, failed, began_s = 0, 0, monotonic()
    statuses: Counter[str] = Counter()
    endings: Counter[str] = Counter()
    with ProcessPoolExecutor() as pool:
        for result in pool.map(simulated, seeds, chunksize=4):
            if isinstance(result, str):
                failed += 1
                print(result, flush=True)
                continue
            packets += result.packets
            endings[re.sub(r"[\d.]+", "N", result.ending)] += 1
            statuses.update({status.name.lower(): count for status, count in result.statuses.items()})
    per_minute = packets / (monotonic() - began_s) * 60
    print(f"{len(seeds)} runs, {failed} failed; {packets} packets, {per_minute:.0f} a minute")
    for counts in (statuses, endings):
        print(", ".join(f"{name} {count}" for name, count in counts.most_common()))
    return int(failed > 0)


if __name__ == "__main__":
    first, _, end = sys.argv[1].rpartition(":")
    sys.exit(main(range(int(first or 0), int(end))))
