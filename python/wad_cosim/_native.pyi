"""The simulator's half of the package; see the Python modules for what users call."""

import os
from collections.abc import Callable, Sequence
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Collection",
    "Collector",
    "DEFAULT_DETECTOR",
    "Environments",
    "Error",
    "InputError",
    "LATENT_SIZE",
    "Ledger",
    "LoadedAgent",
    "NUMBERS",
    "RAW_SIZE",
    "SumoError",
    "TRANSFORMED_SIZE",
    "VECTOR_SIZE",
    "VERSION",
    "WHOLE",
    "Worker",
    "bench",
    "check_curriculum",
    "evaluate",
    "info_of",
    "names",
    "note_episode",
    "report_of",
    "save_agent",
    "suites",
    "use_openvino",
    "use_sumo",
]

DEFAULT_DETECTOR: str
VERSION: str
NUMBERS: list[str]
WHOLE: list[str]
RAW_SIZE: int
VECTOR_SIZE: int
LATENT_SIZE: int
TRANSFORMED_SIZE: int

class Error(RuntimeError):
    """The simulator failed, or was used out of order."""

class SumoError(Error):
    """SUMO is missing, did not start or died."""

class InputError(ValueError):
    """An argument is wrong; the text says what is expected."""

@final
class Environments:
    """Environments that are driven together, each on a thread of its own."""

    def __new__(
        cls,
        count: int,
        setup: str,
        now: dict[str, NDArray[Any]],
        last: dict[str, NDArray[Any]] | None,
        autoreset: str,
    ) -> Environments: ...
    def reset(self, seeds: Sequence[int | None], route: int | None = None) -> None: ...
    def step(
        self, actions: NDArray[np.float32], seeds: Sequence[int]
    ) -> list[tuple[int, bool, list[dict[str, Any]], tuple[str, str, bool] | None]]: ...
    def step_one(
        self, action: NDArray[np.float32]
    ) -> tuple[dict[str, NDArray[Any]], float, bool, bool, dict[str, Any]]: ...
    def expert(self) -> list[list[float]]: ...
    def picture(self, index: int) -> NDArray[np.uint8]: ...
    def sumos(self) -> list[int | None]: ...
    def close(self) -> None: ...
    @property
    def closed(self) -> bool: ...

@final
class LoadedAgent:
    """A trained agent."""

    def __new__(cls, name: str) -> LoadedAgent: ...
    @property
    def observation(self) -> str: ...
    @property
    def encoder(self) -> str: ...
    def act(self, observation: NDArray[np.float32]) -> list[float]: ...
    def check_encoder(self, name: str) -> None: ...

@final
class Ledger:
    """An evaluation's folder with its plan, for episodes that are driven elsewhere."""

    def __new__(cls, wanted: str, act: Callable[..., Any] | None) -> Ledger: ...
    @property
    def manifest(self) -> str: ...
    @property
    def planned(self) -> int: ...
    @property
    def done(self) -> int: ...
    def left(self) -> list[str]: ...
    def add(self, line: bytes, recording: tuple[bytes, bytes] | None) -> bool: ...
    def finish(self) -> str: ...

@final
class Worker:
    """Drives episodes of a ledger, wherever that is."""

    def __new__(cls, manifest: str, encoder: str, keep: str, agent_timeout: float, act: Callable[..., Any] | None) -> Worker: ...
    def drive(self, case: str) -> tuple[bytes, tuple[bytes, bytes] | None]: ...

@final
class Collection:
    """A dataset's folder with its plan, for segments that are driven elsewhere."""

    def __new__(cls, wanted: str) -> Collection: ...
    @property
    def identity(self) -> str: ...
    @property
    def wanted(self) -> int: ...
    def missing(self) -> tuple[list[str], int]: ...
    def put(self, segment: str, shard: bytes) -> bool: ...
    def finish(self, interrupted: bool) -> str: ...

@final
class Collector:
    """Drives segments of a collection, wherever that is."""

    def __new__(cls, wanted: str, expected: str) -> Collector: ...
    def drive(self, segment: str) -> bytes: ...

def names() -> dict[str, list[str]]: ...
def check_curriculum(text: str, name: str | os.PathLike[str]) -> None: ...
def note_episode(
    curriculum: str, progress: str, drawn: int, steps: int, success: bool
) -> tuple[str, tuple[int, bool, int, float] | None]: ...
def suites() -> str: ...
def use_openvino(folder: str | os.PathLike[str]) -> None: ...
def use_sumo(home: str | os.PathLike[str]) -> None: ...
def bench(setup: str, seed: int, steps: int) -> list[float]: ...
def info_of(numbers: NDArray[np.float64]) -> dict[str, Any]: ...
def evaluate(
    wanted: str,
    act: Callable[[NDArray[np.float32] | None, int], Sequence[float] | None] | None,
    watch: Callable[[int, int], None] | None,
) -> str: ...
def report_of(
    folders: Sequence[str | os.PathLike[str]], pools: Sequence[tuple[str, Sequence[str]]]
) -> str: ...
def save_agent(
    path: str | os.PathLike[str], trained: str, layers: Sequence[tuple[int, int]], values: NDArray[np.float32]
) -> None: ...
