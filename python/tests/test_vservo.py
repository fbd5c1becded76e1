"""The Python module against numbers that are known otherwise: run with `python -m unittest discover python/tests`."""

import unittest

import numpy as np
import vservo

SQUARE = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]])


def rotation(axis, angle):
    """Rodrigues' formula."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def seen_from(R, p):
    """Normalized coordinates and depths of the square at R, p in the camera."""
    points = np.c_[SQUARE, np.zeros(4)] @ R.T + p
    return points[:, :2] / points[:, 2:], points[:, 2].copy()


class Law(unittest.TestCase):
    def test_velocity_is_the_least_squares_solution(self):
        s, z = seen_from(rotation([1, 2, 3], 0.4), [0.02, -0.1, 0.7])
        s_d, _ = seen_from(np.eye(3), [-0.05, -0.05, 0.5])
        # (10.27), written out anew
        rows = []
        for (x, y), d in zip(s, z):
            rows.append([-1 / d, 0, x / d, x * y, -(1 + x * x), y])
            rows.append([0, -1 / d, y / d, 1 + y * y, -x * y, -x])
        wanted, *_ = np.linalg.lstsq(np.array(rows), 2.0 * (s_d - s).ravel(), rcond=None)
        got = vservo.camera_velocity(s, s_d, z, gain_1_s=2.0)
        np.testing.assert_allclose(got, wanted, rtol=1e-9, atol=1e-12)

    def test_lists_are_arrays_too(self):
        s, z = seen_from(rotation([1, 2, 3], 0.4), [0.02, -0.1, 0.7])
        s_d, _ = seen_from(np.eye(3), [-0.05, -0.05, 0.5])
        np.testing.assert_array_equal(
            vservo.camera_velocity(s.tolist(), s_d.tolist(), z.tolist()), vservo.camera_velocity(s, s_d, z)
        )
        X, _ = vservo.planar_pose(SQUARE.tolist(), s.tolist())[0]
        np.testing.assert_array_equal(X, vservo.planar_pose(SQUARE, s)[0][0])

    def test_what_cannot_be_is_told(self):
        s, z = seen_from(np.eye(3), [0, 0, 0.5])
        for arguments in [(s, s[:3], z), (s.ravel()[None], s, z), (s, s, -z), (s * np.nan, s, z), (s[:1], s[:1], z[:1])]:
            with self.assertRaises(ValueError):
                vservo.camera_velocity(*arguments)

    def test_pose_of_a_plane_comes_back(self):
        R, p = rotation([1, -2, 0.5], 0.6), np.array([0.03, -0.02, 0.6])
        s, _ = seen_from(R, p)
        X, rms = vservo.planar_pose(SQUARE, s)[0]
        np.testing.assert_allclose(X, np.r_[np.c_[R, p], [[0, 0, 0, 1]]], atol=1e-9)
        self.assertLess(rms, 1e-9)


def rendered(R, p, f=600.0):
    """A plate with four discs, by brute force: 4 x 4 rays a pixel meet the plane."""
    width, height, k = 640, 480, 4
    v, u = np.mgrid[0 : height * k, 0 : width * k]
    u, v = (u + 0.5) / k - 0.5, (v + 0.5) / k - 0.5
    rays = np.stack([(u - 319.5) / f, (v - 239.5) / f, np.ones_like(u)], -1) @ R  # in O
    origin = -R.T @ p
    at = origin[:2] + rays[..., :2] * (-origin[2] / rays[..., 2])[..., None]
    level = np.full(at.shape[:2], 60.0)
    level[((at > -0.03) & (at < 0.13)).all(-1)] = 220
    for i, centre in enumerate(SQUARE):
        level[((at - centre) ** 2).sum(-1) < (0.015 if i == 0 else 0.010) ** 2] = 20
    return level.reshape(height, k, width, k).mean((1, 3)).round().astype(np.uint8)


class Eye(unittest.TestCase):
    camera = vservo.Camera(640, 480, 600, 600, 319.5, 239.5)

    def test_pose_from_an_image(self):
        R, p = rotation([1, 0.5, 0.2], 0.5), np.array([-0.03, -0.04, 0.55])
        image = rendered(R, p)
        vision = vservo.Vision(self.camera)
        for _ in range(2):  # searched, then tracked
            seen = vision.process(image)
            self.assertTrue(seen.found, seen.status)
            np.testing.assert_array_equal(seen.ids, [0, 1, 2, 3])
            s, _ = seen_from(R, p)
            np.testing.assert_allclose(seen.normalized, s, atol=1e-4)
            np.testing.assert_allclose(seen.px, s * 600 + [319.5, 239.5], atol=0.06)
            np.testing.assert_allclose(seen.pose[:3, 3], p, atol=1e-3)
            np.testing.assert_allclose(seen.pose[:3, :3], R, atol=5e-3)
            self.assertEqual(seen.covariance.shape, (6, 6))
            self.assertTrue((seen.sd_px > 0).all())

    def test_a_part_of_a_larger_array_and_what_is_no_image(self):
        R, p = np.eye(3), np.array([-0.05, -0.05, 0.5])
        large = np.zeros((500, 700), np.uint8)
        large[10:490, 20:660] = rendered(R, p)
        self.assertTrue(vservo.Vision(self.camera).process(large[10:490, 20:660]).found)
        blank = vservo.Vision(self.camera).process(np.zeros((480, 640), np.uint8))
        self.assertFalse(blank.found)
        self.assertIsNone(blank.pose)
        self.assertIn("contrast", blank.status)
        other = vservo.Vision(self.camera).process(np.zeros((48, 64), np.uint8))
        self.assertFalse(other.found)
        with self.assertRaises(TypeError):
            vservo.Vision(self.camera).process(np.zeros((480, 640)))
        with self.assertRaises(ValueError):
            vservo.Vision(self.camera, "five_dots")
        with self.assertRaises(ValueError):
            vservo.Camera(640, 480, -1, 600, 0, 0)


class Lagging:
    """Joints that follow the commanded velocity by a lag."""

    def __init__(self, q):
        self.q, self.qd, self.wanted, self.last = np.array(q), np.zeros(len(q)), np.zeros(len(q)), 0.0

    def read(self, time_s):
        dt, self.last = time_s - self.last, time_s
        self.qd += (self.wanted - self.qd) * min(dt / 0.005, 1)
        self.q += self.qd * dt
        return self.q, self.qd

    def write(self, tau, q_r, qd_r):
        self.wanted = qd_r


class Loop(unittest.TestCase):
    own = ["drive.kind=ideal", "drive.mode=velocity", "servo.lead_ms=5"]

    def test_a_run_is_the_same_twice_and_comes_home(self):
        first, again = vservo.simulate("ur5"), vservo.simulate("ur5")
        self.assertEqual(first.outcome, "converged")
        self.assertEqual(first.state_hash, again.state_hash)
        np.testing.assert_array_equal(first.q, again.q)
        n = len(first.time_s)
        self.assertEqual((first.q.shape, first.qd.shape, first.tau.shape), ((n, 6), (n, 6), (n, 6)))
        self.assertLess(first.position_error_m[-1], 5e-4)
        self.assertLess(first.feature_error_px[-1], 0.1)
        # velocities are those of the positions
        middle = (first.q[2:] - first.q[:-2]) / 2e-3
        self.assertLess(np.abs(middle - first.qd[1:-1]).max(), 0.05)

    def test_a_drive_of_ones_own(self):
        start = vservo.simulate("ur5", ["run.duration_s=0.05"]).q[0]
        drive = Lagging(start)
        run = vservo.simulate("ur5", self.own, drive)
        self.assertEqual(run.outcome, "converged", run.reason)
        self.assertLess(run.position_error_m[-1], 5e-4)
        np.testing.assert_allclose(drive.q, run.q[-1], atol=1e-3)

    def test_exceptions_of_a_drive_come_out(self):
        class Broken(Lagging):
            def write(self, tau, q_r, qd_r):
                raise RuntimeError("the cable is out")

        class Short(Lagging):
            def read(self, time_s):
                return [0.0], [0.0]

        with self.assertRaisesRegex(RuntimeError, "the cable is out"):
            vservo.simulate("ur5", self.own, Broken(np.zeros(6)))
        with self.assertRaisesRegex(ValueError, "6 joints"):
            vservo.simulate("ur5", self.own, Short(np.zeros(6)))

    def test_wrong_settings_are_told_by_key(self):
        with self.assertRaisesRegex(ValueError, "camera.rate_hz"):
            vservo.simulate("ur5", ["camera.rate_hz=1e9"])
        self.assertIn("ur5", vservo.run_files())


if __name__ == "__main__":
    unittest.main()
