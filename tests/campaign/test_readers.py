"""The tables as other people's libraries read them, also by the query that the documentation shows."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).resolve().parents[2] / "docs" / "campaigns.md"
READERS = ("pandas", "polars", "duckdb")


def means(library: str, folder: str) -> dict[int, tuple[int, float]]:
    """Beams and mean range of each run, joined with its own row."""
    if library == "pandas":
        import pandas as pd

        runs, beams = pd.read_parquet(f"{folder}/runs"), pd.read_parquet(f"{folder}/beams")
        grouped = beams.merge(runs[["run", "seed"]], on="run").groupby("run")["range_m"]
        return {run: (len(ranges), ranges.mean()) for run, ranges in grouped}
    if library == "polars":
        import polars as pl

        runs, beams = (pl.scan_parquet(f"{folder}/{table}/*.parquet") for table in ("runs", "beams"))
        joined = beams.join(runs.select("run", "seed"), on="run").group_by("run")
        rows = joined.agg(pl.len(), pl.col("range_m").mean()).collect().rows()
        return {run: (count, mean) for run, count, mean in rows}
    import duckdb

    query = f"""
        select run, count(*), avg(range_m) from '{folder}/beams/*.parquet' join '{folder}/runs/*.parquet' using (run)
        group by run"""
    return {run: (count, mean) for run, count, mean in duckdb.sql(query).fetchall()}


def test_all_read_the_same(fly, tmp_path):
    fly()
    found = {library: means(library, str(tmp_path / "out")) for library in READERS}
    for reported in found.values():
        assert sorted(reported) == list(range(12))
        assert {count for count, _ in reported.values()} == {32}
    for run, (_, mean_m) in found["duckdb"].items():
        assert found["pandas"][run][1] == pytest.approx(mean_m, rel=1e-12)
        assert found["polars"][run][1] == pytest.approx(mean_m, rel=1e-12)
        assert 700 < mean_m < 1500


def test_the_query_of_the_page_works(fly, tmp_path):
    import duckdb

    fly("trial")
    query = re.search(r'duckdb\.sql\("""(.+?)"""\)', PAGE.read_text(), re.DOTALL)[1]
    found = duckdb.sql(query.replace("trial/", f"{tmp_path}/trial/")).fetchall()
    assert [share for share, _ in found] == sorted({share for share, _ in found})
    assert all(0.1 <= reflectance <= 0.3 and 0.0 <= valid <= 1.0 for reflectance, valid in found)
