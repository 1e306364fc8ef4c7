"""Step-by-step learning: the tasks in order, when to move on, and how often to go back. A curriculum is the file that ``wad-cosim train
agent --curriculum`` reads; ``scenarios/curriculum.json`` is an example."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from .. import _native
from .._native import InputError


@dataclass(frozen=True)
class Stage:
    """One stage."""

    #: The task of its episodes.
    task: str
    #: The next stage comes when this share (0 to 1) of the last ``window`` episodes of this task was successful.
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
            with open(path, "rb") as file:
                found = json.load(file)
        except (OSError, ValueError) as error:
            raise InputError(f"cannot read the curriculum {os.fspath(path)}: {error}") from None
        return Curriculum.of(found, os.fspath(path))

    @staticmethod
    def of(found: Any, name: str = "curriculum") -> Curriculum:
        """A curriculum of JSON's values; ``name`` is what errors call it."""

        def checked(kind: Any, value: Any) -> dict[str, Any]:
            if not isinstance(value, Mapping):
                raise InputError(f"{name}: expected an object with {', '.join(each.name for each in fields(kind))}, found {value!r}")
            if unknown := set(value) - {each.name for each in fields(kind)}:
                raise InputError(f"{name}: unknown field {', '.join(sorted(unknown))}")
            return dict(value)

        given = checked(Curriculum, found)
        try:
            given["stages"] = tuple(Stage(**checked(Stage, stage)) for stage in given["stages"])
            given["weathers"] = tuple(given["weathers"])
            made = Curriculum(**given)
            problem = made._problem()
        except (KeyError, TypeError) as error:
            raise InputError(f"{name} is not a curriculum: {error}; scenarios/curriculum.json is an example") from None
        if problem:
            raise InputError(f"{name}: {problem}")
        return made

    def _problem(self) -> str | None:
        names = _native.names()
        if not self.stages:
            return "expected one stage or more in `stages`, found none"
        if not self.weathers or not set(self.weathers) <= set(names["weathers"]):
            return f"weathers {', '.join(self.weathers) or 'none'}: expected some of {', '.join(names['weathers'])}"
        if not 0 <= self.replay < 1:
            return f"expected `replay` from 0 to below 1, found {self.replay}"
        for number, stage in enumerate(self.stages):
            at = f"stage {number} ({stage.task})"
            if stage.task not in names["tasks"]:
                return f"{at}: expected one of {', '.join(names['tasks'])}"
            if not 0 <= stage.threshold <= 1:
                return f"{at}: expected `threshold` from 0 to 1, found {stage.threshold}"
            if stage.window < 1 or (stage.most_steps is not None and stage.most_steps < 0):
                return f"{at}: expected `window` of 1 or more and `most_steps` of 0 or more"
        return None

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
    #: Success of the last episodes of its task, oldest first.
    recent: list[bool] = field(default_factory=list)
    #: The last stage's threshold has been passed too.
    done: bool = False

    def rate(self) -> float:
        """Share of the last episodes of the stage's task that were successful; 0 before the first."""
        return sum(self.recent) / max(len(self.recent), 1)

    def note(self, curriculum: Curriculum, task: str, steps: int, success: bool) -> Passed | None:
        """Notes an episode of ``steps`` steps; says how the stage was passed, where this episode passes it."""
        stage = curriculum.stages[self.stage]
        self.steps += steps
        if task == stage.task:
            self.recent = [*self.recent, success][-stage.window :]
        threshold = len(self.recent) == stage.window and self.rate() >= stage.threshold
        passed = Passed(self.stage, threshold, self.steps, self.rate())
        if self.stage + 1 == len(curriculum.stages):
            first = threshold and not self.done
            self.done |= threshold
            return passed if first else None
        if threshold or (stage.most_steps is not None and self.steps >= stage.most_steps):
            self.stage, self.steps, self.recent = self.stage + 1, 0, []
            return passed
        return None
