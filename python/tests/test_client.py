"""The client against a served run of the default arm in simulated time.

Run with `python -m unittest discover python/tests`; the environment variable VSERVO names the program, else it is looked for in PATH.
"""

import itertools
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import unittest

import numpy as np
import vservo

REPOSITORY = pathlib.Path(__file__).resolve().parents[2]
PROGRAM = os.environ.get("VSERVO") or shutil.which("vservo")
sys.path.insert(0, str(REPOSITORY / "examples"))


@unittest.skipUnless(PROGRAM, "needs the program: set VSERVO to its path")
class Served(unittest.TestCase):
    """A daemon of its own for each test."""

    arguments = ["--clock", "lockstep"]

    def setUp(self):
        self.name = f"py-{os.getpid()}-{int(time.monotonic() * 1000) % 100000}"
        self.daemon = subprocess.Popen(
            [PROGRAM, "serve", *self.arguments, "--instance", self.name],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self.addCleanup(self.end)
        until = time.monotonic() + 60
        while True:
            try:
                self.cell = vservo.connect(self.name)
                self.cell.wait("state=idle", timeout_s=60)  # once it has its camera
                return
            except vservo.Unreachable:
                self.assertLess(time.monotonic(), until, "the daemon did not come")
                self.assertIsNone(self.daemon.poll())
                time.sleep(0.05)

    def end(self):
        if self.daemon.poll() is None:
            self.daemon.terminate()
        self.daemon.wait(30)

    def servo(self):
        self.cell.start()
        return self.cell.wait("converged", timeout_s=60)


class OwnLaw(Served):
    """In real time, as a program of a user runs it."""

    arguments = ["--clock", "realtime"]

    def test_a_law_in_python_servoes_the_arm(self):
        import own_law

        error = own_law.servo(self.cell)
        self.assertLess(np.linalg.norm(error), 1e-3)
        held = self.cell.wait("state=held", timeout_s=30)
        self.assertLess(np.abs(held.qd).max(), 5e-3)


class Requests(Served):
    def test_a_run_does_what_it_is_told(self):
        cell = self.cell
        self.assertEqual(cell.instance, self.name)
        before = cell.status()
        self.assertFalse(before.at_goal)
        self.assertEqual((before.q.shape, before.qd.shape, before.goal), ((4,), (4,), 0))
        there = self.servo()
        self.assertTrue(there.at_goal)
        self.assertLess(there.feature_error_px, 0.3)
        self.assertLess(there.position_error_m, 1e-3)

        # a goal that is taught, in memory and in a file
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "goal.toml")
            taught = cell.teach(save=path, timeout_s=60)
            again = vservo.Goal.load(path)
        self.assertEqual((taught.target, taught.ids.tolist()), ("four_dots", [0, 1, 2, 3]))
        self.assertEqual(again.target_name, taught.target_name)
        np.testing.assert_array_equal(again.normalized, taught.normalized)
        np.testing.assert_allclose(again.q, taught.q)
        np.testing.assert_allclose(taught.q, there.q, atol=2e-3)

        # a posture, and back
        home = [0.1, 1.5, 0.45, -0.7]
        cell.goto(home)
        held = cell.wait("state=held", timeout_s=60)
        np.testing.assert_allclose(held.q, home, atol=2e-3)
        cell.jog(np.array([0.05, 0, 0, 0]))
        jogged = cell.wait("state=held", timeout_s=60)
        np.testing.assert_allclose(jogged.q - held.q, [0.05, 0, 0, 0], atol=2e-3)
        cell.goto(taught)
        cell.wait("state=held", timeout_s=60)
        number = cell.status().goal
        cell.goal(taught)
        self.servo()
        self.assertEqual(cell.status().goal, number + 1)
        cell.set("gain", 3)

        # where the target is now is a goal too: the pose that vision measures
        seen = next(cell.measurements())
        X = seen.pose.copy()
        X[2, 3] += 0.03
        cell.goal(X_DO=X)
        cell.wait("converged", timeout_s=60)
        np.testing.assert_allclose(next(cell.measurements()).pose, X, atol=2e-3)

        self.assertEqual(cell.stop().state, "stopping")
        cell.wait("state=idle")
        cell.shutdown()
        self.assertEqual(self.daemon.wait(30), 0)
        with self.assertRaisesRegex(vservo.Unreachable, "vservo serve"):
            cell.status()

    def test_velocities_move_the_arm_and_silence_ends_them(self):
        cell = self.cell
        before = cell.status().q
        self.assertEqual(cell.velocities(hold_s=0.5).joints([0.2, 0, 0, -0.1]).state, "moving")
        after = cell.wait("state=held", timeout_s=60)
        np.testing.assert_allclose(after.q - before, [0.1, 0, 0, -0.05], atol=3e-3)
        with self.assertRaisesRegex(vservo.Refused, "one for each joint"):
            cell.velocities().joints([0.1])
        with self.assertRaisesRegex(ValueError, "V_C: has 3 numbers, 6 are needed"):
            cell.velocities().camera([0, 0, 0.1])

    def test_what_cannot_be_is_told_in_words(self):
        cell = self.cell
        with self.assertRaisesRegex(vservo.Refused, "hold was refused: nothing was started"):
            cell.hold()
        with self.assertRaisesRegex(vservo.Refused, "no fault"):
            cell.reset()
        with self.assertRaisesRegex(vservo.NotReached, "the run is idle: nothing moves it to the goal"):
            cell.wait("converged")
        for call, words in [
            (lambda: cell.wait("done"), "state=NAME"),
            (lambda: cell.wait(timeout_s=0), "more than 0 and at most 3600"),
            (lambda: cell.set("speed", 1), "gain, tolerance and hold"),
            (lambda: cell.goal(), "exactly one of"),
            (lambda: cell.goal(position_m=[0, 0]), "position_m: has 2 numbers, 3 are needed"),
            (lambda: cell.goal(X_DO=np.diag([1.0, 1, -1, 1])), "no rotation"),
            (lambda: cell.goal("absent.toml"), "absent.toml cannot be read"),
            (lambda: cell.run("absent.toml"), "absent.toml: cannot be read"),
            (lambda: cell.jog(), "either dq"),
            (lambda: vservo.connect("no such name"), "name"),
        ]:
            with self.assertRaisesRegex(ValueError, words):
                call()
        with self.assertRaises(vservo.Refused):
            cell.set("gain", -1)
        with self.assertRaises(vservo.Unreachable):
            vservo.connect("py-nobody")
        self.assertTrue(issubclass(vservo.Refused, vservo.Error))

    def test_programs_and_their_ends(self):
        lines = []
        self.cell.run(REPOSITORY / "config/programs/pick-and-place.toml", tell=lines.append)
        self.assertIn("steps[1].steps[2]: servo place", lines)
        self.assertEqual((self.cell.status().state, self.cell.status().goal), ("held", 4))
        with tempfile.TemporaryDirectory() as folder:
            program = pathlib.Path(folder, "p.toml")
            program.write_text('[[steps]]\ncall = ["false"]\n')
            with self.assertRaisesRegex(vservo.ProgramFailed, r"failed at steps\[0\]: `false` ended"):
                self.cell.run(program)
            program.write_text('[[steps]]\nsevo = "pick"\n')
            with self.assertRaisesRegex(ValueError, r"p.toml:2:\d+: steps\[0\].sevo"):
                self.cell.run(program)
            program.write_text("[[steps]]\nwait_s = 100\n")

            def broken(line):
                raise KeyError(line)

            began = time.monotonic()
            with self.assertRaises(KeyError):
                self.cell.run(program, tell=broken)
            self.assertLess(time.monotonic() - began, 10)

    def test_the_example_picks_and_places(self):
        from pick_and_place import pick_and_place

        told = []
        pick_and_place(self.cell, told.append)
        self.assertEqual(told, ["close", "open"])
        status = self.cell.wait("state=held")
        self.assertEqual(status.goal, 2)


