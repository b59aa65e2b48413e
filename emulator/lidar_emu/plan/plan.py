"""The plan of a run: the stages computed and left out, each with its reason and error bound."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from math import ceil, floor, isfinite, log10

from lidar_emu.scenario.faults import Fault
from lidar_emu.scenario.schema import Scenario
from lidar_emu.scene.mosaic.grids import PaintedGround
from lidar_emu.scene.mosaic.nested import NestedGround
from lidar_emu.scene.ray_hits import Scene
from lidar_emu.scene.ray_reach import CroppedGrid, CroppedGround


def at_most(value: float) -> str:
    """Write a bound with two digits, rounded up."""
    if not (isfinite(value) and value > 0.0):
        return f"{value:g}"
    unit = 10.0 ** (floor(log10(value)) - 1)
    return f"{ceil(value / unit) * unit:.2g}"


@dataclass(frozen=True)
class Decision:
    """One stage of the model, computed or left out."""

    stage: str
    computed: bool
    how: str
    reason: str
    bound: str
    """The largest effect of the decision; `exact` where there is none."""


@dataclass(frozen=True)
class Plan:
    """Decisions of a run: their description, and the values that the model follows."""

    decisions: tuple[Decision, ...]
    beamlets: int = 1
    """Beamlets per beam."""
    follows_chirps: bool = False
    """Whether beams are pointed at the times of the chirps' records, to follow the curvature of their motion."""
    receiving_lag: bool = True
    """Whether echoes are dimmed by the rotation of the beam while the light travels."""
    leakage: bool = True
    """Whether beams receive the echoes of others, if the instrument has leakage."""

    def rows(self) -> list[dict[str, str | bool]]:
        """Convert the decisions to JSON values."""
        return [asdict(decision) for decision in self.decisions]


_WHEN = frozenset({"kind", "at_s", "from_s", "to_s", "probability", "lasts_s"})


def planned_faults(scenario: Scenario) -> list[Decision]:
    """One line per fault, in the scenario's order."""
    return [
        Decision(f"fault {number}", True, _how(fault), f"the scenario injects it {_when(fault)}", "as stated")
        for number, fault in enumerate(scenario.faults)
    ]


def _how(fault: Fault) -> str:
    stated = fault.model_dump(exclude=set(_WHEN), exclude_defaults=True)
    return ", ".join([fault.kind, *(f"{key} {_shown(value)}" for key, value in stated.items())])


def _shown(value: object) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    return ", ".join(map(_shown, value)) if isinstance(value, list | tuple) else str(value)


def _when(fault: Fault) -> str:
    if fault.at_s is not None:
        when = f"at {fault.at_s:g} s"
    else:
        when = f"from {fault.from_s:g} s to " + ("the end" if fault.to_s is None else f"{fault.to_s:g} s")
    if fault.probability == 1:
        return when
    lasts = f", for {fault.lasts_s:g} s each" if fault.lasts_s else ""
    return f"{when}, probability {fault.probability:g} per shot{lasts}"


_BYTES_PER_SAMPLE = 8 * 4 / 3
"""Size of a height sample with its share of the pyramid of maxima."""


def plan_parts(ground: Scene) -> Iterator[Decision]:
    """Yield a line for each seam between grids, and for each cropped grid."""
    if isinstance(ground, CroppedGround):
        yield from (_cut(grid) for grid in ground.grids)
        ground = ground.cropped
    while isinstance(ground, PaintedGround):
        ground = ground.ground
    while isinstance(ground, NestedGround):
        yield _seam(ground)
        ground = ground.outer


def plan_objects(scene: Scene, ground: Scene) -> Iterator[Decision]:
    """Yield a line for the objects that are left out."""
    if scene is ground:
        return
    from lidar_emu.scene.objects.populated_scene import SceneInMotion

    if isinstance(scene, SceneInMotion):
        scene = scene.still
    if isinstance(scene, CroppedGround) and scene is not ground:
        (cut,) = scene.grids
        yield Decision(
            "objects out of reach",
            False,
            f"{cut.retained} of {cut.samples} triangles in memory",
            "no beam of any pattern reaches them during the flight",
            "exact",
        )


def _cut(grid: CroppedGrid) -> Decision:
    saved_mb = (grid.samples - grid.retained) * _BYTES_PER_SAMPLE * 1e-6
    west_m, east_m, south_m, north_m = grid.area
    return Decision(
        "ground out of reach",
        False,
        f"{grid.retained} of {grid.samples} samples in memory: {east_m - west_m:.0f} m x {north_m - south_m:.0f} m",
        "no beam of any pattern reaches it during the flight",
        f"exact; saves {saved_mb:.0f} MB and {1 - grid.retained / grid.samples:.1%} of the pyramid",
    )


def _seam(nested: NestedGround) -> Decision:
    seam = nested.seam
    offset_m = round(seam.offset_m, 2) + 0.0  # never minus zero
    return Decision(
        "seam",
        True,
        f"blended over {seam.feather_m:.3g} m",
        f"{nested.inner.description}: {offset_m:+.2f} m ± {seam.scatter_m:.2f} m from the ground that it replaces",
        f"steps up to {seam.step_m:.2g} m",
    )
