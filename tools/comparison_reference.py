#!/usr/bin/env python3
"""Reference trajectories of the comparison of Sect. 10.9 and Example 10.6, independent of the Rust sources.

Written from the textbook's equations, with the arm's dynamics in closed form, dense matrices from numpy and nothing
shared with the program. `tests/processes/experiments.rs` holds the program's CSV files against the tables that this writes:

    python3 tools/comparison_reference.py tests/fixtures/comparison            # every 40 ms
    python3 tools/comparison_reference.py OUT --step-ms 1                      # the whole grid

Conventions: base, camera and object z point down; vision at 25 Hz, first frame at t = 0, no latency. A and C: torque
held for 0.04 s, Runge-Kutta of fourth order. B, D, hybrid: q moves with the held joint velocity. Position-based
schemes: 40 Euler steps of 1 ms with K_s = 160 I per frame, warm start, first start x_d,o.
"""

import argparse
import pathlib

import numpy as np

A1, A2, L1, L2 = 1.0, 1.0, 0.5, 0.5
M_L1, M_L2, M_L3 = 50.0, 50.0, 2.0
I_L1, I_L2, I_L4 = 10.0, 10.0, 1.0
K_R1, K_R2 = 100.0, 100.0
M_M2, I_M1, I_M2 = 5.0, 0.01, 0.01
G = 9.81

FRAME_S, END_S = 0.04, 8.0
X_OBJECT = np.array([1.0, 1.0, 1.0, np.pi / 4])  # object in the base: position and angle
X_DO = np.array([-0.1, 0.1, 0.6, -np.pi / 3])
Q_START = np.array([0.0, np.pi / 2, 0.5, -np.pi / 4])
POINTS = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]])


def rot(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def rot4(angle):
    """diag(Rz, 1) on [x y z angle]."""
    R = np.eye(4)
    R[:2, :2] = rot(angle)
    return R


def camera(q):
    q1, q12 = q[0], q[0] + q[1]
    return np.array([np.cos(q1) + np.cos(q12), np.sin(q1) + np.sin(q12), q[2], q12 + q[3]])


def jacobian(q):
    q1, q12 = q[0], q[0] + q[1]
    s1, c1, s12, c12 = np.sin(q1), np.cos(q1), np.sin(q12), np.cos(q12)
    return np.array(
        [[-A1 * s1 - A2 * s12, -A2 * s12, 0, 0], [A1 * c1 + A2 * c12, A2 * c12, 0, 0], [0, 0, 1, 0], [1, 1, 0, 1]]
    )


def mass_matrix(q):
    c2 = np.cos(q[1])
    B = np.zeros((4, 4))
    B[0, 0] = (
        I_L1 + M_L1 * L1**2 + K_R1**2 * I_M1 + I_L2 + M_L2 * (A1**2 + L2**2 + 2 * A1 * L2 * c2) + I_M2 + M_M2 * A1**2
    )
    B[0, 1] = I_L2 + M_L2 * (L2**2 + A1 * L2 * c2) + K_R2 * I_M2
    B[1, 1] = I_L2 + M_L2 * L2**2 + K_R2**2 * I_M2
    B[0, 0] += M_L3 * (A1**2 + A2**2 + 2 * A1 * A2 * c2)
    B[0, 1] += M_L3 * (A2**2 + A1 * A2 * c2)
    B[1, 1] += M_L3 * A2**2
    B[1, 0] = B[0, 1]
    B[2, 2] = M_L3
    turn = np.array([1.0, 1.0, 0.0, 1.0])
    return B + I_L4 * np.outer(turn, turn)


def gravity():
    return np.array([0.0, 0.0, -M_L3 * G, 0.0])


def acceleration(q, qd, u):
    h = -(M_L2 * A1 * L2 + M_L3 * A1 * A2) * np.sin(q[1])
    coriolis = np.array([h * qd[1] * (2 * qd[0] + qd[1]), -h * qd[0] ** 2, 0.0, 0.0])
    return np.linalg.solve(mass_matrix(q), u - gravity() - coriolis)


def relative(x_c):
    """x_c,o, (10.33)."""
    p = rot(-x_c[3]) @ (X_OBJECT[:2] - x_c[:2])
    return np.array([p[0], p[1], X_OBJECT[2] - x_c[2], X_OBJECT[3] - x_c[3]])


def project(x_co, points=POINTS):
    p = points @ rot(x_co[3]).T + x_co[:2]
    return p / x_co[2]


def interaction(s, z):
    """Columns v_x v_y v_z w_z of (10.27), stacked."""
    rows = []
    for X, Y in s:
        rows += [[-1 / z, 0, X / z, Y], [0, -1 / z, Y / z, -X]]
    return np.array(rows)


def camera_at_goal():
    """x_c from which the object is seen at x_d,o: T_c^b = T_o^b (T_o^d)^-1."""
    alpha = X_OBJECT[3] - X_DO[3]
    return np.append(np.append(X_OBJECT[:2] - rot(alpha) @ X_DO[:2], X_OBJECT[2] - X_DO[2]), alpha)


def overshoot_percent(z):
    """How far the camera draws back beyond the goal's height (not beyond that of the last sample)."""
    z_d = camera_at_goal()[2]
    return 100.0 * (z_d - z.min()) / abs(z_d - z[0])


def path_deviation(p):
    """Greatest distance of the points p from the line start - goal, over the distance of start and goal."""
    line = camera_at_goal()[:3] - p[0]
    length = np.linalg.norm(line)
    return np.linalg.norm(np.cross(p - p[0], line), axis=1).max() / length**2


def gamma(p):
    """Gamma of (10.18) for the motions x, y, z and about z."""
    Gm = -np.eye(4)
    # S(p) e_z = p x e_z = [p_y, -p_x, 0]
    Gm[0, 3], Gm[1, 3] = p[1], -p[0]
    return Gm


class Estimator:
    """(10.38) with two points, warm started."""

    def __init__(self):
        self.x = X_DO.copy()

    def run(self, s):
        for _ in range(40):
            s_hat = project(self.x, POINTS[:2])
            J = interaction(s_hat, self.x[2]) @ gamma(-self.x[:3])
            self.x = self.x + 1e-3 * np.linalg.solve(J, 160.0 * (s - s_hat).ravel())
        return self.x


def position_error(x_co):
    """x~ of (10.69) through (10.68)."""
    alpha_dc = X_DO[3] - x_co[3]
    o = X_DO[:3].copy()
    o[:2] -= rot(alpha_dc) @ x_co[:2]
    o[2] -= x_co[2]
    return -np.append(o, alpha_dc), alpha_dc


class Schemes:
    def __init__(self):
        self.estimator = Estimator()

    def jacobian_d(self, q, alpha_dc):
        alpha_d = camera(q)[3] - alpha_dc
        return rot4(-alpha_d) @ jacobian(q)

    def A(self, q, qd, s):
        x_t, alpha_dc = position_error(self.estimator.run(s[:2]))
        J = self.jacobian_d(q, alpha_dc)
        K = np.diag([500.0, 500.0, 10.0, 10.0])
        return gravity() + J.T @ (K @ x_t - K @ J @ qd)

    def B(self, q, qd, s):
        x_t, alpha_dc = position_error(self.estimator.run(s[:2]))
        return np.linalg.solve(self.jacobian_d(q, alpha_dc), np.diag([1.0, 1.0, 1.0, 2.0]) @ x_t)

    def C(self, q, qd, s):
        J_L = interaction(s[:2], X_DO[2]) @ rot4(-camera(q)[3]) @ jacobian(q)
        e = (project(X_DO)[:2] - s[:2]).ravel()
        return gravity() + J_L.T @ (300.0 * e - 330.0 * J_L @ qd)

    def D(self, q, qd, s):
        e = (project(X_DO)[:2] - s[:2]).ravel()
        v = np.linalg.solve(interaction(s[:2], X_DO[2]), e)
        return np.linalg.solve(jacobian(q), rot4(camera(q)[3]) @ v)

    def hybrid(self, q, qd, s):
        s_d = project(X_DO)
        rows = []  # (10.61): s~_c x (H s~_d) = 0, two rows a point
        for (X, Y), (Xd, Yd) in zip(s, s_d):
            d = np.array([Xd, Yd, 1.0])
            o = np.zeros(3)
            rows += [np.concatenate([d, o, -X * d]), np.concatenate([o, d, -Y * d])]
        H = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3)
        H /= np.linalg.norm(H[:, 0])
        if np.append(s[0], 1.0) @ H @ np.append(s_d[0], 1.0) < 0:
            H = -H
        beta = np.arctan2(H[1, 0], H[0, 0])
        w = 2.0 * beta
        X, Y = s[0]
        rho = np.linalg.det(H)  # the normals are along z here
        z = X_DO[2] * rho
        e_p = np.array([s_d[0, 0] - X, s_d[0, 1] - Y, -np.log(rho)])
        J_p = np.array([[-1, 0, X], [0, -1, Y], [0, 0, -1]]) / z
        J_o = np.array([Y, -X, 0.0])
        nu = np.linalg.solve(J_p, e_p - J_o * w)
        return np.linalg.solve(jacobian(q), rot4(camera(q)[3]) @ np.append(nu, w))


