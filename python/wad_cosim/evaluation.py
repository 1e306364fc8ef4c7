"""Benchmarks: any policy judged as the command line judges agents, with the same routes, seeds and records."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native, actions, observations
from ._native import InputError

_MODES = {"raw": "raw_only", "vector": "vector", "latent": "latent_and_raw"}
#: The same under the names of agents' files.
_INPUTS = {"raw": "raw", "vector": "vector", "latent": "both"}


def evaluate(
    suite: str,
    agent: Any = "autopilot",
    *,
    name: str | None = None,
    observation: str | None = None,
    action: Any = "continuous",
    detector: str | None = None,
    mirrors: bool = False,
    encoder: str | os.PathLike[str] | None = None,
    agent_timeout: float = 10.0,
    condition: str | Iterable[str] = (),
    task: str | Iterable[str] = (),
    town: str | Iterable[str] = (),
    weather: str | Iterable[str] = (),
    weathers_in_turn: bool = False,
    traffic: str | Iterable[str] = (),
    episodes: int | None = None,
    seed: int | Iterable[int] = (),
    jobs: int | None = None,
    out: str | os.PathLike[str] | None = None,
    resume: bool = False,
    keep: str = "failures",
    progress: bool = False,
    ray: bool | str = False,
) -> Any:
    """Drives the episodes of a benchmark, as ``wad-cosim eval`` does.

    Args:
        suite: ``tasks``, ``composite``, ``corl2017``, ``nocrash``, ``infractions``, a suite's JSON file or a scenario.
        agent: A function of an observation that gives an action; an object with ``predict(observation,
            deterministic=True)`` such as a model of Stable-Baselines3; or a driver by name: ``autopilot``, ``random``,
            ``constant:THROTTLE,STEER,BRAKE``, ``wad-t``, ``wad-s``, or the file
            of a trained agent, which bring their encoder, or ``exec:COMMAND``, a program over a pipe (docs/evaluate.md). If it has a method ``reset``, that is called at an episode's begin.
        name: Its name in tables. Default: the function's or the class's.
        observation: What it gets: ``raw``, ``vector`` or ``latent``, as :class:`DrivingEnv` has them. Default: for what
            :func:`load_agent` gave what it needs, else ``raw``.
        action: What it gives, as :class:`DrivingEnv`'s ``action``.
        detector: As the command line's ``--detector``. Default: for a driver by name and for what
            :func:`load_agent` gave the command line's, ``eyes``, which needs ``wad-cosim[eyes]``; for a policy that of
            :class:`DrivingEnv` with this observation.
        mirrors: Cameras in place of the door mirrors look back before a change of lane (docs/perception.md).
        encoder: What makes the latent of ``observation="latent"``. Default: for what :func:`load_agent` gave that of its
            training, else ``default``.
        agent_timeout: Seconds for each answer of an ``exec:`` agent.
        condition, task, town, weather, traffic, seed: Only these of the suite; one or several.
        weathers_in_turn: Take the weathers in turn, episode by episode, instead of driving all episodes in each of them.
        episodes: Episodes per task, town and weather (per task and town with ``weathers_in_turn``). Default: the suite's.
        jobs: Environments in parallel. Several call the agent from as many threads, one at a time; one with a method ``reset``
            needs ``ray`` for several. Default: 1; with ``ray`` as many as the cluster has cores.
        out: A folder for config.json, episodes.jsonl, summary.json and recordings.
        resume: Go on with the evaluation in ``out``.
        keep: Which episodes to record in ``out``: ``none``, ``failures`` or ``all``.
        progress: Say on stderr how far it is.
        ray: Drive the episodes on a Ray cluster: ``True`` for the one that this process or machine is part of, ``local`` for one
            of this machine alone, or an address. Each worker has a copy of the agent. Needs ``wad-cosim[ray]``.

    Returns:
        A row for each agent, condition, town and task: a pandas DataFrame where pandas is installed, else a list of
        dictionaries. Rates are fractions; ``interval`` is Wilson's 95 % interval.

    Raises:
        InputError: An argument is wrong, or ``out`` holds other results.
        SumoError: SUMO failed.
    """
    if isinstance(agent, TrainedAgent):
        if observation not in (None, agent.observation):
            raise InputError(f"observation={observation!r}: this agent needs {agent.observation!r}; leave observation out")
        observation = agent.observation
        encoder = agent.encoder if encoder is None else encoder
        agent.check_encoder(encoder)
    observation = "raw" if observation is None else observation
    if observation not in _MODES:
        raise InputError(f"observation={observation!r}: expected one of {', '.join(_MODES)}")
    if jobs is not None and jobs > 1 and not ray and callable(getattr(agent, "reset", None)):
        raise InputError(
            f"jobs={jobs}: the agent has a method `reset`, and one agent cannot drive several episodes at once; use jobs=1, or "
            'ray="local", where each worker has a copy'
        )
    act: Callable[[Any, int], Any] | None = None
    is_ours = isinstance(agent, str | TrainedAgent)
    detector = detector or (_native.DEFAULT_DETECTOR if is_ours else observations.found_by(observation))
    if isinstance(agent, str):
        called = agent
    else:
        called = name or getattr(agent, "__name__", None) or type(agent).__name__
        act = _driver(agent, action)
    wanted = wanted_by(
        suite,
        [called],
        condition=condition,
        task=task,
        town=town,
        weather=weather,
        weathers_in_turn=weathers_in_turn,
        traffic=traffic,
        seed=seed,
        episodes=episodes,
        observation=observation,
        detector=detector,
        mirrors=mirrors,
        encoder="default" if encoder is None else encoder,
        agent_timeout=agent_timeout,
        jobs=jobs,
        out=out,
        resume=resume,
        keep=keep,
    )
    if ray:
        from .ray import prepare

        address = "auto" if ray is True else ray
        prepare(address)
        from .ray import evaluation as on_ray

        summary = on_ray.evaluate(wanted, act, address=address, workers=jobs, progress=progress)
    else:
        summary = json.loads(_native.evaluate(json.dumps(wanted), act, _say if progress else None))
    return _table(summary["totals"])


def wanted_by(
    suite: str,
    agents: list[str],
    *,
    condition: str | Iterable[str],
    task: str | Iterable[str],
    town: str | Iterable[str],
    weather: str | Iterable[str],
    traffic: str | Iterable[str],
    seed: int | Iterable[int],
    episodes: int | None,
    detector: str,
    out: str | os.PathLike[str] | None,
    resume: bool,
    keep: str,
    weathers_in_turn: bool = False,
    observation: str = "raw",
    mirrors: bool = False,
    encoder: str | os.PathLike[str] = "default",
    agent_timeout: float = 10.0,
    jobs: int | None = None,
) -> dict[str, Any]:
    """The evaluation as the simulator's half reads it; see :func:`evaluate`."""
    return {
        "suite": suite,
        "selection": {
            "agents": agents,
            "tasks": _list(task),
            "conditions": _list(condition),
            "towns": _list(town),
            "weathers": _list(weather),
            "weathers_in_turn": weathers_in_turn,
            "seeds": [seed] if isinstance(seed, int) else list(seed),
            "episodes": episodes,
        },
        "traffic": _list(traffic),
        "observation": _MODES[observation],
        "detector": detector,
        "mirrors": mirrors,
        "encoder": os.fspath(encoder),
        "agent_timeout": agent_timeout,
        "jobs": jobs or 1,
        "out": None if out is None else os.fspath(out),
        "resume": resume,
        "keep": keep,
    }


