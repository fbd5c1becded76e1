#!/usr/bin/env python3
"""The image of the README, from the files of a report: needs matplotlib.

    vservo run ur5 --clock lockstep --report seen
    python3 tools/readme_image.py seen docs/images/first_run.png
"""

import csv
import pathlib
import sys

import matplotlib.pyplot as plt

folder, out = map(pathlib.Path, sys.argv[1:3])


def rows(name):
    with open(folder / name, newline="") as file:
        return list(csv.DictReader(file))


seen = [row for row in rows("measurements.csv") if row["u_1_px"]]
points = sorted(int(key[2:-3]) for key in seen[0] if key.startswith("u_") and key.endswith("_px"))
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.9), width_ratios=(1.33, 1))
left.imshow(plt.imread(next(folder.glob("frame-first-*.png"))), cmap="gray", vmin=0, vmax=1)
for i in points:
    u = [float(row[f"u_{i}_px"]) for row in seen]
    v = [float(row[f"v_{i}_px"]) for row in seen]
    left.plot(u, v, color="tab:orange")
    left.plot(u[-1], v[-1], "o", color="tab:orange", mfc="none")
left.set(title="what the camera sees first, and the ways of the dots", xticks=[], yticks=[])
time = [float(row["exposure_s"]) for row in seen]
right.semilogy(time, [float(row["error_px"]) for row in seen])
right.set(title="how far they are from their goals", xlabel="time, s", ylabel="root mean square, px")
right.grid(alpha=0.3)
figure.tight_layout()
out.parent.mkdir(parents=True, exist_ok=True)
figure.savefig(out, dpi=90)
