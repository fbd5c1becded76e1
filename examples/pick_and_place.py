"""Pick and place with two goals and a gripper, by a client of a running instance:

    vservo serve --instance cell &
    python3 examples/pick_and_place.py cell
"""

import subprocess
import sys

import vservo

PICK = dict(position_m=[-0.1, 0.1, 0.6], rotation_rpy_deg=[0, 0, -60])  # the target in the camera
PLACE = dict(position_m=[-0.04, 0.03, 0.55], rotation_rpy_deg=[0, 0, -20])


def pick_and_place(cell, gripper):
    for goal, what in [(PICK, "close"), (PLACE, "open")]:
        if cell.goal(**goal).state != "servoing":
            cell.start()
        cell.wait("converged", timeout_s=60)
        gripper(what)
    cell.hold()


if __name__ == "__main__":
    pick_and_place(
        vservo.connect(sys.argv[1] if len(sys.argv) > 1 else "default"),
        lambda what: subprocess.run(["config/programs/gripper", what], check=True),
    )