class TrainedAgent:
    """An agent that ``wad-cosim train agent`` trained; :func:`load_agent` makes it."""

    def __init__(self, name: str | os.PathLike[str]) -> None:
        self._native = _native.LoadedAgent(os.fspath(name))
        self._name = os.path.abspath(name) if os.path.exists(name) else os.fspath(name)
        #: What it needs: ``raw``, ``vector`` or ``latent``.
        self.observation = self._native.observation
        #: The encoder that made the latents of its training.
        self.encoder = self._native.encoder

    def check_encoder(self, name: str | os.PathLike[str]) -> None:
        """Refuses an encoder whose latents are not those of its training.

        Raises:
            InputError: It is another one, or there is none of this name.
        """
        self._native.check_encoder(os.fspath(name))

    def act(self, observation: Any) -> NDArray[np.float32]:
        """Steering, throttle and brake for an observation."""
        try:
            numbers = np.asarray(observation, dtype=np.float32).reshape(-1)
        except (TypeError, ValueError) as error:
            raise InputError(f"an observation is not made of numbers: {error}") from None
        return np.array(self._native.act(numbers), dtype=np.float32)

    __call__ = act

    def __reduce__(self) -> tuple[type[TrainedAgent], tuple[str]]:
        # A copy in another process, such as a Ray worker, reads the file itself.
        return TrainedAgent, (self._name,)


def load_agent(name: str | os.PathLike[str]) -> TrainedAgent:
    """The trained agent of a file that ``wad-cosim train agent`` wrote, or ``wad-t`` or ``wad-s``; the networks run without libtorch."""
    return TrainedAgent(name)