class Streams(Served):
    def test_records_come_in_their_order(self):
        self.cell.start()
        joints = list(itertools.islice(self.cell.joint_states(), 2000))
        ticks = np.array([state.tick for state in joints])
        self.assertTrue((np.diff(ticks) >= 1).all())
        q, qd = np.array([state.q for state in joints]), np.array([state.qd for state in joints])
        stamps = np.array([state.stamp_s for state in joints])
        self.assertEqual(q.shape, (2000, 4))
        np.testing.assert_allclose(np.diff(stamps), 1e-3 * np.diff(ticks), atol=1e-9)
        # what it moved is the integral of how it moved
        moved = (np.diff(stamps)[:, None] * (qd[1:] + qd[:-1]) / 2).sum(0)
        np.testing.assert_allclose(q[-1] - q[0], moved, atol=5e-3)
        self.assertIsNotNone(joints[0].q_true)

        found = next(seen for seen in self.cell.measurements() if seen.found)
        self.assertEqual((found.px.shape, found.pose.shape), ((4, 2), (4, 4)))
        statuses = itertools.islice(self.cell.statuses(), 5)
        times = [status.time_s for status in statuses]
        np.testing.assert_allclose(np.diff(times), 0.02, atol=1e-9)

    def test_a_slow_reader_loses_the_oldest_and_a_stream_ends_with_its_run(self):
        stream = self.cell.joint_states()
        first = next(stream).tick
        until = time.monotonic() + 60
        while self.cell.status().tick < first + 20000:
            self.assertLess(time.monotonic(), until)
            time.sleep(0.05)
        ticks = [state.tick for state in itertools.islice(stream, 1500)]
        self.assertGreater(stream.lost, 0)
        gaps = sum(b - a - 1 for a, b in zip([first, *ticks], ticks))
        self.assertGreaterEqual(stream.lost, gaps)
        self.cell.shutdown()
        for _ in stream:
            pass
        self.daemon.wait(30)
        with self.assertRaises(vservo.Unreachable):
            self.cell.statuses()


class Waiting(Served):
    arguments = []  # in real time, so that an arm at rest takes its time

    def test_others_go_on_while_a_call_waits(self):
        counted = 0
        done = threading.Event()

        def wait():
            with self.assertRaises(vservo.NotReached):
                self.cell.wait("state=fault", timeout_s=1)
            done.set()

        threading.Thread(target=wait).start()
        while not done.is_set():
            counted += 1
            time.sleep(0.001)
        self.assertGreater(counted, 300)

    def test_ctrl_c_ends_a_wait_at_once(self):
        # Whoever runs the tests in the background may have them ignore it.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        for call in [
            lambda: self.cell.wait("state=fault", timeout_s=100),
            lambda: list(self.cell.measurements(camera=3, timeout_s=100)),
        ]:
            timer = threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT))
            began = time.monotonic()
            timer.start()
            with self.assertRaises(KeyboardInterrupt):
                call()
            self.assertLess(time.monotonic() - began, 5)


if __name__ == "__main__":
    unittest.main()
