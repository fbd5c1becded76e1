"""Image-based visual servoing with the mean interaction matrix, as an entrant of the benchmark; Python without packages:

    vservo benchmark --entrant 'python-ibvs=python3 examples/entrant/ibvs.py' --out seen
"""

import json
import sys

GAIN_1_S = 2.0  # as servo.gain_at_goal_1_s; less where frames are rare or late
DAMPING = 1e-9  # keeps the normal equations solvable where features fix no motion
MAX_SPEED = 100.0  # m/s, rad/s: near a singularity the direction is kept, and the arm's limits do the rest


def rows(x, y, z):
    """The interaction matrix of a point: its motion in the image for the camera's twist, (10.26)."""
    return [[-1 / z, 0, x / z, x * y, -(1 + x * x), y], [0, -1 / z, y / z, 1 + y * y, -x * y, -x]]


def solve(a, b):
    """a x = b by elimination with row pivots."""
    n = len(b)
    a = [row[:] + [b[i]] for i, row in enumerate(a)]
    for k in range(n):
        pivot = max(range(k, n), key=lambda i: abs(a[i][k]))
        a[k], a[pivot] = a[pivot], a[k]
        for i in range(k + 1, n):
            factor = a[i][k] / a[k][k]
            a[i] = [u - factor * v for u, v in zip(a[i], a[k])]
    x = [0.0] * n
    for k in reversed(range(n)):
        x[k] = (a[k][n] - sum(a[k][j] * x[j] for j in range(k + 1, n))) / a[k][k]
    return x


def twist(seen, goal, gain):
    """The least-squares twist that lets every feature approach its goal at the gain."""
    normal, right = [[0.0] * 6 for _ in range(6)], [0.0] * 6
    for f in seen:
        g = goal[f["id"]]
        z = g["depth_m"] or 0.5
        mean = [
            [(u + v) / 2 for u, v in zip(now, then)]
            for now, then in zip(rows(f["x"], f["y"], z), rows(g["x"], g["y"], z))
        ]
        for row, error in zip(mean, (g["x"] - f["x"], g["y"] - f["y"])):
            for i in range(6):
                right[i] += row[i] * error
                for j in range(6):
                    normal[i][j] += row[i] * row[j]
    for i in range(6):
        normal[i][i] += DAMPING
    wanted = [gain * v for v in solve(normal, right)]
    scale = min(1.0, MAX_SPEED / max(MAX_SPEED, *map(abs, wanted)))
    return [scale * v for v in wanted]


for line in sys.stdin:
    message = json.loads(line)
    if message["vservo"] == "begin":
        goal = {f["id"]: f for f in message["goal"]["features"]}
        camera = message["camera"]
        # a quarter of what a delay of this length makes unstable, pi / 2
        gain = min(GAIN_1_S, 0.4 / (camera["latency_s"] + 0.5 / camera["rate_hz"]))
        answer = {
            "about": "image-based, mean interaction matrix, desired depths",
            "settings": {"gain_1_s": GAIN_1_S, "largest_gain_times_delay": 0.4},
        }
    elif message["vservo"] == "see":
        seen = [f for f in message["features"] if f["id"] in goal]
        answer = {"twist": twist(seen, goal, gain)} if len(seen) >= 3 else None
    else:
        break
    print(json.dumps(answer), flush=True)
