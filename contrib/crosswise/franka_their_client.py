"""The fourth cell: Franka's own client, pylibfranka, before the mock server of its own library, which franka_mock.sh builds. Nothing of ours is on the wire, so that this tells what the
other three cells may hold against us. Usage: franka_their_client.py PROGRAM [ADDRESS]"""
import math
import subprocess
import sys
import tempfile
import time

import pylibfranka as franka

program, address = sys.argv[1], (sys.argv[2:] or ["127.90.0.1"])[0]
# What it tells, a line for each command, goes into a file: nobody reads it meanwhile.
told = tempfile.TemporaryFile("w+")
server = subprocess.Popen([program, address, "--paced"], stdout=told)
time.sleep(1.0)  # the server says when it listens, and takes one client alone
robot = franka.Robot(address, franka.RealtimeConfig.kIgnore)
begin, states = time.monotonic(), 0
first = robot.read_once()
while time.monotonic() - begin < 1.0:
    last = robot.read_once()
    states += 1
assert last.time.to_sec() > first.time.to_sec(), "its time goes on"
print("states", states)
robot.set_collision_behavior([40.0] * 7, [40.0] * 7, [40.0] * 6, [40.0] * 6)
robot.set_load(0.7, [0.0, 0.0, 0.05], [0.001, 0, 0, 0, 0.001, 0, 0, 0, 0.001])


def motion(control, command):
    """Until it has come to its end, by the client's own count of cycles."""
    state, _ = control.readOnce()
    q0, t = list(state.q_d), 0.0
    while True:
        out = command(t, q0)
        out.motion_finished = t >= 1.1
        control.writeOnce(out)
        if out.motion_finished:
            return robot.read_once()
        state, passed = control.readOnce()
        t += passed.to_sec()


def position(t, q0):
    return franka.JointPositions([q0[0] + 0.1 * (1 - math.cos(math.pi * min(t, 1.0)))] + list(q0[1:]))


def velocity(t, _):
    return franka.JointVelocities([0, 0, 0.1 * (1 - math.cos(2 * math.pi * min(t, 1.0))), 0, 0, 0, 0])


impedance = franka.ControllerMode.JointImpedance
for start, command, joint, way in [
    (robot.start_joint_position_control, position, 0, 0.2),
    (robot.start_joint_velocity_control, velocity, 2, 0.1),
]:
    before = robot.read_once().q[joint]
    moved = motion(start(impedance), command).q[joint] - before
    assert abs(moved - way) < 0.01, f"joint {joint + 1} has moved by {moved} rad, not {way}"
    print("moved", round(moved, 4))
del robot, start  # the method holds its robot, and with it the connection
code = server.wait(timeout=20)
told.seek(0)
end = told.readlines()[-2:]
assert code == 0 and "the maker's server is content" in end[-1], (code, end)
print(end[0].strip())
print("their client and their server agree")
