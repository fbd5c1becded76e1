"""Visual servoing: servo laws, poses from images, closed loops. Units are SI: m, rad, s; px where a name says so."""

from collections.abc import Sequence
from os import PathLike
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

__version__: str

def camera_velocity(
    s: NDArray[np.float64],
    s_desired: NDArray[np.float64],
    depths_m: NDArray[np.float64],
    gain_1_s: float = 1.0,
) -> NDArray[np.float64]: ...
def planar_pose(
    points_m: NDArray[np.float64], s: NDArray[np.float64]
) -> list[tuple[NDArray[np.float64], float]]: ...
def run_files() -> list[str]: ...

class Drive(Protocol):
    def read(self, time_s: float) -> tuple[Sequence[float], Sequence[float]]: ...
    def write(
        self, tau: NDArray[np.float64], q_r: NDArray[np.float64], qd_r: NDArray[np.float64]
    ) -> None: ...

def simulate(
    config: str | PathLike[str] | None = None,
    settings: Sequence[str] = (),
    drive: Drive | None = None,
) -> Run: ...

class Camera:
    def __init__(
        self,
        width_px: int,
        height_px: int,
        fx_px: float,
        fy_px: float,
        cx_px: float,
        cy_px: float,
        distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0),
    ) -> None: ...

class Vision:
    def __init__(self, camera: Camera, target: str = "four_dots", track: bool = True) -> None: ...
    def process(self, image: NDArray[np.uint8], after_s: float = 0.04) -> Measurement: ...

class Measurement:
    found: bool
    status: str
    ids: NDArray[np.uint64]
    px: NDArray[np.float64]
    normalized: NDArray[np.float64]
    sd_px: NDArray[np.float64]
    pose: NDArray[np.float64] | None
    covariance: NDArray[np.float64] | None
    ambiguous: bool
    reprojection_rms_px: float

class Run:
    outcome: str
    reason: str
    settling_time_s: float | None
    state_hash: str
    time_s: NDArray[np.float64]
    q: NDArray[np.float64]
    qd: NDArray[np.float64]
    tau: NDArray[np.float64]
    feature_error_px: NDArray[np.float64]
    position_error_m: NDArray[np.float64]
    orientation_error_rad: NDArray[np.float64]
