"""Observations: their spaces, and the arrays that they are written to.

The raw states (``observation="raw"``), each cut to its bounds:

====== ================================================================= ============ =======
index  what                                                              scaled by    bounds
====== ================================================================= ============ =======
0      speed                                                             15 m/s       -2 to 2
1      speed over the speed limit, less 1                                             -2 to 2
2      distance from the lane's centre, left positive                    1.75 m       -2 to 2
3-8    road option: LaneFollow, Left, Right, Straight, ChangeLaneLeft,                0 or 1
       ChangeLaneRight
9, 10  bearing of the waypoint ahead, and of the one 10 m further        45 degrees   -2 to 2
11     nearness of the vehicle in front: 1 - ln(1 + d) / ln 51           50 m         0 to 1
12     closing speed to it                                               10 m/s       -2 to 2
13     a light ahead must be stopped for                                              0 or 1
14     nearness of its stop line                                         50 m         0 to 1
====== ================================================================= ============ =======
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from . import _native
from ._native import InputError

#: Names of the raw states by index.
RAW_NAMES = (
    "speed",
    "speed_over_limit",
    "lateral",
    "lane_follow",
    "left",
    "right",
    "straight",
    "change_lane_left",
    "change_lane_right",
    "bearing",
    "bearing_far",
    "lead_nearness",
    "lead_closing_speed",
    "stop_light",
    "stop_light_nearness",
)

#: The values of ``observation=``.
FORMS = ("raw", "image", "transformed", "dict")

_UNIT = (3, 4, 5, 6, 7, 8, 11, 13, 14)


def _raw_space() -> spaces.Box:
    low, high = np.full(_native.RAW_SIZE, -2, np.float32), np.full(_native.RAW_SIZE, 2, np.float32)
    low[list(_UNIT)], high[list(_UNIT)] = 0, 1
    return spaces.Box(low, high)


def parts_of(form: Any) -> tuple[str, ...]:
    """The parts of an observation: its form, or the names of a dictionary."""
    if form == "dict":
        return ("raw", "image")
    names = (form,) if isinstance(form, str) else tuple(form)
    known = [name for name in FORMS if name != "dict"]
    if not names or len(set(names)) != len(names) or any(name not in known for name in names):
        raise InputError(f"observation={form!r}: expected one of {', '.join(FORMS)}, or several of {', '.join(known)}")
    return names


def space_of(part: str, camera: tuple[int, int]) -> spaces.Box:
    """The space of a part; ``camera`` is its picture's height and width."""
    if part == "raw":
        return _raw_space()
    side = _native.TRANSFORMED_SIZE
    height, width = camera if part == "image" else (side, side)
    return spaces.Box(0, 255, (height, width, 3), np.uint8)


class Arrays:
    """The arrays that the simulator writes, a row for each environment."""

    def __init__(self, form: Any, count: int, camera: tuple[int, int]) -> None:
        self.parts = parts_of(form)
        #: Whether an observation is a dictionary.
        self.named = not isinstance(form, str) or form == "dict"
        boxes = {part: space_of(part, camera) for part in self.parts}
        self.space: spaces.Space[Any] = spaces.Dict(boxes) if self.named else boxes[self.parts[0]]
        self.arrays: dict[str, NDArray[Any]] = {
            part: np.zeros((count, *box.shape), box.dtype) for part, box in boxes.items()
        }
        self.numbers = np.zeros((count, len(_native.NUMBERS)))

    def native(self) -> dict[str, NDArray[Any]]:
        """As the simulator takes them."""
        return {**self.arrays, "numbers": self.numbers}

    def one(self, index: int) -> Any:
        """A copy of an environment's observation."""
        if self.named:
            return {part: array[index].copy() for part, array in self.arrays.items()}
        return self.arrays[self.parts[0]][index].copy()

    def all(self, copy: bool) -> Any:
        """The observations of all environments."""
        if self.named:
            return {part: array.copy() if copy else array for part, array in self.arrays.items()}
        array = self.arrays[self.parts[0]]
        return array.copy() if copy else array