def save_agent(
    path: str | os.PathLike[str],
    layers: Iterable[Sequence[Any]],
    *,
    algo: str = "td3",
    observation: str = "raw",
    scale: tuple[Any, Any] | None = None,
    detector: str = "outlines",
    encoder: str | os.PathLike[str] | None = None,
    steps: int = 0,
    updates: int = 0,
    seed: int = 0,
    params: Mapping[str, Any] | None = None,
    scores: Mapping[str, Any] | None = None,
    config: Mapping[str, Any] | None = None,
) -> None:
    """Writes WAD-T's or WAD-S' actor, trained elsewhere, as a file that ``wad-cosim run --agent FILE`` and :func:`load_agent` drive.

    The layers are fully connected with ReLU between them (docs/agents.md, "The networks"); the last one's first three outputs pass
    a tanh (steering) and two sigmoids (throttle, brake), WAD-S' three tanhs. Their sizes, in this order:

    - WAD-T, ``raw``: 15-50, 50-100, 100-75, 75-3.
    - WAD-T, ``latent``: 200-150, 150-100 for the latent, 15-50 for the raw states, then 150-100, 100-75, 75-3 for both.
    - WAD-T, ``vector``: 172-150, 150-100 for the surroundings, then as ``latent``.
    - WAD-S: n-256, 256-128, 128-64, 64-6 for n numbers of the observation, 15, 215 or 187: three means, three log standard deviations.

    Args:
        path: The file; ``.safetensors`` is the usual ending. It holds the weights in half precision.
        layers: A pair for each layer: weights of shape (outputs, inputs), as ``torch.nn.Linear`` has them, and biases.
        algo: ``td3`` (WAD-T) or ``sac`` (WAD-S).
        observation: What the agent gets.
        scale: What is subtracted from each number of an observation, and what it is multiplied with then. Default: 0 and 1.
        detector: The detector of its training.
        encoder: What made its latents. Default: the bundled one for ``latent``, else none.
        steps, updates, seed: Of its training, for the file's header.
        params: The algorithm's constants, such as ``gamma``, under the names of :mod:`wad_cosim.learn`'s ``Params``.
        scores, config: More for the header.

    Raises:
        InputError: The layers are not of these sizes, a number is not finite, or the file cannot be written.
    """
    if observation not in _INPUTS:
        raise InputError(f"observation={observation!r}: expected one of {', '.join(_INPUTS)}")
    numbers: list[NDArray[np.float32]] = []
    sizes: list[tuple[int, int]] = []
    for index, (weights, biases) in enumerate(layers):
        weight, bias = (np.asarray(part, dtype=np.float32) for part in (weights, biases))
        if weight.ndim != 2 or bias.shape != weight.shape[:1]:
            raise InputError(
                f"layer {index}: expected weights (outputs, inputs) and as many biases as outputs, found shapes "
                f"{weight.shape} and {bias.shape}"
            )
        # The file has them by input.
        numbers += [weight.T.ravel(), bias]
        sizes.append((weight.shape[1], weight.shape[0]))
    trained = {
        "inputs": _INPUTS[observation],
        "detector": detector,
        "encoder": os.fspath(encoder or ("default" if observation == "latent" else "pooled")),
        "algorithm": {**dict(params or {}), "algo": algo},
        "scale": scale and {name: np.asarray(part, np.float32).tolist() for name, part in zip(("offset", "factor"), scale)},
        "steps": steps,
        "updates": updates,
        "seed": seed,
        "scores": dict(scores or {}),
        "config": dict(config or {}),
    }
    try:
        text = json.dumps(trained)
    except TypeError as error:
        raise InputError(f"an argument is of the wrong type: {error}") from None
    _native.save_agent(path, text, sizes, np.concatenate([np.zeros(0, np.float32), *numbers]))


def report(*folders: str | os.PathLike[str], pools: Mapping[str, Sequence[str]] | None = None) -> str:
    """The tables of evaluations' folders as Markdown; ``wad-cosim report`` writes pages with figures and maps too.

    ``pools``: agents that share a line, such as trainings with other seeds, by the line's name.
    """
    named = [(name, list(agents)) for name, agents in (pools or {}).items()]
    return _native.report_of([os.fspath(folder) for folder in folders], named)


def _list(given: str | Iterable[str]) -> list[str]:
    return [given] if isinstance(given, str) else list(given)


def _say(done: int, planned: int) -> None:
    print(f"\r{done} of {planned} episodes", end="\n" if done == planned else "", file=sys.stderr, flush=True)


def _driver(agent: Any, form: Any) -> Callable[[Any, int], Any]:
    predict = getattr(agent, "predict", None)
    if predict is None and not callable(agent):
        raise InputError(f"agent={agent!r}: expected a function of an observation, or an object with `predict`")
    reset = getattr(agent, "reset", None)
    _, controls = actions.of(form)

    def act(observation: Any, _seed: int) -> Any:
        if observation is None:
            return reset() if callable(reset) else None
        if predict is not None:
            chosen = predict(observation, deterministic=True)
            chosen = chosen[0] if isinstance(chosen, tuple) else chosen
        else:
            chosen = agent(observation)
        row = controls([chosen], 1)[0]
        if not np.isfinite(row).all():
            raise InputError(f"an action is not finite: {chosen!r}")
        return row.tolist()

    return act


def _table(rows: list[dict[str, Any]]) -> Any:
    try:
        import pandas
    except ImportError:
        return rows
    return pandas.DataFrame(rows)

