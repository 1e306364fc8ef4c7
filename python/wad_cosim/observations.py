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

The vector (``observation="vector"``) comes from the world itself, without a camera: it knows who is hidden, and every speed.
A part that is not there is 0.

========= ============================================================== ============ =======
index     what                                                           scaled by    bounds
========= ============================================================== ============ =======
0-19      points of the route 5, 10, ... 50 m ahead: ahead, left         50 m         -2 to 2
20, 21    speed limit here, and 30 m ahead                               15 m/s       0 to 2
22-24     the next signal within 50 m: red, yellow, green                             0 or 1
25        nearness of its stop line                                      50 m         0 to 1
26, 27    the next junction within 50 m where the ego gives way: 1;      50 m         0 to 1
          nearness of its stop line
28 + 12 k road user k of the twelve nearest within 50 m: 1                            0 or 1
+ 1, 2    its centre ahead and left of the ego's                         50 m         -2 to 2
+ 3, 4    cosine and sine of its heading less the ego's                               -1 to 1
+ 5       its speed                                                      15 m/s       -2 to 2
+ 6, 7    length; width                                                  10 m; 3 m    0 to 2
+ 8-10    motor vehicle; two-wheeler; person                                          0 or 1
+ 11      its brake lights are on                                                     0 or 1
172-186   the raw states, here from the same source
========= ============================================================== ============ =======

The latent (``observation="latent"``, paper, figure 4): 200 numbers that the encoder makes of the transformed image, each with mean 0
and deviation 1 over its training's images, then the raw states, 15. The transformed image (``observation="transformed"``):
128 x 128 x 3 bytes, RGB.
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

_USER_NAMES = (
    "there",
    "ahead",
    "left",
    "cos_heading",
    "sin_heading",
    "speed",
    "length",
    "width",
    "motor_vehicle",
    "two_wheeler",
    "person",
    "brake_lights",
)

#: Names of the vector by index.
VECTOR_NAMES = (
    *(f"route_{metres}_{side}" for metres in range(5, 55, 5) for side in ("ahead", "left")),
    "speed_limit",
    "speed_limit_ahead",
    "signal_red",
    "signal_yellow",
    "signal_green",
    "signal_nearness",
    "give_way",
    "give_way_nearness",
    *(f"user_{user}_{what}" for user in range(12) for what in _USER_NAMES),
    *RAW_NAMES,
)

#: The values of ``observation=``.
FORMS = ("raw", "vector", "latent", "image", "transformed", "dict")

_UNIT = (3, 4, 5, 6, 7, 8, 11, 13, 14)


def _raw_space() -> spaces.Box:
    low, high = np.full(_native.RAW_SIZE, -2, np.float32), np.full(_native.RAW_SIZE, 2, np.float32)
    low[list(_UNIT)], high[list(_UNIT)] = 0, 1
    return spaces.Box(low, high)


def _vector_space() -> spaces.Box:
    user_low, user_high = [0, -2, -2, -1, -1, -2, 0, 0, 0, 0, 0, 0], [1, 2, 2, 1, 1, 2, 2, 2, 1, 1, 1, 1]
    users = (_native.VECTOR_SIZE - _native.RAW_SIZE - 28) // len(user_low)
    raw = _raw_space()
    low = [-2] * 20 + [0] * 8 + user_low * users
    high = [2] * 22 + [1] * 6 + user_high * users
    return spaces.Box(np.array([*low, *raw.low], np.float32), np.array([*high, *raw.high], np.float32))


def _latent_space() -> spaces.Box:
    raw = _raw_space()
    # Far beyond what any picture gives.
    most = np.full(_native.LATENT_SIZE, 1000, np.float32)
    return spaces.Box(np.concatenate([-most, raw.low]), np.concatenate([most, raw.high]))


def parts_of(form: Any) -> tuple[str, ...]:
    """The parts of an observation: its form, or the names of a dictionary."""
    if form == "dict":
        return ("raw", "image")
    names = (form,) if isinstance(form, str) else tuple(form)
    known = [name for name in FORMS if name != "dict"]
    if not names or len(set(names)) != len(names) or any(name not in known for name in names):
        raise InputError(f"observation={form!r}: expected one of {', '.join(FORMS)}, or several of {', '.join(known)}")
    return names


def found_by(form: Any) -> str:
    """The detector of an environment with this observation, where nobody chose one."""
    # Where the camera draws anyhow, its boxes cost nothing.
    return "truth" if {"latent", "transformed"} & set(parts_of(form)) else "outlines"


def space_of(part: str, camera: tuple[int, int]) -> spaces.Box:
    """The space of a part; ``camera`` is its picture's height and width."""
    if part == "raw":
        return _raw_space()
    if part == "vector":
        return _vector_space()
    if part == "latent":
        return _latent_space()
    side = _native.TRANSFORMED_SIZE
    height, width = camera if part == "image" else (side, side)
    return spaces.Box(0, 255, (height, width, 3), np.uint8)


class Arrays:
    """The arrays that the simulator writes, a row for each environment."""

    def __init__(self, form: Any, count: int, camera: tuple[int, int]) -> None:
        self.parts = parts_of(form)
        #: Whether an observation is a dictionary.
        self.named = not isinstance(form, str) or form == "dict"
        boxes: dict[str, spaces.Space[Any]] = {part: space_of(part, camera) for part in self.parts}
        self.space: spaces.Space[Any] = spaces.Dict(boxes) if self.named else boxes[self.parts[0]]
        self.arrays: dict[str, NDArray[Any]] = {
            part: np.zeros((count, *(box.shape or ())), box.dtype) for part, box in boxes.items()
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
