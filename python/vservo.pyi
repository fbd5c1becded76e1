"""Visual servoing: servo laws, poses from images, closed loops, clients of running instances. Units are SI: m, rad, s; px where a name says so."""

from collections.abc import Callable, Iterator, Sequence
from os import PathLike
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

__version__: str

def camera_velocity(
    s: ArrayLike, s_desired: ArrayLike, depths_m: ArrayLike, gain_1_s: float = 1.0
) -> NDArray[np.float64]:
    """Velocity [v; w] (6,), m/s and rad/s, of a camera that shall see the points `s` (n, 2) at `s_desired` (n, 2); `depths_m` (n,)."""

def planar_pose(points_m: ArrayLike, s: ArrayLike) -> list[tuple[NDArray[np.float64], float]]:
    """Poses X_CO (4, 4) of a plane from its points (n, 2), m, and their normalized coordinates (n, 2), with their rms errors."""

def run_files() -> list[str]:
    """Names of the run files that come with the library."""

def detect(image: NDArray[np.uint8], target: str, camera: Camera | None = None) -> Measurement:
    """A target in one grey image (height, width); points in px alone without a camera."""

def calibrate(images: Sequence[NDArray[np.uint8]], board: str, model: str = "plumb_bob") -> Calibration:
    """The lens of the camera that took grey images (height, width) of a board, "chessboard:COLSxROWS:SQUARE_M"."""

def stereo(
    left: Sequence[NDArray[np.uint8]], right: Sequence[NDArray[np.uint8]], board: str, model: str = "plumb_bob"
) -> Pair:
    """Both lenses of a pair, and the pose between the cameras."""

def hand_eye(
    images: Sequence[NDArray[np.uint8]],
    poses: Sequence[ArrayLike],
    camera: Camera,
    board: str,
    eye_to_hand: bool = False,
    robot_sd_m: float = 3e-4,
    robot_sd_rad: float = 8.7e-4,
) -> HandEye:
    """Where the camera sits, by images of a board and the poses X_BE (4, 4) of the flange at them, m."""

class Calibration:
    """A camera from images of a board; deviations in px; poses X_CO (4, 4), m."""

    camera: Camera
    rms_px: float
    noise_px: float
    deviations: dict[str, float]
    unused: list[str | None]
    poses: list[NDArray[np.float64] | None]

class Pair:
    """A stereo pair: X_LR (4, 4), m, the right camera in the left one, and its covariance (6, 6), m and rad."""

    left: Calibration
    right: Calibration
    X_LR: NDArray[np.float64]
    covariance: NDArray[np.float64]
    rms_px: float

class HandEye:
    """The camera X (4, 4), m, in the flange (or the base), with its covariance (6, 6); `robot_sd` (2,), m and rad."""

    X: NDArray[np.float64]
    covariance: NDArray[np.float64]
    board: NDArray[np.float64]
    rms_px: float
    robot_sd: NDArray[np.float64]
    contradicted: bool
    verdict: str
    def to_toml(self) -> str: ...

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
        distortion: Sequence[float] = (),
        model: str = "plumb_bob",
    ) -> None:
        """Coefficients in the order of the model: "plumb_bob", "rational_polynomial" or "equidistant" (fisheye)."""

    @staticmethod
    def load(path: str | PathLike[str]) -> Camera: ...
    def save(self, path: str | PathLike[str], name: str = "camera") -> None: ...
    size_px: tuple[int, int]
    f_px: tuple[float, float]
    c_px: tuple[float, float]
    model: str
    distortion: list[float]

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

class Error(Exception):
    """What a run could not do, in words."""

class Refused(Error):
    """A request that the state of the run does not allow."""

class NotReached(Error):
    """A wait that ended in vain; says what is there instead."""

class Unreachable(Error):
    """No run of this name is there, or it does not answer."""

class ProgramFailed(Error):
    """A program that ended early; says at which step, and why."""

def connect(instance: str = "default", timeout_s: float = 5.0) -> Client:
    """A client of the run of this name, which must be there; `timeout_s` is the longest wait for each answer."""

