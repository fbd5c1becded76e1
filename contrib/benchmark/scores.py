"""Computes the scores of a benchmark anew, from what was true at each tick, and compares them with benchmark.json; Python without packages:

    vservo benchmark --truth --out seen
    python3 contrib/benchmark/scores.py seen [TASK]...

Prints a line for each run that differs and the number of runs that agree; exit code 1 where one differs. Lenses of the model plumb_bob.
"""

import json
import math
import pathlib
import sys

TICK_S, PATH_TICKS, REST_S = 1e-3, 10, 0.2
# Relative difference that rounding of sums in another order explains many times over.
ALIKE = 1e-6


def rotated(q, p):
    """p turned by the quaternion x, y, z, w."""
    x, y, z, w = q
    tx, ty, tz = 2 * (y * p[2] - z * p[1]), 2 * (z * p[0] - x * p[2]), 2 * (x * p[1] - y * p[0])
    return (
        p[0] + w * tx + y * tz - z * ty,
        p[1] + w * ty + z * tx - x * tz,
        p[2] + w * tz + x * ty - y * tx,
    )


def product(a, b):
    (ax, ay, az, aw), (bx, by, bz, bw) = a, b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def conjugate(q):
    return (-q[0], -q[1], -q[2], q[3])


class Run:
    def __init__(self, path):
        with open(path) as lines:
            self.head = json.loads(next(lines)[1:])
            columns = next(lines).strip().split(",")
            rows = [[float(x) for x in line.split(",")] for line in lines]
        joints = sum(name.startswith("qd") for name in columns)
        self.poses = [(row[1:4], row[4:8]) for row in rows]
        self.powers = [
            sum(abs(v * f) for v, f in zip(row[8 : 8 + joints], row[8 + joints :])) for row in rows
        ]

    def pixels(self, pose):
        """The target's points in the image; None for one behind the camera."""
        h, (t, q), seen = self.head, pose, []
        d = h["distortion"]
        for point in h["points_m"]:
            x, y, z = (a + b for a, b in zip(rotated(q, point), t))
            if z <= 0:
                seen.append(None)
                continue
            x, y = x / z, y / z
            r2 = x * x + y * y
            radial = 1 + r2 * (d["k1"] + r2 * (d["k2"] + r2 * d["k3"]))
            u = x * radial + 2 * d["p1"] * x * y + d["p2"] * (r2 + 2 * x * x)
            v = y * radial + d["p1"] * (r2 + 2 * y * y) + 2 * d["p2"] * x * y
            seen.append((h["fx_px"] * u + h["cx_px"], h["fy_px"] * v + h["cy_px"]))
        return seen

    def scores(self, least_time_s):
        h = self.head
        assert h["lens"] == "plumb_bob", h["lens"]
        goal_pose = (h["goal"][:3], h["goal"][3:])
        goal = self.pixels(goal_pose)
        seen = [self.pixels(pose) for pose in self.poses]
        errors = []
        for points in seen:
            squares = [math.dist(p, g) ** 2 if p and g else math.inf for p, g in zip(points, goal)]
            errors.append(math.sqrt(sum(squares) / len(squares)))
        within = 0
        for error in reversed(errors):
            if not error <= h["tolerance_px"]:
                break
            within += 1
        converged = within * TICK_S > h["hold_s"]
        settled = len(errors) - within
        w, high = h["width_px"] - 0.5, h["height_px"] - 0.5
        margin = min(
            max(min(p[0] + 0.5, p[1] + 0.5, w - p[0], high - p[1]) if p else -math.inf, -w)
            for points in seen
            for p in points
        )
        last = self.poses[-round(REST_S / TICK_S) :]
        rms = lambda values: math.sqrt(sum(v * v for v in values) / len(values))
        scores = {
            "converged": converged,
            "settling_s": settled * TICK_S if converged else None,
            "settling_by_least": None,
            "margin_px": margin,
            "first_error_px": errors[0],
            "final_error_px": rms(errors[-len(last) :]),
            "final_error_m": rms([self.off(pose, goal_pose)[0] for pose in last]),
            "final_error_rad": rms([self.off(pose, goal_pose)[1] for pose in last]),
            "energy_j": sum(self.powers) * TICK_S,
            "image_path_excess": None,
            "space_path_excess_m": None,
        }
        if converged and least_time_s:
            scores["settling_by_least"] = scores["settling_s"] / least_time_s
        if converged:
            until = settled // PATH_TICKS + 2
            places = [k for k in range(0, len(seen), PATH_TICKS) if None not in seen[k]][:until]
            way = lambda a, b: sum(math.dist(p, q) for p, q in zip(seen[a], seen[b]))
            arc = sum(way(a, b) for a, b in zip(places, places[1:]))
            straight = way(places[0], places[-1])
            scores["image_path_excess"] = arc / straight - 1 if straight > 0 else None
            centres = [self.camera(self.poses[k]) for k in places]
            arc = sum(math.dist(a, b) for a, b in zip(centres, centres[1:]))
            scores["space_path_excess_m"] = arc - math.dist(centres[0], centres[-1])
        return scores

    @staticmethod
    def camera(pose):
        """The camera's centre in the frame of the object."""
        t, q = pose
        return tuple(-x for x in rotated(conjugate(q), t))

    @staticmethod
    def off(pose, goal):
        """Distance and angle of the camera from its goal."""
        (t, q), (t_D, q_D) = pose, goal
        turn = product(q_D, conjugate(q))
        p = [a - b for a, b in zip(t_D, rotated(turn, t))]
        return math.hypot(*p), 2 * math.atan2(math.hypot(*turn[:3]), abs(turn[3]))


def differences(told, computed):
    for name, value in computed.items():
        other = told[name]
        if value is None or other is None or isinstance(value, bool):
            if value != other:
                yield f"{name} {value}, told {other}"
        elif not abs(value - other) <= ALIKE * (1 + abs(value)):
            yield f"{name} {value}, told {other}"


def main(folder, wanted):
    folder = pathlib.Path(folder)
    results = json.loads((folder / "benchmark.json").read_text())
    alike = different = 0
    for task in results["tasks"]:
        if wanted and task["name"] not in wanted:
            continue
        for law in task["laws"]:
            for k, (told, scenario) in enumerate(zip(law["runs"], task["scenarios"])):
                name = f"{task['name']}-{k}-{law['law']}.csv"
                found = list(differences(told, Run(folder / "truth" / name).scores(scenario["least_time_s"])))
                alike, different = alike + (not found), different + bool(found)
                if found:
                    print(f"{name}: {'; '.join(found)}")
    print(f"{alike} runs agree, {different} differ")
    return 1 if different or not alike else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2:]))
