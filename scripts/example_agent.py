#!/usr/bin/env python3
"""An agent in another language: wad-cosim eval nocrash --agent 'exec:python3 scripts/example_agent.py'

It reads one JSON object per line and answers each with one (docs/evaluate.md). Needs Python 3 only.
It follows the route at a moderate speed and stops for what stands in its way and for red lights.
"""

import json
import sys


def decide(state):
    """From the six raw states, in m, m/s and rad, to pedals and steering."""
    speed = state["speed"]
    # Steer towards the waypoint ahead, and back to the lane's middle (left is positive).
    steer = 1.1 * state["heading_error"] - 0.25 * state["lateral"] / (1.0 + 0.15 * speed)
    # Slow down for bends.
    bend = abs(state["heading_error_far"])
    wanted = min(state["speed_limit"], 9.0, 9.0 / (1.0 + 1.6 * bend))
    # Keep a distance, and stop before the line.
    if state["lead"] is not None:
        wanted = min(wanted, max(0.0, 0.6 * (state["lead"]["gap"] - 5.0)))
    if state["stop_light"] is not None:
        wanted = min(wanted, max(0.0, 0.6 * (state["stop_light"] - 2.0)))
    error = wanted - speed
    throttle = max(0.0, min(0.6, 0.25 * error + 0.1)) if error > -0.3 else 0.0
    brake = max(0.0, min(1.0, -0.3 * error)) if error < -0.3 else 0.0
    if wanted < 0.3:
        throttle, brake = 0.0, 0.6
    return {"throttle": throttle, "steer": max(-1.0, min(1.0, steer)), "brake": brake}


def main():
    # The first line says that the agent is ready, and whether it wants the picture.
    print(json.dumps({"image": False}), flush=True)
    for line in sys.stdin:
        seen = json.loads(line)
        print(json.dumps(decide(seen["state"])), flush=True)


if __name__ == "__main__":
    main()
