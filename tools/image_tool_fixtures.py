#!/usr/bin/env python3
"""Makes tests/fixtures/image_tools: a picture, and what OpenCV and numpy find in it; points, and the poses that OpenCV finds for them.

    python3 -m venv v && v/bin/pip install numpy opencv-python-headless
    v/bin/python tools/image_tool_fixtures.py tests/fixtures/image_tools

Everything here is computed by OpenCV or written out in numpy; nothing comes from this project.
"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np


def scene(width=200, height=150, over=8):
    """A dark turned rectangle, a dark disc with a hole and a lighter ellipse on a light ground, blurred, with noise of 2 levels."""
    y, x = np.mgrid[0 : height * over, 0 : width * over]
    x, y = (x + 0.5) / over - 0.5, (y + 0.5) / over - 0.5
    image = np.full(x.shape, 205.0)
    angle = np.deg2rad(25.0)
    u = (x - 60) * np.cos(angle) + (y - 50) * np.sin(angle)
    v = -(x - 60) * np.sin(angle) + (y - 50) * np.cos(angle)
    image[(abs(u) < 35) & (abs(v) < 15)] = 40.0
    disc = np.hypot(x - 150, y - 45)
    image[(disc < 28) & (disc > 10)] = 50.0
    image[((x - 110) / 40) ** 2 + ((y - 112) / 22) ** 2 < 1] = 120.0
    image = image.reshape(height, over, width, over).mean(axis=(1, 3))
    image = cv2.GaussianBlur(image, (0, 0), 0.7, borderType=cv2.BORDER_REPLICATE)
    image += np.random.default_rng(7).normal(0.0, 2.0, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def region_numbers(mask, image):
    """Moments of each 8-connected region, in the reading order of the first pixels."""
    count, labels = cv2.connectedComponents(mask, connectivity=8)
    found = []
    for label in range(1, count):
        own = (labels == label).astype(np.uint8)
        first = int(np.argmax(own.ravel()))
        m = cv2.moments(own, binaryImage=True)
        grey = cv2.moments(np.where(own > 0, image, 0).astype(np.float32))
        axis = 0.5 * np.arctan2(2 * m["mu11"], m["mu20"] - m["mu02"])
        found.append(
            (first, {"m": m, "grey": {k: grey[k] for k in ("m00", "m10", "m01", "mu20", "mu11", "mu02")}, "axis_rad": float(axis)})
        )
    return [numbers for _, numbers in sorted(found, key=lambda f: f[0])]


def image_numbers(image):
    otsu, _ = cv2.threshold(image, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    level = 150
    mask = (image <= level).astype(np.uint8)
    sobel = [cv2.Sobel(image, cv2.CV_64F, dx, dy, ksize=3, borderType=cv2.BORDER_REPLICATE) for dx, dy in ((1, 0), (0, 1))]
    p = np.pad(image.astype(float), 1, mode="edge")
    c = p[1:-1, 1:-1]
    roberts = [p[2:, 2:] - c, p[2:, 1:-1] - p[1:-1, 2:]]
    differences = [p[1:-1, 2:] - c, p[2:, 1:-1] - c]
    laplacian = c - (p[2:, 1:-1] + p[:-2, 1:-1] + p[1:-1, 2:] + p[1:-1, :-2]) / 4

    def field(values):
        return {"least": float(values.min()), "greatest": float(values.max()), "mean": float(values.mean())}

    local = cv2.boxFilter(image, cv2.CV_64F, (31, 31), normalize=True, borderType=cv2.BORDER_REFLECT)
    inner = (slice(15, -15), slice(15, -15))
    contours, hierarchy = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    return {
        "otsu_threshold": float(otsu),
        "histogram": np.bincount(image.ravel(), minlength=256).tolist(),
        "level": level,
        "regions": region_numbers(mask, image),
        "sobel": field(np.hypot(*sobel)),
        "sobel_sum": field(abs(sobel[0]) + abs(sobel[1])),
        "roberts": field(np.hypot(*roberts)),
        "differences": field(np.hypot(*differences)),
        "sobel_above_60": int((np.hypot(*sobel) > 60).sum()),
        "laplacian": field(laplacian),
        "blurred_mean": float(cv2.GaussianBlur(image.astype(float), (7, 7), 1.0, borderType=cv2.BORDER_REPLICATE).mean()),
        "local_mean_inner_dark": int((image[inner] <= local[inner] - 8).sum()),
        "contours": len(contours),
        "holes": int(sum(1 for h in hierarchy[0] if h[3] >= 0)),
        "outer_areas": sorted(cv2.contourArea(k) for k, h in zip(contours, hierarchy[0]) if h[3] < 0),
    }


def project(R, t, points):
    p = points @ R.T + t
    return p[:, :2] / p[:, 2:]


def rotation(vector):
    return cv2.Rodrigues(np.asarray(vector, float).reshape(3, 1))[0]


def covariance(R, t, points, sd):
    """Of the twist [v; w] of the object relative to the camera, in the camera: inverse normal equations by differences."""
    h = 1e-6
    columns = []
    for k in range(6):
        d = np.zeros(6)
        d[k] = h
        plus = project(rotation(d[3:]) @ R, t + d[:3], points)
        minus = project(rotation(-d[3:]) @ R, t - d[:3], points)
        columns.append(((plus - minus) / (2 * h)).ravel())
    J = np.array(columns).T
    return np.linalg.inv(J.T @ J) * sd**2


def quaternion(R):
    w = np.sqrt(max(0.0, 1 + np.trace(R))) / 2
    return [float((R[2, 1] - R[1, 2]) / (4 * w)), float((R[0, 2] - R[2, 0]) / (4 * w)), float((R[1, 0] - R[0, 1]) / (4 * w)), float(w)]


def csv(points, images, sd):
    head = "id,x_m,y_m,z_m,X,Y,sd\n"
    return head + "".join(
        f"{i},{p[0]!r},{p[1]!r},{p[2]!r},{s[0]!r},{s[1]!r},{sd!r}\n" for i, (p, s) in enumerate(zip(points.tolist(), images.tolist()))
    )


def poses(folder):
    sd, answers = 5e-4, {}
    rng = np.random.default_rng(3)

    def store(name, points, images, found):
        (folder / f"{name}.csv").write_text(csv(points, images, sd))
        unit = np.eye(3)
        solutions = []
        for rvec, tvec in found:
            R, t = rotation(rvec), np.asarray(tvec, float).ravel()
            rms = float(np.sqrt(((project(R, t, points) - images) ** 2).sum() / len(points)))
            solutions.append({"position_m": t.tolist(), "rotation_xyzw": quaternion(R), "rms": rms,
                              "covariance": covariance(R, t, points, sd).ravel().tolist()})
        answers[name] = sorted(solutions, key=lambda s: s["rms"])
        return unit

    R, t = rotation([0.5, -0.3, 0.4]), np.array([0.03, -0.02, 0.6])
    square = np.array([[-0.05, -0.05, 0], [0.05, -0.05, 0], [0.05, 0.05, 0], [-0.05, 0.05, 0], [0.02, 0.01, 0]])
    noisy = project(R, t, square) + rng.normal(0, sd, (5, 2))
    _, r, p, _ = cv2.solvePnPGeneric(square, noisy, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    refined = [cv2.solvePnPRefineLM(square, noisy, np.eye(3), None, a.copy(), b.copy()) for a, b in zip(r, p)]
    store("square", square, noisy, refined)

    box = np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0], [0, 0, 0.08], [0.1, 0, 0.08], [0.1, 0.1, 0.08]], float)
    noisy = project(R, t, box) + rng.normal(0, sd, (7, 2))
    _, r, p = cv2.solvePnP(box, noisy, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
    store("box", box, noisy, [cv2.solvePnPRefineLM(box, noisy, np.eye(3), None, r, p)])

    three = np.array([[0.0, 0.0, 0.0], [0.12, 0.0, 0.01], [0.03, 0.1, -0.02]])
    exact = project(rotation([0.2, 0.3, -0.1]), np.array([0.0, 0.0, 0.4]), three)
    count, r, p = cv2.solveP3P(three, exact.reshape(3, 1, 2), np.eye(3), None, flags=cv2.SOLVEPNP_AP3P)
    store("three", three, exact, list(zip(r, p))[:count])
    return answers


def main():
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    image = scene()
    cv2.imwrite(str(folder / "scene.png"), image)
    numbers = {"opencv": cv2.__version__, "numpy": np.__version__, "image": image_numbers(image), "poses": poses(folder)}
    (folder / "numbers.json").write_text(json.dumps(numbers) + "\n")


main()
