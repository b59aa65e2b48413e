"""Loads and compiles what programs under test need; imported once by the server that they are forked from."""

from __future__ import annotations

from importlib import import_module
from pkgutil import walk_packages

import rich.live  # noqa: F401

import lidar_emu

for _package in ("cli", "runtime", "recording", "transports"):
    _path = import_module(f"lidar_emu.{_package}").__path__
    for _module in walk_packages(_path, f"lidar_emu.{_package}."):
        import_module(_module.name)

for _settings in ({}, {"level": "geometric", "site": "flat"}):
    lidar_emu.simulate(lidar_emu.load("descent.yaml", {"duration_s": "0.1", **_settings}))
lidar_emu.simulate(lidar_emu.load("bench.yaml"))
