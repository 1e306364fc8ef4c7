"""The environments' ids, and what travels with the package."""

from __future__ import annotations

import functools
import json
from typing import Any

import gymnasium

from . import _native

_TITLES = {"tasks": "", "composite": "", "corl2017": "CoRL2017", "nocrash": "NoCrash", "infractions": ""}


@functools.cache
def suites() -> dict[str, dict[str, Any]]:
    """The bundled benchmarks by name, as docs/evaluate.md describes their files."""
    return {suite["name"]: suite for suite in json.loads(_native.suites())}


def towns() -> list[str]:
    """Names of the bundled towns."""
    return list(_native.names()["towns"])


def scenarios() -> list[str]:
    """Names of the bundled scenarios."""
    return list(_native.names()["scenarios"])


def weathers() -> list[str]:
    """Names of the weathers."""
    return list(_native.names()["weathers"])


def _camel(name: str) -> str:
    return "".join(word.capitalize() for word in name.split("_"))


@functools.cache
def _ids() -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for name, suite in suites().items():
        for task in suite["tasks"]:
            found[f"wad_cosim/{_TITLES.get(name, _camel(name))}{_camel(task['name'])}-v0"] = {
                "suite": name,
                "task": task["name"],
            }
    found["wad_cosim/Navigation-v0"] = {"task": "navigation"}
    found["wad_cosim/Scenario-v0"] = {"town": "cross"}
    return found


def ids() -> list[str]:
    """The ids of all environments: the tasks, the benchmarks' tasks, and ``Scenario-v0`` for a scenario by its
    name or folder (``town=``)."""
    return list(_ids())


def register_all() -> None:
    """Makes the ids known to Gymnasium."""
    for id, kwargs in _ids().items():
        if id not in gymnasium.registry:
            gymnasium.register(
                id=id,
                entry_point="wad_cosim.env:DrivingEnv",
                vector_entry_point="wad_cosim.vector:DrivingVectorEnv",
                kwargs=kwargs,
            )
