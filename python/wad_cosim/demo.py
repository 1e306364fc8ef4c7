"""``python -m wad_cosim.demo``: the expert drives the composite task, the numbers of the drive, and a picture."""

from __future__ import annotations

import argparse
import struct
import sys
import time
import zlib

import gymnasium
import numpy as np
from numpy.typing import NDArray

import wad_cosim


def png(path: str, picture: NDArray[np.uint8]) -> None:
    """Writes an RGB picture."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    height, width, _ = picture.shape
    rows = np.zeros((height, 1 + 3 * width), np.uint8)
    rows[:, 1:] = picture.reshape(height, -1)
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        file.write(chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)))
        file.write(chunk(b"IDAT", zlib.compress(rows.tobytes())) + chunk(b"IEND", b""))


def main(arguments: list[str] | None = None) -> int:
    """The program; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m wad_cosim.demo", description=__doc__.split(": ", 1)[1])
    parser.add_argument("--town", default="town3", help="a town, a scenario or a configuration (default town3)")
    parser.add_argument("--weather", default="ClearNoon", choices=wad_cosim.weathers(), metavar="NAME")
    parser.add_argument("--ticks", type=int, default=300, help="at most so many ticks (default 300)")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--picture", default="wad_cosim.png", help="where the last picture goes")
    options = parser.parse_args(arguments)
    try:
        env = gymnasium.make(
            "wad_cosim/Composite-v0", town=options.town, weather=options.weather, render_mode="rgb_array"
        )
        _, info = env.reset(seed=options.seed)
        print("  tick  speed m/s  route done  reward  vehicles  pedestrians")
        total, begin, over = 0.0, time.perf_counter(), False
        while info["tick"] < options.ticks and not over:
            _, reward, terminated, truncated, info = env.step(env.unwrapped.expert_action())  # type: ignore[attr-defined]
            total += float(reward)
            over = terminated or truncated
            if info["tick"] % 25 == 0 or over:
                print(
                    f"{info['tick']:6} {info['speed']:10.2f} {100 * info['route_done']:9.1f} % {total:7.1f} "
                    f"{info['vehicles']:9} {info['pedestrians']:12}"
                )
        seconds = time.perf_counter() - begin
        png(options.picture, env.render())  # type: ignore[arg-type]
        end = f"{info['end']}: {info['cause']}" if over else "it drives on"
        print(f"{info['tick']} ticks in {seconds:.1f} s, {info['tick'] / seconds:.0f} a second; {end}")
        print(f"the last picture: {options.picture}")
        env.close()  # type: ignore[no-untyped-call, unused-ignore]
    except (wad_cosim.Error, wad_cosim.InputError, OSError) as error:
        print(f"demo: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
