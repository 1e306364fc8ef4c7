#!/usr/bin/env python3
"""Learning curves of one or more trainings as an SVG: scripts/learning_curves.py RUN... > curves.svg

Reads the episodes in each RUN/train.jsonl (`wad-cosim train agent --out RUN`) that the agent drove. Above: the
share of the last 40 that succeeded; below: their mean return. Thin lines are trainings, the band is their mean
and standard deviation where there are several. Needs Python 3 only.
"""

import json
import statistics
import sys
from pathlib import Path

WINDOW = 40
COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00"]
WIDTH, HEIGHT, LEFT, TOP, GAP = 640, 190, 64, 34, 58


def episodes(run):
    """(environment step, success, return) of the agent's episodes in order."""
    found = []
    for line in (Path(run) / "train.jsonl").read_text().splitlines():
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            continue  # the last line of a training that was cut off
        if row.get("by") == "agent":
            found.append((row["global_step"], float(row["success"]), row["charts/episodic_return"]))
    if not found:
        sys.exit(f"{run}/train.jsonl holds no episode that the agent drove")
    return found


def smooth(rows, column):
    """Means over the last WINDOW episodes, as (step, mean)."""
    values = [row[column] for row in rows]
    return [
        (rows[i][0], statistics.fmean(values[max(0, i + 1 - WINDOW) : i + 1]))
        for i in range(min(9, len(rows) - 1), len(rows))
    ]


def at(line, step):
    """A line's value at a step, None outside of it."""
    for (s0, v0), (s1, v1) in zip(line, line[1:]):
        if s0 <= step <= s1:
            return v0 + (v1 - v0) * (step - s0) / max(1, s1 - s0)
    return None


def panel(lines, top, title, low, high, last):
    x = lambda step: LEFT + (WIDTH - LEFT - 30) * step / last
    y = lambda value: top + HEIGHT * (1 - (value - low) / (high - low))
    out = [f'<text x="{LEFT}" y="{top - 10}" font-size="14" font-weight="bold">{title}</text>']
    for i in range(5):
        value, step = low + (high - low) * i / 4, last * i / 4
        out.append(f'<line x1="{LEFT}" x2="{WIDTH - 30}" y1="{y(value):.1f}" y2="{y(value):.1f}" stroke="#e4e4e4"/>')
        out.append(f'<text x="{LEFT - 6}" y="{y(value) + 4:.1f}" text-anchor="end">{value:.4g}</text>')
        out.append(f'<text x="{x(step):.1f}" y="{top + HEIGHT + 16}" text-anchor="middle">{step:,.0f}</text>')
    points = lambda line: " ".join(f"{x(s):.1f},{min(max(y(v), top), top + HEIGHT):.1f}" for s, v in line)
    if len(lines) > 1:
        upper, lower = [], []
        for step in range(0, int(last), max(1, int(last // 150))):
            values = [v for v in (at(line, step) for line in lines) if v is not None]
            if len(values) == len(lines):
                mean, spread = statistics.fmean(values), statistics.stdev(values)
                upper.append((step, mean + spread))
                lower.append((step, mean - spread))
        out.append(f'<polygon points="{points(upper + lower[::-1])}" fill="#0072b2" fill-opacity="0.15"/>')
    for line, colour in zip(lines, COLOURS):
        out.append(f'<polyline points="{points(line)}" fill="none" stroke="{colour}" stroke-width="1.6"/>')
    return out


def main(runs):
    if not runs or runs[0] in ("-h", "--help"):
        sys.exit(__doc__)
    rows = [episodes(run) for run in runs]
    last = -(-max(r[-1][0] for r in rows) // 8000) * 8000
    success, returns = [smooth(r, 1) for r in rows], [smooth(r, 2) for r in rows]
    best = max(v for line in returns for _, v in line)
    height = TOP + 2 * (HEIGHT + GAP) + 22 * len(runs)
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{height}" viewBox="0 0 {WIDTH} {height}" '
        'font-family="sans-serif" font-size="12">',
        '<rect width="100%" height="100%" fill="white"/>',
    ]
    out += panel(success, TOP, f"success, last {WINDOW} training episodes", 0.0, 1.0, last)
    out += panel(returns, TOP + HEIGHT + GAP, "return, by environment steps", 0.0, 100.0 * (best // 100 + 1), last)
    for i, (run, colour) in enumerate(zip(runs, COLOURS)):
        y = TOP + 2 * (HEIGHT + GAP) + 20 * i
        out.append(f'<line x1="{LEFT}" x2="{LEFT + 24}" y1="{y}" y2="{y}" stroke="{colour}" stroke-width="3"/>')
        out.append(f'<text x="{LEFT + 32}" y="{y + 4}">{Path(run).name}</text>')
    print("\n".join(out + ["</svg>"]))


if __name__ == "__main__":
    main(sys.argv[1:])
