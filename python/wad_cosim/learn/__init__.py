"""WAD-T and WAD-S in PyTorch, as ``wad-cosim train agent`` has them, each in one file in its paper's order.

:mod:`.td3` is WAD-T, :mod:`.sac` is WAD-S; :mod:`.replay` keeps their experience, :mod:`.exploration` is the noise on their actions.
``python -m wad_cosim.ray train`` trains them on a cluster (docs/cluster.md). Needs the package torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .._native import InputError

try:
    import torch
except ImportError as missing:
    raise InputError("PyTorch is not installed: pip install torch") from missing

if TYPE_CHECKING:
    from .sac import SAC
    from .td3 import TD3

ALGORITHMS = ("td3", "sac")


def prepare() -> None:
    """One thread for PyTorch: more cost more than they bring in networks as small as these. And numbers that are too small for a
    processor's quick way count as 0: behind a unit that is off Adam's moments would fade to them, and a step takes twice its time."""
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)


def new(algo: str, observation: str) -> TD3 | SAC:
    """A new agent that observes ``raw``, ``vector`` or ``latent``; ``torch.manual_seed`` decides its first weights."""
    from . import sac, td3

    if algo not in ALGORITHMS:
        raise InputError(f"algo={algo!r}: expected one of {', '.join(ALGORITHMS)}")
    return td3.TD3(observation) if algo == "td3" else sac.SAC(observation)
