"""SAC of Stable-Baselines3 learns to drive 400 m of road, and is judged on routes that it did not see.

    pip install stable-baselines3
    python sb3_sac.py

It reads 15 numbers of each tick and steers with two: the wheel and a pedal.
"""

import argparse
import time

import torch
from stable_baselines3 import SAC

import wad_cosim
from wad_cosim.sb3 import DrivingVecEnv

parser = argparse.ArgumentParser()
parser.add_argument("--steps", type=int, default=25_000)
parser.add_argument("--environments", type=int, default=1)
parser.add_argument("--episodes", type=int, default=25)
parser.add_argument("--seed", type=int, default=1)
options = parser.parse_args()

torch.set_num_threads(1)
begin = time.perf_counter()
envs = DrivingVecEnv("wad_cosim/Straight-v0", options.environments, action="pedal", mode="training")
model = SAC(
    "MlpPolicy",
    envs,
    learning_rate=1e-3,
    gamma=0.98,
    batch_size=128,
    learning_starts=500,
    train_freq=1,
    gradient_steps=1,
    ent_coef="auto_0.1",
    policy_kwargs={"net_arch": [64, 64]},
    seed=options.seed,
)
model.learn(options.steps, log_interval=None)
envs.close()
print(f"{options.steps} steps in {time.perf_counter() - begin:.0f} s")

# Judged on the benchmark's routes, each in a SUMO of its own.
table = wad_cosim.evaluate(
    "tasks",
    model,
    action="pedal",
    detector="outlines",
    condition="training",
    task="straight",
    weather="ClearNoon",
    episodes=options.episodes,
)
rows = table if isinstance(table, list) else table.to_dict("records")
successes, episodes = rows[0]["successes"], rows[0]["episodes"]
print(f"success in {successes} of {episodes} episodes, {100 * successes / episodes:.0f} %")
