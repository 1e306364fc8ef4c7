"""The command line's ``eval``, ``dataset collect`` and ``train agent`` on a Ray cluster."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from typing import Any

from .. import InputError, SumoError, _native, report
from ..evaluation import wanted_by
from . import prepare

_EXITS = "Exit codes: 0 done; 2 usage or input; 3 SUMO failed; 4 interrupted, results kept; 1 anything else."


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m wad_cosim.ray", description=__doc__, epilog=_EXITS)
    parser.add_argument("--version", action="version", version=_native.VERSION)
    commands = parser.add_subparsers(dest="command", required=True)

    drive = commands.add_parser("eval", help="drive the episodes of a suite", epilog=_EXITS)
    drive.add_argument("suite", help="as for `wad-cosim eval`")
    drive.add_argument("--agent", action="append", metavar="NAME", help="may be given several times [autopilot]")
    for name in ("condition", "task", "town", "weather", "traffic"):
        drive.add_argument(f"--{name}", action="append", default=[], help="only this; may be given several times")
    drive.add_argument("--seed", action="append", type=int, default=[], metavar="N")
    drive.add_argument("--weathers-in-turn", action="store_true", help="episode by episode, instead of all episodes in each")
    drive.add_argument("--episodes", type=int, metavar="N", help="per task, town and weather")
    drive.add_argument("--detector", default=_native.DEFAULT_DETECTOR, metavar="NAME", help=f"[{_native.DEFAULT_DETECTOR}]")
    drive.add_argument("--mirrors", action="store_true", help="look back before a change of lane, by cameras as door mirrors")
    drive.add_argument("--agent-timeout", type=float, default=10, metavar="SECONDS", help="for each answer of an exec: agent [10]")
    drive.add_argument("--keep", default="failures", choices=("none", "failures", "all"), help="which to record")
    drive.add_argument("--resume", action="store_true", help="continue the evaluation in --out")
    _shared(drive)

    collect = commands.add_parser("collect", help="collect a dataset under the autopilot, or go on with it", epilog=_EXITS)
    collect.add_argument("--town", default="town3", metavar="CONFIG")
    collect.add_argument("--frames", type=int, default=150_000, metavar="N")
    collect.add_argument("--per-shard", type=int, metavar="N", help="frames to a shard [a twentieth, at most 500]")
    collect.add_argument("--weather", action="append", default=[], metavar="NAME", help="in turn [those of training]")
    collect.add_argument("--seed", type=int, default=0, metavar="N")
    collect.add_argument("--camera", action="store_true", help="keep the camera's pictures too")
    collect.add_argument("--every", type=float, default=0.5, metavar="SECONDS", help="simulated, between frames")
    collect.add_argument("--noise-pause", type=float, metavar="SECONDS", help="as for `wad-cosim dataset collect`")
    _shared(collect)

    train = commands.add_parser("train", help="train WAD-T or WAD-S in PyTorch, or go on with it", epilog=_EXITS)
    train.add_argument("--algo", choices=("td3", "sac"), help="td3: WAD-T; sac: WAD-S [td3]")
    train.add_argument("--env", action="append", metavar="ID", help="collectors have them in turns [wad_cosim/Straight-v0]")
    train.add_argument("--curriculum", metavar="FILE", help="tasks step by step, such as scenarios/curriculum.json, in place of --env")
    train.add_argument("--observation", choices=("raw", "vector", "latent"), help="what the agent gets [raw]")
    train.add_argument("--town", metavar="CONFIG", help="[the environment's]")
    train.add_argument("--traffic", metavar="NAME", help="[the environment's]")
    train.add_argument("--weather", action="append", metavar="NAME", help="may be given several times [ClearNoon]")
    train.add_argument("--detector", metavar="NAME", help="[truth for latent, else outlines]")
    for name, what in (
        ("egos", "in each collector's SUMO [4]"),
        ("segment", "ticks that a collector drives before the learner gets them [32]"),
        ("seed", "[0]"),
        ("learning-starts", "steps of random driving first [5000]"),
        ("batch", "transitions of an update [128]"),
        ("n-step", "rewards that are summed [3]"),
        ("buffer", "transitions that are kept [200000]"),
        ("checkpoint-every", "steps between checkpoints [10000]"),
    ):
        train.add_argument(f"--{name}", type=int, metavar="N", help=what)
    train.add_argument("--near-ends", type=float, metavar="SHARE", help="of each batch, from places where episodes end [0.3]")
    train.add_argument("--update-ratio", type=float, metavar="R", help="updates for a step [1]")
    train.add_argument("--steps", type=int, required=True, metavar="N", help="of all collectors together, those before included")
    train.add_argument("--resume", action="store_true", help="go on with the training in --out, with its settings")
    _shared(train)
    return parser


def _shared(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", required=True, metavar="DIR", help="folder for the results, on this machine")
    parser.add_argument(
        "--address", default="auto", help="the Ray cluster: auto (this machine is a part of it), local, HOST:PORT [auto]"
    )
    parser.add_argument(
        "--task-timeout",
        type=float,
        default=1800,
        metavar="SECONDS",
        help="after which the process that drives an episode, a segment or a turn counts as hung and is started again [1800]",
    )
    parser.add_argument("--workers", type=int, metavar="N", help="actors of one core each [the cluster's cores]")


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    asked = _parser().parse_args(arguments)
    if asked.workers is not None and asked.workers < 1:
        print("error: --workers: expected 1 or more", file=sys.stderr)
        return 2
    if not asked.task_timeout > 0:
        print("error: --task-timeout: expected more than 0", file=sys.stderr)
        return 2
    try:
        prepare(asked.address)
        return {"eval": _eval, "collect": _collect, "train": _train}[asked.command](asked)
    except (InputError, SumoError, RuntimeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2 if isinstance(error, InputError) else 3 if isinstance(error, SumoError) else 1


def _how(asked: argparse.Namespace) -> dict[str, Any]:
    return {"address": asked.address, "workers": asked.workers, "limit": asked.task_timeout, "progress": True}


def _eval(asked: argparse.Namespace) -> int:
    from . import evaluation

    wanted = wanted_by(
        asked.suite,
        asked.agent or ["autopilot"],
        condition=asked.condition,
        task=asked.task,
        town=asked.town,
        weather=asked.weather,
        weathers_in_turn=asked.weathers_in_turn,
        traffic=asked.traffic,
        seed=asked.seed,
        episodes=asked.episodes,
        detector=asked.detector,
        mirrors=asked.mirrors,
        agent_timeout=asked.agent_timeout,
        out=asked.out,
        resume=asked.resume,
        keep=asked.keep,
    )
    try:
        evaluation.evaluate(wanted, None, **_how(asked))
    except KeyboardInterrupt:
        print(f"\ninterrupted: what was driven is in {asked.out}; --resume goes on", file=sys.stderr)
        return 4
    print(report(asked.out))
    return 0


def _collect(asked: argparse.Namespace) -> int:
    from . import collection

    names = ("town", "frames", "out", "per_shard", "seed", "camera", "every", "noise_pause")
    wanted = {name: getattr(asked, name) for name in names} | {"weathers": asked.weather}
    done = collection.collect(wanted, **_how(asked))
    print(f"{done['out']}: {done['frames']} frames in {done['shards']} shards, {done['bytes'] / 1e6:.1f} MB")
    if done["interrupted"]:
        print("interrupted; the same command continues from here", file=sys.stderr)
        return 4
    return 0


def _train(asked: argparse.Namespace) -> int:
    from ..learn.curriculum import Curriculum
    from ..learn.training import Settings
    from . import training

    named = {"environments": asked.env, "weathers": asked.weather}
    names = [field.name for field in dataclasses.fields(Settings) if field.name not in ("latent_gain", *named)]
    given = {name: getattr(asked, name) for name in names} | {name: tuple(value) for name, value in named.items() if value}
    given = {name: value for name, value in given.items() if value is not None}
    if "curriculum" in given:
        given["curriculum"] = Curriculum.load(given["curriculum"])
    if asked.resume and given:
        raise InputError(f"--resume goes on with the settings in {asked.out}: leave out {', '.join(given)}")
    try:
        done = training.train(
            Settings(**given),
            asked.out,
            steps=asked.steps,
            resume=asked.resume,
            **_how(asked),
        )
    except KeyboardInterrupt:
        print(f"\ninterrupted: {asked.out} has a checkpoint; --resume goes on", file=sys.stderr)
        return 4
    print("{out}: {steps} steps, {updates} updates, {episodes} episodes, {restarts} restarts".format(**done))
    return 0


if __name__ == "__main__":
    sys.exit(main())
