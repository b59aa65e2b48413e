"""Complaints about a scenario: what they cost."""

import pytest
from pydantic import BaseModel

from lidar_emu.errors import InputError
from lidar_emu.scenario import explain
from lidar_emu.scenario.load import load


def test_the_schema_is_made_once_for_any_number_of_complaints(monkeypatch):
    """A campaign may draw thousands of values that are not allowed; making the schema takes a quarter of a second."""
    made = []
    make = BaseModel.model_json_schema.__func__
    monkeypatch.setattr(
        BaseModel, "model_json_schema", classmethod(lambda model: made.append(model) or make(model))
    )
    explain._schema.cache_clear()
    for share in ("2", "3", "4"):
        with pytest.raises(InputError, match="less than or equal to 1"):
            load("descent.yaml", {"site.surface.reflectance": share})
    assert len(made) == 1