class Client:
    """A client of a running instance. Each request returns the status after it, or raises `Refused`."""

    instance: str
    def status(self) -> Status: ...
    def start(self) -> Status: ...
    def hold(self) -> Status: ...
    def stop(self) -> Status: ...
    def shutdown(self) -> Status: ...
    def reset(self) -> Status: ...
    def wait(self, what: str = "converged", timeout_s: float = 30.0) -> Status:
        """Until "converged", "holding", "fault" or "state=NAME"; raises `NotReached` with what is there instead."""

    def goal(
        self,
        goal: Goal | str | PathLike[str] | None = None,
        *,
        X_DO: ArrayLike | None = None,
        position_m: ArrayLike | None = None,
        rotation_rpy_deg: ArrayLike | None = None,
        rotation_xyzw: ArrayLike | None = None,
        target: str | None = None,
    ) -> Status:
        """Another goal: taught, or the target in the camera there: `X_DO` (4, 4), or `position_m` (3,) with a rotation (3,) or (4,); `target`: whose it is."""

    def targets(self) -> list[str]:
        """Names of the targets of the run file; the first one is "target"."""

    def look_for(self, target: str) -> Status:
        """Another target from now on, with the last goal that it had."""

    def teach(self, save: str | PathLike[str] | None = None, timeout_s: float = 30.0) -> Goal:
        """The arm comes to rest, and its view becomes the goal."""

    def goto(self, place: Goal | str | PathLike[str] | ArrayLike) -> Status:
        """Begins to move to joint positions (joints,), rad or m, or the posture of a goal; `wait("state=held")` waits for it."""

    def jog(
        self,
        dq: ArrayLike | None = None,
        *,
        position_m: ArrayLike | None = None,
        rotation_rpy_deg: ArrayLike | None = None,
    ) -> Status:
        """Begins to move joints by `dq` (joints,), rad or m, or the camera in its own frame, (3,) and (3,)."""

    def velocities(self, hold_s: float = 0.1) -> Velocities:
        """Commands velocities, each of which holds for `hold_s`, 0.01 to 1 s; an arm that is sent none for longer brakes and rests."""

    def set(self, what: str, value: float) -> Status:
        """Changes "gain" (1/s), "tolerance" (px) or "hold" (s) in the running loop."""

    def run(self, program: str | PathLike[str], tell: Callable[[str], object] | None = None) -> None:
        """Does the steps of a program; `tell` hears of each. Raises `ProgramFailed`."""

    def statuses(self, timeout_s: float = 5.0) -> Statuses:
        """50 a second of the run's time, until it ends."""

    def measurements(self, camera: int = 0, timeout_s: float = 5.0) -> Measurements:
        """One of each frame of this camera, until the run ends."""

    def joint_states(self, timeout_s: float = 5.0) -> JointStates:
        """One of each tick of 1 ms, until the run ends."""

class Velocities:
    """Velocities that a program commands, as those of a law of its own. Each call returns the status after it, or raises `Refused`."""

    def joints(self, qd: ArrayLike) -> Status:
        """The joints by `qd` (joints,), rad/s or m/s; in the same direction, but slower, where one would be faster than it may."""

    def camera(self, V_C: ArrayLike) -> Status:
        """The camera by its twist (6,), in its own frame: along x, y, z, m/s, and about x, y, z, rad/s."""

class Statuses(Iterator[Status]):
    lost: int
    def __next__(self) -> Status: ...

class Measurements(Iterator[Measurement]):
    lost: int
    def __next__(self) -> Measurement: ...

class JointStates(Iterator[JointState]):
    lost: int
    def __next__(self) -> JointState: ...

class Goal:
    """A taught goal: kind and name of its target, points (n,), their normalized coordinates (n, 2), and the posture (joints,), rad or m."""

    target: str
    target_name: str | None
    ids: NDArray[np.uint32]
    normalized: NDArray[np.float64]
    q: NDArray[np.float64] | None
    @staticmethod
    def load(path: str | PathLike[str]) -> Goal: ...
    def save(self, path: str | PathLike[str]) -> None: ...

class Status:
    """How a run stands; what is unknown is None. `q` and `qd` (joints,) are not in a stream."""

    state: str
    fault: str | None
    target: str | None
    camera: str | None
    tick: int | None
    time_s: float | None
    goal: int | None
    target_number: int | None
    at_goal: bool
    at_goal_s: float | None
    stability: float | None
    feature_error_px: float | None
    position_error_m: float | None
    orientation_error_rad: float | None
    q: NDArray[np.float64] | None
    qd: NDArray[np.float64] | None

class JointState:
    """The arm at one tick, arrays (joints,): rad or m, rad/s or m/s, N m or N."""

    tick: int
    stamp_s: float
    q: NDArray[np.float64]
    qd: NDArray[np.float64]
    tau: NDArray[np.float64]
    q_r: NDArray[np.float64]
    qd_r: NDArray[np.float64]
    q_true: NDArray[np.float64] | None
    qd_true: NDArray[np.float64] | None
