"""The query of a campaign's tables that the documentation shows."""

import os
import re
from pathlib import Path

import pytest

PAGE = Path(__file__).resolve().parents[2] / "docs" / "campaigns.md"


def test_the_query_of_the_page_works(fly, tmp_path):
    duckdb = pytest.importorskip("duckdb", reason="duckdb is not installed")
    fly("trial")
    query = re.search(r'duckdb\.sql\("""(.+?)"""\)', PAGE.read_text(), re.DOTALL)[1]
    found = duckdb.sql(query.replace("trial/", f"{tmp_path}{os.sep}trial{os.sep}")).fetchall()
    assert [share for share, _ in found] == sorted({share for share, _ in found})
    assert all(0.1 <= reflectance <= 0.3 and 0.0 <= valid <= 1.0 for reflectance, valid in found)
