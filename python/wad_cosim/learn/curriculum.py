"""Step-by-step learning: the tasks in order, when to move on, and how often to go back. A curriculum is the file that ``wad-cosim train
agent --curriculum`` reads, by the same code; ``scenarios/curriculum.json`` is an example."""

from __future__ import annotations

import json
import os
import pathlib
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from .. import _native
from .._native import InputError


@dataclass(frozen=True)
class Stage:
    """One stage."""

    #: The task of its episodes.
    task: str
    #: The next stage comes when this share (0 to 1) of the last ``window`` episodes of this stage was successful.
    threshold: float
    window: int
    #: Environment steps after which the next stage comes in any case; None: never.
    most_steps: int | None = None
    #: None: the task's own.
    traffic: str | None = None


@dataclass(frozen=True)
class Curriculum:
    """The stages, easiest first."""

    town: str
    #: One of them is drawn per episode.
    weathers: tuple[str, ...]
    #: Share (0 to 1) of the driving that goes back to an earlier stage's task, drawn evenly.
    replay: float
    stages: tuple[Stage, ...]

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Curriculum:
        """Reads a curriculum.

        Raises:
            InputError: The file cannot be read, has an unknown or a missing field, or a value out of range.
        """
        try:
            text = pathlib.Path(path).read_text()
        except (OSError, ValueError) as error:
            raise InputError(f"cannot read the curriculum {os.fspath(path)}: {error}") from None
        return Curriculum._parse(text, path)

    @staticmethod
    def of(found: Any, name: str = "curriculum") -> Curriculum:
        """A curriculum of JSON's values; ``name`` is what errors call it."""
        return Curriculum._parse(json.dumps(found), name)

    @staticmethod
    def _parse(text: str, name: str | os.PathLike[str]) -> Curriculum:
        _native.check_curriculum(text, name)
        found = json.loads(text)
        stages = tuple(Stage(**stage) for stage in found.pop("stages"))
        return Curriculum(stages=stages, weathers=tuple(found.pop("weathers")), **found)

    def draw(self, stage: int, rng: np.random.Generator) -> int:
        """The stage to drive next: ``stage``, or an earlier one."""
        back = stage > 0 and rng.random() < self.replay
        return int(rng.integers(stage)) if back else stage


@dataclass(frozen=True)
class Passed:
    """How a stage was left."""

    stage: int
    #: Its threshold was reached; False: its steps were spent.
    threshold: bool
    #: Environment steps spent in it.
    steps: int
    #: Share of its last episodes that were successful (0 to 1).
    rate: float


@dataclass
class Progress:
    """A training's progress in a curriculum; part of its checkpoint."""

    stage: int = 0
    #: Environment steps spent in it.
    steps: int = 0
    #: Success of the last episodes of the stage, oldest first.
    recent: list[bool] = field(default_factory=list)
    #: The last stage's threshold has been passed too.
    done: bool = False

    def note(self, curriculum: Curriculum, drawn: int, steps: int, success: bool) -> Passed | None:
        """Notes an episode of the stage ``drawn``, of ``steps`` steps; says how the stage was passed, where this episode passes it."""
        after, left = _native.note_episode(json.dumps(asdict(curriculum)), json.dumps(asdict(self)), drawn, steps, success)
        vars(self).update(json.loads(after))
        return None if left is None else Passed(*left)