def simulate(name, substeps):
    law = getattr(Schemes(), name)
    torque = name in "AC"
    q, qd, u = Q_START.copy(), np.zeros(4), None
    rows = []
    for k in range(round(END_S * 1000) + 1):
        s = project(relative(camera(q)))
        if k % round(FRAME_S * 1000) == 0:
            u, q_frame, k_frame = law(q, qd, s), q.copy(), k
        rows.append(np.concatenate([[k * 1e-3], camera(q), s.ravel(), q, u]))
        if torque:
            h = 1e-3 / substeps
            for _ in range(substeps):
                f = lambda q, qd: (qd, acceleration(q, qd, u))
                a1, b1 = f(q, qd)
                a2, b2 = f(q + h / 2 * a1, qd + h / 2 * b1)
                a3, b3 = f(q + h / 2 * a2, qd + h / 2 * b2)
                a4, b4 = f(q + h * a3, qd + h * b3)
                q = q + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
                qd = qd + h / 6 * (b1 + 2 * b2 + 2 * b3 + b4)
        else:
            q = q_frame + u * ((k + 1 - k_frame) * 1e-3)
    return np.array(rows)


HEADER = "time_s,x_m,y_m,z_m,alpha_rad,X1,Y1,X2,Y2,X3,Y3,X4,Y4,q1,q2,q3,q4,u1,u2,u3,u4"


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("--step-ms", type=int, default=40)
    parser.add_argument("--substeps", type=int, default=4)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in ["A", "B", "C", "D", "hybrid"]:
        rows = simulate(name, arguments.substeps)[:: arguments.step_ms]
        np.savetxt(arguments.out / f"{name}.csv", rows, "%.10g", ",", header=HEADER, comments="")
        print(
            f"{name}: final {rows[-1, 1:5]}, z overshoot {overshoot_percent(rows[:, 3]):.1f} %, "
            f"camera path {path_deviation(rows[:, 1:4]):.4f} off its line, largest u {abs(rows[:, 17:]).max():.4g}"
        )


if __name__ == "__main__":
    main()
