"""Calibrations against cameras that are known, from images that are rendered by brute force here."""

import os
import tempfile
import unittest

import numpy as np
import vservo
from test_vservo import rotation

SQUARE = 0.025
SIZE = (480, 360)
F, C = 450.0, np.array([243.0, 176.0])
K1, K2 = -0.12, 0.05


def pose(R, p):
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R, p
    return X


def normalized(u, v):
    """Undistorts by fixed-point iteration of plumb_bob with k1 and k2."""
    x0, y0 = (u - C[0]) / F, (v - C[1]) / F
    x, y = x0.copy(), y0.copy()
    for _ in range(30):
        r2 = x * x + y * y
        scale = 1 + K1 * r2 + K2 * r2 * r2
        x, y = x0 / scale, y0 / scale
    return x, y


K = 3
V, U = np.mgrid[0 : SIZE[1] * K, 0 : SIZE[0] * K]
RAYS = np.stack([*normalized((U + 0.5) / K - 0.5, (V + 0.5) / K - 0.5), np.ones_like(U, float)], -1)


def rendered(X_CO):
    """A board of 9 x 6 inner corners: K x K rays a pixel meet its plane. Its origin is the first inner corner, beside a dark square."""
    R, p = X_CO[:3, :3], X_CO[:3, 3]
    rays, origin = RAYS @ R, -R.T @ p
    at = origin[:2] + rays[..., :2] * (-origin[2] / rays[..., 2])[..., None]
    i, j = np.floor(at[..., 0] / SQUARE) + 1, np.floor(at[..., 1] / SQUARE) + 1
    inside = (i >= 0) & (i < 10) & (j >= 0) & (j < 7)
    level = np.where(inside & ((i + j) % 2 == 0), 30.0, 210.0)
    return level.reshape(SIZE[1], K, SIZE[0], K).mean((1, 3)).round().astype(np.uint8)


BOARD = "chessboard:9x6:0.025"
MIDDLE = np.array([0.1, 0.0625, 0.0])


def views(count):
    """Boards about half a metre ahead, tilted to all sides."""
    draw = np.random.default_rng(5)
    for k in range(count):
        axis = [np.cos(2.4 * k), np.sin(2.4 * k), 0.15 * (k % 3)]
        R = rotation(axis, 0.35 + 0.05 * (k % 4)) @ rotation([0, 0, 1], 0.5 * ((k % 5) - 2))
        yield pose(R, np.array([*draw.uniform(-0.05, 0.05, 2), draw.uniform(0.42, 0.55)]) - R @ MIDDLE)


class Calibrate(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.poses = list(views(12))
        cls.images = [rendered(X) for X in cls.poses]
        cls.camera = vservo.Camera(*SIZE, F, F, *C, [K1, K2])

    def test_a_camera_comes_back(self):
        blank = np.full(SIZE[::-1], 90, np.uint8)
        found = vservo.calibrate([*self.images, blank], BOARD)
        self.assertEqual(found.unused[:-1], [None] * 12)
        self.assertIsNotNone(found.unused[-1])
        np.testing.assert_allclose(found.camera.f_px, F, rtol=2e-3)
        np.testing.assert_allclose(found.camera.c_px, C, atol=1.0)
        np.testing.assert_allclose(found.camera.distortion[0], K1, atol=0.02)
        self.assertLess(found.rms_px, 0.1)
        self.assertIn("fx_px", found.deviations)
        for X, known in zip(found.poses, self.poses):
            np.testing.assert_allclose(X, known, atol=5e-3)
        self.assertIsNone(found.poses[-1])
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "camera.yaml")
            found.camera.save(path, "test")
            again = vservo.Camera.load(path)
        np.testing.assert_allclose(again.f_px, found.camera.f_px)
        np.testing.assert_allclose(again.distortion, found.camera.distortion)
        with self.assertRaisesRegex(ValueError, "give chessboard"):
            vservo.calibrate(self.images, "four_dots")
        with self.assertRaisesRegex(ValueError, "plumb_bob, rational_polynomial, equidistant"):
            vservo.calibrate(self.images, BOARD, "pinhole")

    def test_a_pair_comes_back(self):
        X_LR = pose(rotation([0.1, 1, 0], 0.08), [0.06, 0.002, -0.001])
        seen = [rendered(np.linalg.inv(X_LR) @ X) for X in self.poses]
        pair = vservo.stereo(self.images, seen, BOARD)
        np.testing.assert_allclose(pair.X_LR, X_LR, atol=1.5e-3)
        np.testing.assert_allclose(pair.right.camera.f_px, F, rtol=3e-3)
        self.assertEqual(pair.covariance.shape, (6, 6))
        with self.assertRaisesRegex(ValueError, "12"):
            vservo.stereo(self.images, seen[:-1], BOARD)

    def test_a_mount_comes_back(self):
        X_EC = pose(rotation([1, 2, 3], 0.7), [0.03, -0.05, 0.08])
        X_BO = pose(rotation([0, 1, 0.2], 2.8), [0.5, 0.1, 0.0])
        flange = [X_BO @ np.linalg.inv(X) @ np.linalg.inv(X_EC) for X in self.poses]
        found = vservo.hand_eye(self.images, flange, self.camera, BOARD)
        np.testing.assert_allclose(found.X, X_EC, atol=1e-3)
        np.testing.assert_allclose(found.board, X_BO, atol=1e-3)
        self.assertFalse(found.contradicted, found.verdict)
        self.assertIn('kind = "eye_in_hand"', found.to_toml())
        # Poses of other images fit nothing.
        with self.assertRaisesRegex(ValueError, "11 poses"):
            vservo.hand_eye(self.images, flange[:-1], self.camera, BOARD)

    def test_targets_are_found_in_single_images(self):
        seen = vservo.detect(self.images[0], BOARD, self.camera)
        self.assertTrue(seen.found, seen.status)
        np.testing.assert_allclose(seen.pose, self.poses[0], atol=2e-3)
        alone = vservo.detect(self.images[0], BOARD)
        self.assertTrue(alone.found, alone.status)
        np.testing.assert_allclose(alone.px, seen.px, atol=0.05)
        self.assertIsNone(alone.pose)
        self.assertTrue(np.isnan(alone.normalized).all())
        self.assertFalse(vservo.detect(self.images[0], "tag:36h11:0.08:5").found)

    def test_fisheye_lenses_are_cameras_too(self):
        camera = vservo.Camera(640, 480, 300, 300, 320, 240, [0.01, -0.002], "fisheye")
        self.assertEqual((camera.model, camera.distortion), ("equidistant", [0.01, -0.002, 0, 0]))
        with self.assertRaisesRegex(ValueError, "equidistant has 4"):
            vservo.Camera(640, 480, 300, 300, 320, 240, [0] * 5, "equidistant")


if __name__ == "__main__":
    unittest.main()
