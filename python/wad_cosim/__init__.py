"""Driving in SUMO's traffic as Gymnasium environments.

Importing this module registers the environments: ``gymnasium.make("wad_cosim/Straight-v0")``. ``wad_cosim.ids()`` lists
them, ``wad_cosim.DrivingEnv`` documents their arguments.
"""

import importlib.util as _util
import os as _os

from . import _native
from ._native import Error, InputError, SumoError
from .actions import DISCRETE_ACTIONS
from .env import DrivingEnv
from .evaluation import TrainedAgent, evaluate, load_agent, report, save_agent
from .registry import ids, register_all as _register_all, scenarios, suites, towns, weathers
from .vector import DrivingVectorEnv

__version__ = _native.VERSION.split(" ")[0]

__all__ = [
    "DISCRETE_ACTIONS",
    "DrivingEnv",
    "DrivingVectorEnv",
    "Error",
    "InputError",
    "SumoError",
    "TrainedAgent",
    "evaluate",
    "ids",
    "load_agent",
    "report",
    "save_agent",
    "scenarios",
    "suites",
    "towns",
    "weathers",
]


def _find_sumo() -> None:
    """Names the SUMO of the package eclipse-sumo, without importing it: its import changes the environment."""
    spec = _util.find_spec("sumo")
    for folder in (spec and spec.submodule_search_locations) or ():
        if _os.path.isfile(_os.path.join(folder, "bin", "sumo")):
            _native.use_sumo(folder)
            return


_find_sumo()
_register_all()
