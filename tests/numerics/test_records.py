"""Records that kernels take as arguments."""

from typing import NamedTuple

from lidar_emu.numerics.arrays import as_record


class _Axis(NamedTuple):
    length_m: float
    cells: int


class _Grid(NamedTuple):
    east: _Axis
    corner_m: tuple[float, float, float]


def _grid(length_m: float, cells: int) -> _Grid:
    return _Grid(_Axis(length_m, cells), (1.0, 2.0, length_m))


def test_a_record_holds_the_values_of_its_tuple() -> None:
    record = as_record(_grid(3.5, 7))
    assert record.shape == (1,)
    assert record[0]["east"]["length_m"] == 3.5
    assert record[0]["east"]["cells"] == 7
    assert record[0]["corner_m"].tolist() == [1.0, 2.0, 3.5]


def test_records_of_equal_fields_share_one_dtype_object() -> None:
    """numba finds an argument's type by identity of its dtype; an equal dtype costs a comparison in every call."""
    assert as_record(_grid(3.5, 7)).dtype is as_record(_grid(4.5, 8)).dtype
