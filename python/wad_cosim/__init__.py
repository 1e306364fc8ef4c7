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


def _find(package: str, file: str) -> str | None:
    """The folder of an installed package that has ``file``, without importing it: imports change the environment."""
    spec = _util.find_spec(package)
    folders = (spec and spec.submodule_search_locations) or ()
    return next((folder for folder in folders if _os.path.exists(_os.path.join(folder, file))), None)


if _sumo := _find("sumo", "bin/sumo"):
    _native.use_sumo(_sumo)
if _openvino := _find("openvino", "libs"):
    _native.use_openvino(_os.path.join(_openvino, "libs"))
_register_all()
