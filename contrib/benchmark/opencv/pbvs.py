"""Position-based visual servoing on OpenCV's solvePnP, as an entrant of the benchmark. Needs numpy and opencv-python-headless:

    vservo benchmark --entrant 'opencv-pbvs=venv/bin/python contrib/benchmark/opencv/pbvs.py' --out seen

The pose of the target comes from the measured pixels by solvePnP (IPPE for planar targets, then refined), the desired pose from the task, or by solvePnP from the
desired pixels where the task has none. The law is v = -K R^T t, w = -K theta u of the camera's pose in the desired camera's frame: straight in space.
"""

import json
import sys

import cv2
import numpy as np

GAIN_1_S = 2.0


def camera_of(task):
    c = task["camera"]
    K = np.array([[c["fx_px"], 0, c["cx_px"]], [0, c["fy_px"], c["cy_px"]], [0, 0, 1.0]])
    d = c["distortion"]
    order = ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"]
    if c["lens"] not in ("plumb_bob", "rational_polynomial"):
        return None
    return K, np.array([d[name] for name in order if name in d])


def pose_of(points, pixels, camera, method):
    """Rotation and translation of the target before the camera, or None."""
    ok, rvec, tvec = cv2.solvePnP(points, pixels, *camera, flags=method)
    if not ok:
        return None
    rvec, tvec = cv2.solvePnPRefineLM(points, pixels, *camera, rvec, tvec)
    return cv2.Rodrigues(rvec)[0], tvec.ravel()


def rotation(xyzw):
    x, y, z, w = xyzw
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])


class Pbvs:
    def __init__(self, task):
        self.points = {p["id"]: p["position_m"] for p in task["target"]["points"]}
        self.camera = camera_of(task)
        planar = np.ptp([p[2] for p in self.points.values()]) < 1e-9
        self.method = cv2.SOLVEPNP_IPPE if planar else cv2.SOLVEPNP_SQPNP
        goal = task["goal"]
        c = task["camera"]
        self.gain = min(GAIN_1_S, 0.4 / (c["latency_s"] + 0.5 / c["rate_hz"]))
        if goal["pose"]:
            self.goal = rotation(goal["pose"]["rotation_xyzw"]), np.array(goal["pose"]["position_m"])
        else:
            self.goal = self.pose(goal["features"])

    def pose(self, features):
        known = [f for f in features if f["id"] in self.points]
        if self.camera is None or len(known) < 4:
            return None
        points = np.array([self.points[f["id"]] for f in known])
        pixels = np.array([[f["u_px"], f["v_px"]] for f in known])
        return pose_of(points, pixels, self.camera, self.method)

    def answer(self, message):
        pose = self.pose(message["features"])
        if pose is None or self.goal is None:
            return None
        (R, t), (R_D, t_D) = pose, self.goal
        # the camera in the desired camera's frame
        R_DC = R_D @ R.T
        t_DC = t_D - R_DC @ t
        twist = [*(-self.gain * R_DC.T @ t_DC), *(-self.gain * cv2.Rodrigues(R_DC)[0].ravel())]
        return {"twist": [float(x) for x in twist]}


pbvs = None
for line in sys.stdin:
    message = json.loads(line)
    if message["vservo"] == "begin":
        pbvs = Pbvs(message)
        answer = {
            "about": "position-based on solvePnP of OpenCV " + cv2.__version__,
            "settings": {"pose": "IPPE and LM", "gain_1_s": GAIN_1_S, "largest_gain_times_delay": 0.4},
        }
    elif message["vservo"] == "see":
        answer = pbvs.answer(message)
    else:
        break
    print(json.dumps(answer), flush=True)
