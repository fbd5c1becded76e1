"""A servo law of one's own on a running arm: position-based, from the pose of the target in the camera, 25 times a second.

    vservo serve --instance cell        # in one terminal
    python examples/own_law.py cell     # in another

The arm keeps its limits, and rests when this program is silent for 0.2 s.
"""

import sys

import numpy as np
import vservo

# The target in the camera at the goal, as in config/default.toml: its origin at (-10, 10, 60) cm, turned by -60 degrees.
C, S = np.cos(np.radians(-60)), np.sin(np.radians(-60))
X_DO = np.array([[C, -S, 0, -0.1], [S, C, 0, 0.1], [0, 0, 1, 0.6], [0, 0, 0, 1]])
GAIN_1_S = 1.5


def rotation_vector(R):
    """Axis times angle of a rotation matrix (3, 3) of less than half a turn, rad."""
    angle = np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1))
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return axis * (0.5 if angle < 1e-6 else angle / (2 * np.sin(angle)))


def servo(cell, tolerance=1e-3):
    """Moves the camera of `cell` until the target is off by less than `tolerance`, m and rad; returns by how much it is."""
    arm = cell.velocities(hold_s=0.2)
    for measurement in cell.measurements():
        if measurement.pose is None:
            continue  # the arm rests if that lasts
        X_CD = measurement.pose @ np.linalg.inv(X_DO)  # where the camera is to be, as it sees it
        error = np.concatenate([X_CD[:3, 3], rotation_vector(X_CD[:3, :3])])
        arm.camera(GAIN_1_S * error)
        if np.linalg.norm(error) < tolerance:
            cell.hold()
            return error


if __name__ == "__main__":
    print(servo(vservo.connect(sys.argv[1] if len(sys.argv) > 1 else "default")))
