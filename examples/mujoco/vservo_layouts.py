"""Records of vservo 0.1.0. Made by `vservo layouts --lang python`."""
import ctypes
import enum

MAX_JOINTS = 7
MAX_FEATURES = 64
MAX_CAMERAS = 4

# Services, each in the name space of its instance.
SERVICE_CAMERA_FRAME = "camera/0/frame"  # FrameHeader
SERVICE_CAMERA_IMAGE = "camera/0/image"  # ImageHeader
SERVICE_CAMERA_HEALTH = "camera/0/health"  # CameraHealth
SERVICE_VISION_MEASUREMENT = "vision/0/measurement"  # Measurement
SERVICE_CONTROL_JOINT_STATE = "control/joint_state"  # JointState
SERVICE_CONTROL_TRACE = "control/trace"  # Trace
SERVICE_CONTROL_STATUS = "control/status"  # Status
SERVICE_CONTROL_REQUEST = "control/request"  # Request
SERVICE_CONTROL_COMMAND = "control/command"  # ControlCommand, ControlAnswer
SERVICE_DRIVE_COMMAND = "drive/command"  # DriveCommand
SERVICE_DRIVE_STATE = "drive/state"  # DriveState
SERVICE_DRIVE_TEXT = "drive/text"  # DriveText


class AnswerFlag(enum.IntFlag):
    SERVED = 1  # The run serves requests, and ends on request.
    CLEARING = 2  # A reset was accepted, and waits until the robot has cleared its error.
    HELD_BY_CONTROL = 4  # Control holds the arm itself, since camera or vision was lost and the start is manual: until the next request that moves or stops it.


class DriveFlag(enum.IntFlag):
    TRUTH = 1  # State: q_true and qd_true are valid.
    START = 2  # Command: a run begins. A simulator puts its arm at rest in q_r; every drive holds it there and answers with an INITIAL state.
    INITIAL = 4  # State: the answer to START, tick 0.
    LAST = 8  # Command: the run has ended and no command follows; the drive holds its arm by its own means. Not answered.
    LOCKSTEP = 16  # Command with START: the run is in lockstep, every command is answered with one state.
    CLEAR = 32  # Command: somebody has asked for a reset while the robot reported a RobotState that can be cleared. The drive clears the robot's error, holds the arm until that is done, and then reports Ready. Without this bit it clears nothing.
    GRAVITY = 64  # Command in mode torque: tau holds the arm's weight. Without this bit the robot is to add what does (drive.torque_contains).
    FRICTION = 128  # Command in mode torque: tau makes up for the friction of the joints. Without this bit the robot is to do so (drive.torque_contains).


class FrameFlag(enum.IntFlag):
    LAST = 1  # The source ends with this frame (replay, played once).


class HealthFlag(enum.IntFlag):
    STAMPS_DOUBTED = 1  # The device's stamps are implausible: frames are stamped by their arrival.
    RATE_MISSED = 2  # The device delivers another frame rate than requested.


class JointFlag(enum.IntFlag):
    TRUTH = 1  # q_true and qd_true are valid.


class MeasurementFlag(enum.IntFlag):
    POSE = 256  # pose and pose_covariance are valid.
    TRACKED = 512  # Found in predicted windows; without this bit the whole frame was searched.
    AMBIGUOUS = 1024  # A second pose explains the image almost as well (planar ambiguity).
    PARTIAL = 2048  # Some of the target's points are occluded, or were left out as outliers.
    MODEL_ERROR = 4096  # The points fit no pose within noise, but steadily so: the description of lens, target or shutter is not exact. The stated uncertainties contain it.


class StatusFlag(enum.IntFlag):
    DEGRADED = 1  # Some features are hidden; the law uses the others.
    SEARCHING = 2  # While the state is returning: the arm looks around for its target.


class StopWordOffset(enum.IntEnum):
    STOP = 0  # Add 1 to bring the arm to rest. The file is /dev/shm/vservo-NAME/stop of the instance NAME; each number has 8 bytes.
    SHUTDOWN = 24  # Add 1 to bring the arm to rest and end the run.
    LATCHED_STOP = 48  # Add 1, or write any other number than lies there, to bring the arm to rest by a fault that stays until it is reset.
    GUARDIAN_STOP = 88  # How often the guardian has stopped the arm. A drive brakes by itself, and holds, as long as the next number is another one.
    GUARDIAN_RESET = 96  # Up to which of them a reset has come.


class TextKind(enum.IntEnum):
    JOINTS = 1  # Names of the joints.
    ROBOT = 2  # Words about the robot.
    PROPERTIES = 3  # What the drive tells of itself, a line each: period_ms, watchdog_ms, effort_rate. Chosen by hand: the next number.


class TraceFlag(enum.IntFlag):
    MEASUREMENT = 1  # A measurement arrived with this tick.
    TRUTH = 2  # q_true and qd_true are valid.
    LAST = 4  # The run is over: no record follows.
    LATE_STATE = 8  # The drive had no new state in time.
    END_ASKED = 16  # A signal, or the process of control itself, asked for the end at the begin of this tick.
    STOP_ASKED = 32  # stop was asked for at the begin of this tick by the stop word.
    SHUTDOWN_ASKED = 64  # shutdown was asked for at the begin of this tick by the stop word.
    ORDERS_GIVEN = 128  # The mission gave out its orders when it had seen this record; without this bit it saw the next one first.
    CONTACT = 67108864  # Something touches the arm; TraceMsg.external_torque tells what each joint feels of it.
    MOTION_OVER = 134217728  # The drive was an arm that was recorded, and this its last state.
    REPORTED_FAULT = 8  # From this bit on, up to CONTACT: the code of the fault that was reported to control at this tick from outside, by the drive or the process; 0: none.
    ROBOT_STATE = 28  # From this bit on: the code of the RobotState that the drive reported at this tick.


class CameraState(enum.IntEnum):
    UNKNOWN = 0
    STARTING = 1
    STREAMING = 2
    STALLED = 3
    RECOVERING = 4
    GONE = 5


class CommandForm(enum.IntEnum):
    FEATURES = 1
    POSE = 2
    JOINTS = 3
    CAMERA_MOTION = 4
    GAIN = 5
    TOLERANCE = 6
    HOLD = 7
    JOINT_VELOCITY = 8
    CAMERA_TWIST = 9


class ControlState(enum.IntEnum):
    WAITING = 0
    SERVOING = 1
    HOLDING = 2
    CONVERGED = 3
    STOPPED = 4
    FAULT = 5
    IDLE = 6
    TEACHING = 7
    STOPPING = 8
    HELD = 9
    RETURNING = 10
    MOVING = 11


class Fault(enum.IntEnum):
    DRIVE_STATE_NOT_FINITE = 1
    DRIVE_STATE_IMPLAUSIBLE = 2
    TRACKING_ERROR = 3
    DEADLINES_MISSED = 4
    NOT_AT_REST = 6
    PEERS_SILENT = 7
    STARTS_ELSEWHERE = 8
    TOO_FAST = 9
    DOES_NOT_FOLLOW = 10
    COMMANDS_REFUSED = 11
    COMPANION_SILENT = 12
    OSCILLATES = 13
    CONTACT = 14
    STOP_LATCHED = 15
    CAMERA_TURNED_90 = 16
    DRIVE_STALE = 17
    DRIVE_LEFT = 18
    DRIVE_SILENT = 19
    DRIVE_OUT_OF_STEP = 20
    CAMERA_TURNED_180 = 21
    CAMERA_TURNED_270 = 22
    CAMERA_AXES_EXCHANGED = 23
    ENCODER_FROZEN = 24
    LENS_LONGER = 25
    LENS_SHORTER = 26
    LEAVES_WORKSPACE = 30
    TOO_FAST_IN_SPACE = 31
    ROBOT_PROTECTIVE_STOP = 32
    ROBOT_EMERGENCY_STOP = 33
    ROBOT_OFF = 34
    ROBOT_ERROR = 35
    ROBOT_HALTED = 36
    REST_UNKNOWN = 37
    STUCK_READING = 38


class Outcome(enum.IntEnum):
    CONVERGED = 1
    NOT_CONVERGED = 2
    FINISHED = 3
    STOPPED = 4
    FAULT = 5


class Refusal(enum.IntEnum):
    IN_FAULT = 1
    NO_FAULT = 2
    STILL_MOVING = 3
    ALREADY_STARTED = 4
    NOT_STARTED = 5
    TEACHING = 6
    ENDING = 7
    UNKNOWN_REQUEST = 8
    UNKNOWN_ARM = 9
    NOT_READY = 10
    UNKNOWN_CAMERA = 11
    WRONG_NUMBERS = 12
    OTHER_POINTS = 13
    OUT_OF_VIEW = 14
    OUT_OF_RANGE = 15
    OUT_OF_REACH = 16
    TOO_FAR = 17
    NO_GAIN = 18
    NO_ARM = 19
    OUT_OF_WORKSPACE = 20
    ROBOT_EMERGENCY_STOP = 21
    ROBOT_OFF = 22
    ROBOT_FAULT = 23
    UNKNOWN_TARGET = 24
    TOO_SMALL = 25
    FROM_BEHIND = 26
    EDGE_ON = 27


class RequestKind(enum.IntEnum):
    START = 1
    HOLD = 2
    TEACH = 3
    RESET = 4
    STOP = 5
    SHUTDOWN = 6
    GOAL = 7
    GOTO = 8
    JOG = 9
    SET = 10
    VELOCITY = 11


class RobotState(enum.IntEnum):
    UNKNOWN = 0
    READY = 1
    MOVING = 2
    OFF = 3
    BRAKED = 4
    ENABLING = 5
    PROTECTIVE_STOP = 6
    EMERGENCY_STOP = 7
    REDUCED = 8
    FAULT = 9
    HALTED = 10


class TargetStatus(enum.IntEnum):
    FOUND = 0
    NO_CONTRAST = 1
    TOO_FEW_REGIONS = 2
    NO_MATCH = 3
    AMBIGUOUS = 4
    WRONG_SIZE = 5
    INCONSISTENT = 6
    NO_PAIR = 7
    TOO_FEW_SHARED = 8
    GIVEN_UP = 9
    OTHER_TAGS = 10
    MIRRORED = 11


class CameraHealth(ctypes.Structure):
    """State and counters of a real camera, sent at each change and a few times a second."""

    _fields_ = [
        ("sequence", ctypes.c_uint64),  # Counts what its sender has sent, from 0: a gap is a record that was lost on the way.
        ("stamp", ctypes.c_int64),  # When the record was sent.
        ("since", ctypes.c_int64),  # Time of the last change of the state.
        ("frames", ctypes.c_uint64),  # Frames handed over.
        ("lost", ctypes.c_uint64),  # Frames lost, for whatever reason.
        ("corrupt", ctypes.c_uint64),  # Of these: damaged.
        ("superseded", ctypes.c_uint64),  # Of these: replaced by a newer frame that had arrived too.
        ("undated", ctypes.c_uint64),  # Of these: without a usable stamp.
        ("reopened", ctypes.c_uint64),  # How often the device was opened again, after it was unplugged or failed.
        ("restarted", ctypes.c_uint64),  # How often its stream was restarted.
        ("stamps_clamped", ctypes.c_uint64),  # Frames whose stamps lay in the future.
        ("rate_hz", ctypes.c_double),  # Frames per second that the device really exposes; NaN while unknown.
        ("state", ctypes.c_uint32),  # Code of a CameraState.
        ("camera", ctypes.c_uint32),  # Which camera.
        ("flags", ctypes.c_uint32),  # Bits of health_flag.
        ("reserved", ctypes.c_uint32),  # For later; zero.
    ]

    @staticmethod
    def type_name():
        return "vservo.CameraHealth.v1"


assert ctypes.sizeof(CameraHealth) == 112
assert CameraHealth.sequence.offset == 0
assert CameraHealth.stamp.offset == 8
assert CameraHealth.since.offset == 16
assert CameraHealth.frames.offset == 24
assert CameraHealth.lost.offset == 32
assert CameraHealth.corrupt.offset == 40
assert CameraHealth.superseded.offset == 48
assert CameraHealth.undated.offset == 56
assert CameraHealth.reopened.offset == 64
assert CameraHealth.restarted.offset == 72
assert CameraHealth.stamps_clamped.offset == 80
assert CameraHealth.rate_hz.offset == 88
assert CameraHealth.state.offset == 96
assert CameraHealth.camera.offset == 100
assert CameraHealth.flags.offset == 104
assert CameraHealth.reserved.offset == 108


class ControlAnswer(ctypes.Structure):
    """The answer to a request, with the state of the run."""

    _fields_ = [
        ("request", ctypes.c_uint32),  # The request that this answers.
        ("refusal", ctypes.c_uint32),  # Code of a control.lifecycle.Refusal; 0: it was accepted.
        ("state", ctypes.c_uint32),  # Code of a ControlState.
        ("fault", ctypes.c_uint32),  # Code of a control.safety.Fault; 0: none.
        ("target", ctypes.c_uint32),  # Code of the TargetStatus of the last measurement.
        ("joints", ctypes.c_uint32),  # Joints in use.
        ("flags", ctypes.c_uint32),  # Bits of answer_flag.
        ("arm", ctypes.c_uint32),  # Which arm.
        ("camera_state", ctypes.c_uint32),  # Code of a CameraState of a real camera.
        ("goal", ctypes.c_uint32),  # Number of the goal in the run: 0 is that of the run file, each new one has the next number.
        ("camera_restarts", ctypes.c_uint32),  # How often the supervisor has started a camera process anew.
        ("vision_restarts", ctypes.c_uint32),  # How often it has started vision anew.
        ("robot_state", ctypes.c_uint32),  # What the robot of an external drive is beside its joints: code of a RobotState.
        ("robot_code", ctypes.c_uint32),  # The maker's own code for that; 0 where there is none.
        ("target_number", ctypes.c_uint32),  # Number of the target of the goal, as in JointState.target_number.
        ("contact_joint", ctypes.c_uint32),  # The joint, counted from 1, that feels what touches the arm most; 0 where nothing does.
        ("tick", ctypes.c_uint64),  # Number of the control tick.
        ("motion_request", ctypes.c_uint64),  # Number of the last accepted request that decides what the arm does, all but goal and set; 0 before the first. Who finds another one than in the answer to its own request was overtaken by another client.
        ("time_s", ctypes.c_double),  # Time since the first tick, s.
        ("feature_error_px", ctypes.c_double),  # Root mean square feature error, px; NaN before the first measurement.
        ("position_error_m", ctypes.c_double),  # Distance of the camera from its desired position, m; NaN where unknown.
        ("orientation_error_rad", ctypes.c_double),  # Angle of the camera from its desired orientation, rad; NaN where unknown.
        ("camera_state_s", ctypes.c_double),  # For how long the camera has been in its state, s; NaN where unknown.
        ("at_goal_s", ctypes.c_double),  # For how long the goal has been reached and held, s; NaN where it is not, or was left again.
        ("stability", ctypes.c_double),  # The stability condition of scheme D at the goal as the run was planned, as in Status; NaN where it is not known.
        ("contact_torque", ctypes.c_double),  # The torque of that joint from outside, N m or N; NaN where nothing touches the arm, or torques are not known.
        ("contact_force", ctypes.c_double * 3),  # The force on the flange's origin in the frame of the base that explains the torques best, N; NaN likewise.
        ("q", ctypes.c_double * 7),  # Measured joint positions, rad or m.
        ("qd", ctypes.c_double * 7),  # Measured joint velocities, rad/s or m/s.
        ("goal_points", ctypes.c_uint64),  # Points of the goal.
        ("goal_ids", ctypes.c_uint32 * 64),  # Which points they are.
        ("goal_features", ctypes.c_double * 128),  # Their desired features: normalized image coordinates x, y of each.
        ("robot_text", ctypes.c_uint8 * 512),  # What the maker says of robot_state, as the drive tells it: UTF-8, with a zero byte at its end; empty where it tells nothing.
    ]

    @staticmethod
    def type_name():
        return "vservo.ControlAnswer.v11"


assert ctypes.sizeof(ControlAnswer) == 2080
assert ControlAnswer.request.offset == 0
assert ControlAnswer.refusal.offset == 4
assert ControlAnswer.state.offset == 8
assert ControlAnswer.fault.offset == 12
assert ControlAnswer.target.offset == 16
assert ControlAnswer.joints.offset == 20
assert ControlAnswer.flags.offset == 24
assert ControlAnswer.arm.offset == 28
assert ControlAnswer.camera_state.offset == 32
assert ControlAnswer.goal.offset == 36
assert ControlAnswer.camera_restarts.offset == 40
assert ControlAnswer.vision_restarts.offset == 44
assert ControlAnswer.robot_state.offset == 48
assert ControlAnswer.robot_code.offset == 52
assert ControlAnswer.target_number.offset == 56
assert ControlAnswer.contact_joint.offset == 60
assert ControlAnswer.tick.offset == 64
assert ControlAnswer.motion_request.offset == 72
assert ControlAnswer.time_s.offset == 80
assert ControlAnswer.feature_error_px.offset == 88
assert ControlAnswer.position_error_m.offset == 96
assert ControlAnswer.orientation_error_rad.offset == 104
assert ControlAnswer.camera_state_s.offset == 112
assert ControlAnswer.at_goal_s.offset == 120
assert ControlAnswer.stability.offset == 128
assert ControlAnswer.contact_torque.offset == 136
assert ControlAnswer.contact_force.offset == 144
assert ControlAnswer.q.offset == 168
assert ControlAnswer.qd.offset == 224
assert ControlAnswer.goal_points.offset == 280
assert ControlAnswer.goal_ids.offset == 288
assert ControlAnswer.goal_features.offset == 544
assert ControlAnswer.robot_text.offset == 1568


class ControlCommand(ctypes.Structure):
    """A request to control."""

    _fields_ = [
        ("request", ctypes.c_uint32),  # Code of a control.lifecycle.Request; 0 asks for the answer alone, and every other code is refused. With 0 and the form CommandForm.Features or CommandForm.Pose the answer's refusal tells whether that goal would be refused; with CommandForm.Joints whether that posture would be, and where two postures stand there, the second one after the first.
        ("arm", ctypes.c_uint32),  # Which arm: 0; a request for any other is refused.
        ("camera", ctypes.c_uint32),  # The camera that a goal is meant for: 0; a request for any other is refused.
        ("form", ctypes.c_uint32),  # What the numbers are: code of a CommandForm.
        ("count", ctypes.c_uint32),  # Entries of values in use.
        ("target", ctypes.c_uint32),  # Of goal, the target that it is of: 0: that of the present goal, else 1 more than its number; 0 with all other requests.
        ("ids", ctypes.c_uint32 * 64),  # With the form CommandForm.Features, which point each two values belong to.
        ("values", ctypes.c_double * 128),  # The numbers.
    ]

    @staticmethod
    def type_name():
        return "vservo.ControlCommand.v3"


assert ctypes.sizeof(ControlCommand) == 1304
assert ControlCommand.request.offset == 0
assert ControlCommand.arm.offset == 4
assert ControlCommand.camera.offset == 8
assert ControlCommand.form.offset == 12
assert ControlCommand.count.offset == 16
assert ControlCommand.target.offset == 20
assert ControlCommand.ids.offset == 24
assert ControlCommand.values.offset == 280


class DriveCommand(ctypes.Structure):
    """A command to an external drive."""

    _fields_ = [
        ("tick", ctypes.c_uint64),  # Number of the control tick, counted in whole milliseconds from the first.
        ("sequence", ctypes.c_uint64),  # Counts what control has sent, START included, from 0: a gap is a command that was lost on the way.
        ("stamp", ctypes.c_int64),  # Time of that tick.
        ("joints", ctypes.c_uint32),  # Joints in use.
        ("mode", ctypes.c_uint32),  # Command mode, which says what to follow: 0 tau, 1 qd_r, 2 q_r and qd_r.
        ("flags", ctypes.c_uint32),  # Bits of drive_flag.
        ("arm", ctypes.c_uint32),  # Which arm: 0.
        ("q_r", ctypes.c_double * 7),  # Reference positions, rad or m; with START the start position.
        ("qd_r", ctypes.c_double * 7),  # Reference velocities, rad/s or m/s.
        ("qdd_r", ctypes.c_double * 7),  # Reference accelerations, rad/s^2 or m/s^2: how qd_r changes in this tick.
        ("tau", ctypes.c_double * 7),  # Torques or forces, N m or N; what they contain is told by drive_flag.GRAVITY and drive_flag.FRICTION.
    ]

    @staticmethod
    def type_name():
        return "vservo.DriveCommand.v3"


assert ctypes.sizeof(DriveCommand) == 264
assert DriveCommand.tick.offset == 0
assert DriveCommand.sequence.offset == 8
assert DriveCommand.stamp.offset == 16
assert DriveCommand.joints.offset == 24
assert DriveCommand.mode.offset == 28
assert DriveCommand.flags.offset == 32
assert DriveCommand.arm.offset == 36
assert DriveCommand.q_r.offset == 40
assert DriveCommand.qd_r.offset == 96
assert DriveCommand.qdd_r.offset == 152
assert DriveCommand.tau.offset == 208


class DriveState(ctypes.Structure):
    """A state of an external drive."""

    _fields_ = [
        ("tick", ctypes.c_uint64),  # Lockstep: the tick of the command that this answers, plus one. Real time: counts the states.
        ("sequence", ctypes.c_uint64),  # Counts what the drive has sent since it joined, from 0.
        ("stamp", ctypes.c_int64),  # When it was sampled. Lockstep: the stamp of the command that this answers, plus 1 ms. Real time: CLOCK_MONOTONIC.
        ("joints", ctypes.c_uint32),  # Joints in use.
        ("modes", ctypes.c_uint32),  # The command modes that the drive supports: bit 0 torque, bit 1 velocity, bit 2 position.
        ("flags", ctypes.c_uint32),  # Bits of drive_flag.
        ("arm", ctypes.c_uint32),  # Which arm: 0.
        ("robot_state", ctypes.c_uint32),  # What the robot is beside its joints: code of a RobotState; 0 where the drive does not tell.
        ("robot_code", ctypes.c_uint32),  # The maker's own code for that; 0 where there is none.
        ("q", ctypes.c_double * 7),  # Measured positions, rad or m.
        ("qd", ctypes.c_double * 7),  # Measured velocities, rad/s or m/s.
        ("tau", ctypes.c_double * 7),  # Measured torques or forces, N m or N; zero where the drive does not measure them.
        ("q_true", ctypes.c_double * 7),  # With TRUTH, the true positions, rad or m, which a synthetic camera renders.
        ("qd_true", ctypes.c_double * 7),  # With TRUTH, the true velocities, rad/s or m/s.
    ]

    @staticmethod
    def type_name():
        return "vservo.DriveState.v3"


assert ctypes.sizeof(DriveState) == 328
assert DriveState.tick.offset == 0
assert DriveState.sequence.offset == 8
assert DriveState.stamp.offset == 16
assert DriveState.joints.offset == 24
assert DriveState.modes.offset == 28
assert DriveState.flags.offset == 32
assert DriveState.arm.offset == 36
assert DriveState.robot_state.offset == 40
assert DriveState.robot_code.offset == 44
assert DriveState.q.offset == 48
assert DriveState.qd.offset == 104
assert DriveState.tau.offset == 160
assert DriveState.q_true.offset == 216
assert DriveState.qd_true.offset == 272


class DriveText(ctypes.Structure):
    """Words of an external drive."""

    _fields_ = [
        ("sequence", ctypes.c_uint64),  # Counts what the drive has sent on this service since it joined, from 0.
        ("stamp", ctypes.c_int64),  # When it was sent, CLOCK_MONOTONIC.
        ("kind", ctypes.c_uint32),  # What the text is, one of text_kind: 1 the names of the joints, 2 the maker's words for what the robot is, 3 properties of the drive.
        ("joints", ctypes.c_uint32),  # Joints in use, with names.
        ("robot_state", ctypes.c_uint32),  # With words: the state of the robot that they are about, code of a RobotState; 0 where they are about none.
        ("robot_code", ctypes.c_uint32),  # With words: the maker's own code; 0 where there is none.
        ("signs", ctypes.c_double * 7),  # With names: how each joint counts against the joint of that name in the maker's description: 1, or -1 the other way round; 0 where the drive does not tell.
        ("zero_offsets", ctypes.c_double * 7),  # With names: where that joint stands when this one is at zero, rad or m; 0 where the drive does not tell.
        ("text", ctypes.c_uint8 * 512),  # The text, UTF-8, with a zero byte at its end. Names are separated by line feeds, in the order of the drive's joints.
    ]

    @staticmethod
    def type_name():
        return "vservo.DriveText.v1"


assert ctypes.sizeof(DriveText) == 656
assert DriveText.sequence.offset == 0
assert DriveText.stamp.offset == 8
assert DriveText.kind.offset == 16
assert DriveText.joints.offset == 20
assert DriveText.robot_state.offset == 24
assert DriveText.robot_code.offset == 28
assert DriveText.signs.offset == 32
assert DriveText.zero_offsets.offset == 88
assert DriveText.text.offset == 144


class FrameHeader(ctypes.Structure):
    """Stamps and size of an 8-bit grey frame; the user header of a u8 payload of width_px * height_px bytes."""

    _fields_ = [
        ("frame_id", ctypes.c_uint64),  # Counts the camera's exposures from 0; a gap is a frame that the camera itself lost.
        ("sequence", ctypes.c_uint64),  # The source's own number of the exposure; frame_id where it has none.
        ("exposure", ctypes.c_int64),  # Middle of the exposure.
        ("sent", ctypes.c_int64),  # When the frame was sent.
        ("exposure_span_ns", ctypes.c_uint64),  # Length of the exposure, ns.
        ("lost", ctypes.c_uint64),  # Exposures since the start that the camera itself lost.
        ("camera", ctypes.c_uint32),  # Which camera.
        ("width_px", ctypes.c_uint32),  # Columns, px.
        ("height_px", ctypes.c_uint32),  # Rows, px.
        ("flags", ctypes.c_uint32),  # Bits of frame_flag.
    ]

    @staticmethod
    def type_name():
        return "vservo.FrameHeader.v2"


assert ctypes.sizeof(FrameHeader) == 64
assert FrameHeader.frame_id.offset == 0
assert FrameHeader.sequence.offset == 8
assert FrameHeader.exposure.offset == 16
assert FrameHeader.sent.offset == 24
assert FrameHeader.exposure_span_ns.offset == 32
assert FrameHeader.lost.offset == 40
assert FrameHeader.camera.offset == 48
assert FrameHeader.width_px.offset == 52
assert FrameHeader.height_px.offset == 56
assert FrameHeader.flags.offset == 60


class ImageHeader(ctypes.Structure):
    """What an external camera says of an image; the user header of a u8 payload that holds it as format has it."""

    _fields_ = [
        ("sequence", ctypes.c_uint64),  # Counts the exposures, from any number; a gap is as many images that the program lost.
        ("stamp", ctypes.c_int64),  # Middle of the exposure, CLOCK_MONOTONIC; 0 where the program does not know it: the arrival counts.
        ("exposure_span_ns", ctypes.c_uint64),  # Length of the exposure, ns; 0 where the program does not know it: camera.exposure_ms.
        ("format", ctypes.c_uint32),  # Pixel format by its four letters, the first in the lowest byte: GREY, BGR3, RGB3, YUYV, MJPG and others.
        ("width_px", ctypes.c_uint32),  # Columns, px.
        ("height_px", ctypes.c_uint32),  # Rows, px.
        ("stride_bytes", ctypes.c_uint32),  # From one line to the next, bytes; 0 where no padding lies between them.
        ("flags", ctypes.c_uint32),  # For later; zero.
        ("reserved", ctypes.c_uint32),  # For later; zero.
    ]

    @staticmethod
    def type_name():
        return "vservo.ImageHeader.v1"


assert ctypes.sizeof(ImageHeader) == 48
assert ImageHeader.sequence.offset == 0
assert ImageHeader.stamp.offset == 8
assert ImageHeader.exposure_span_ns.offset == 16
assert ImageHeader.format.offset == 24
assert ImageHeader.width_px.offset == 28
assert ImageHeader.height_px.offset == 32
assert ImageHeader.stride_bytes.offset == 36
assert ImageHeader.flags.offset == 40
assert ImageHeader.reserved.offset == 44


class JointState(ctypes.Structure):
    """State of the joints at one tick."""

    _fields_ = [
        ("tick", ctypes.c_uint64),  # Number of the control tick.
        ("sequence", ctypes.c_uint64),  # Counts what its sender has sent, from 0: a gap is a record that was lost on the way.
        ("stamp", ctypes.c_int64),  # When the drive was read.
        ("joints", ctypes.c_uint32),  # Joints in use.
        ("flags", ctypes.c_uint32),  # Bits of joint_flag.
        ("arm", ctypes.c_uint32),  # Which arm.
        ("target_number", ctypes.c_uint32),  # Number of the target that control wants measured: 0 is target of the run file, targets.NAME follow in the order of their names.
        ("q", ctypes.c_double * 7),  # Measured positions, rad or m.
        ("qd", ctypes.c_double * 7),  # Measured velocities, rad/s or m/s.
        ("tau", ctypes.c_double * 7),  # Torques or forces applied at the previous tick, N m or N.
        ("q_r", ctypes.c_double * 7),  # Reference positions, rad or m.
        ("qd_r", ctypes.c_double * 7),  # Reference velocities, rad/s or m/s.
        ("q_true", ctypes.c_double * 7),  # True positions of a simulated arm, rad or m, which a synthetic camera renders.
        ("qd_true", ctypes.c_double * 7),  # True velocities of a simulated arm, rad/s or m/s.
    ]

    @staticmethod
    def type_name():
        return "vservo.JointState.v3"


assert ctypes.sizeof(JointState) == 432
assert JointState.tick.offset == 0
assert JointState.sequence.offset == 8
assert JointState.stamp.offset == 16
assert JointState.joints.offset == 24
assert JointState.flags.offset == 28
assert JointState.arm.offset == 32
assert JointState.target_number.offset == 36
assert JointState.q.offset == 40
assert JointState.qd.offset == 96
assert JointState.tau.offset == 152
assert JointState.q_r.offset == 208
assert JointState.qd_r.offset == 264
assert JointState.q_true.offset == 320
assert JointState.qd_true.offset == 376


class FeaturePoint(ctypes.Structure):
    """One feature point."""

    _fields_ = [
        ("id", ctypes.c_uint64),  # Which point of the target.
        ("u_px", ctypes.c_double),  # Column of the feature in the frame (distorted), px; pixel centres are integers.
        ("v_px", ctypes.c_double),  # Row of the feature in the frame, px.
        ("x", ctypes.c_double),  # X of the feature in normalized coordinates, undistorted (10.3).
        ("y", ctypes.c_double),  # Y of the feature in normalized coordinates.
        ("sd_px", ctypes.c_double),  # One standard deviation of u_px and v_px, px.
    ]

    @staticmethod
    def type_name():
        return "vservo.FeaturePoint.v2"


assert ctypes.sizeof(FeaturePoint) == 48
assert FeaturePoint.id.offset == 0
assert FeaturePoint.u_px.offset == 8
assert FeaturePoint.v_px.offset == 16
assert FeaturePoint.x.offset == 24
assert FeaturePoint.y.offset == 32
assert FeaturePoint.sd_px.offset == 40


class Measurement(ctypes.Structure):
    """Features, pose and status that vision measured in one frame."""

    _fields_ = [
        ("frame_id", ctypes.c_uint64),  # The frame it was taken from.
        ("exposure", ctypes.c_int64),  # Middle of that frame's exposure.
        ("frame_sent", ctypes.c_int64),  # When the camera sent the frame.
        ("vision_start", ctypes.c_int64),  # When vision began to process it.
        ("vision_end", ctypes.c_int64),  # When vision had processed it.
        ("frames_received", ctypes.c_uint64),  # Frames that vision has received since its start.
        ("frames_dropped", ctypes.c_uint64),  # Frames that the camera sent and vision did not process.
        ("target_lost", ctypes.c_uint64),  # How often a target that had been detected was lost.
        ("camera", ctypes.c_uint32),  # Which camera.
        ("status", ctypes.c_uint32),  # Code of a TargetStatus.
        ("flags", ctypes.c_uint32),  # Bits of frame_flag and measurement_flag.
        ("feature_count", ctypes.c_uint32),  # How many entries of features are valid; their ids rise.
        ("target_number", ctypes.c_uint32),  # Which target was looked for: its number in the run file, as in JointState.target_number.
        ("reserved", ctypes.c_uint32),  # Zero.
        ("features", FeaturePoint * 64),  # The features.
        ("pose", ctypes.c_double * 7),  # X_CO as position in m and quaternion x y z w.
        ("pose_covariance", ctypes.c_double * 36),  # Covariance of the pose, row by row: m and rad, as twist v; w of O expressed in C.
        ("reprojection_rms_px", ctypes.c_double),  # Reprojection error of the best pose, root mean square, px; also of a rejected measurement.
        ("arm_stamp", ctypes.c_int64),  # Until when vision knew where the arm was, by which it predicted the target; zero where it did not.
    ]

    @staticmethod
    def type_name():
        return "vservo.Measurement.v4"


assert ctypes.sizeof(Measurement) == 3520
assert Measurement.frame_id.offset == 0
assert Measurement.exposure.offset == 8
assert Measurement.frame_sent.offset == 16
assert Measurement.vision_start.offset == 24
assert Measurement.vision_end.offset == 32
assert Measurement.frames_received.offset == 40
assert Measurement.frames_dropped.offset == 48
assert Measurement.target_lost.offset == 56
assert Measurement.camera.offset == 64
assert Measurement.status.offset == 68
assert Measurement.flags.offset == 72
assert Measurement.feature_count.offset == 76
assert Measurement.target_number.offset == 80
assert Measurement.reserved.offset == 84
assert Measurement.features.offset == 88
assert Measurement.pose.offset == 3160
assert Measurement.pose_covariance.offset == 3216
assert Measurement.reprojection_rms_px.offset == 3504
assert Measurement.arm_stamp.offset == 3512


class Request(ctypes.Structure):
    """A request of a client and its answer."""

    _fields_ = [
        ("sequence", ctypes.c_uint64),  # Counts the requests, from 0: a gap is a record that was lost on the way.
        ("stamp", ctypes.c_int64),  # Time of the tick at whose begin it took effect, or before which it was refused.
        ("tick", ctypes.c_uint64),  # Number of that tick.
        ("number", ctypes.c_uint64),  # Counts what was asked for, in the order in which it was planned; records come in the order of the answers.
        ("planned", ctypes.c_uint64),  # Ticks of which the mission knew when it planned the request.
        ("decided", ctypes.c_uint64),  # Ticks of which the mission knew when it heard the answer of control.
        ("request", ctypes.c_uint32),  # Code of a control.lifecycle.Request.
        ("arm", ctypes.c_uint32),  # Which arm.
        ("camera", ctypes.c_uint32),  # Which camera.
        ("form", ctypes.c_uint32),  # What the numbers are: code of a CommandForm; 0: none.
        ("count", ctypes.c_uint32),  # Entries of values in use.
        ("refusal", ctypes.c_uint32),  # Code of a control.lifecycle.Refusal; 0: it was accepted.
        ("state", ctypes.c_uint32),  # Code of a ControlState: the state right after it.
        ("goal", ctypes.c_uint32),  # Number of the goal after it.
        ("target", ctypes.c_uint32),  # Of which target a goal is: as in ControlCommand.target.
        ("reserved", ctypes.c_uint32),  # Zero.
        ("ids", ctypes.c_uint32 * 64),  # With the form CommandForm.Features, which point each two values belong to.
        ("values", ctypes.c_double * 128),  # The numbers.
    ]

    @staticmethod
    def type_name():
        return "vservo.Request.v3"


assert ctypes.sizeof(Request) == 1368
assert Request.sequence.offset == 0
assert Request.stamp.offset == 8
assert Request.tick.offset == 16
assert Request.number.offset == 24
assert Request.planned.offset == 32
assert Request.decided.offset == 40
assert Request.request.offset == 48
assert Request.arm.offset == 52
assert Request.camera.offset == 56
assert Request.form.offset == 60
assert Request.count.offset == 64
assert Request.refusal.offset == 68
assert Request.state.offset == 72
assert Request.goal.offset == 76
assert Request.target.offset == 80
assert Request.reserved.offset == 84
assert Request.ids.offset == 88
assert Request.values.offset == 344


class Status(ctypes.Structure):
    """State of the run, in a flat record, so that plotting tools can show every field."""

    _fields_ = [
        ("tick", ctypes.c_uint64),  # Number of the control tick.
        ("sequence", ctypes.c_uint64),  # Counts what its sender has sent, from 0: a gap is a record that was lost on the way.
        ("stamp", ctypes.c_int64),  # Time of that tick.
        ("time_s", ctypes.c_double),  # Time since the first tick, s.
        ("feature_error_px", ctypes.c_double),  # Root mean square feature error in the image, px; NaN before the first measurement.
        ("position_error_m", ctypes.c_double),  # Distance of the camera from its desired position, m; NaN where unknown.
        ("orientation_error_rad", ctypes.c_double),  # Angle of the camera from its desired orientation, rad; NaN where unknown.
        ("exposure_to_command_us", ctypes.c_double),  # Exposure to command of the newest measurement, us; NaN before the first.
        ("exposure_to_frame_us", ctypes.c_double),  # From exposure to the sending of its frame, us; NaN where the two have different clocks (lockstep).
        ("frame_to_vision_us", ctypes.c_double),  # From the frame's sending to the start of its processing in vision, us.
        ("vision_us", ctypes.c_double),  # Time that vision needed to process it, us.
        ("measurement_to_command_us", ctypes.c_double),  # From the finished measurement to the command that used it, us; NaN in lockstep.
        ("V_C", ctypes.c_double * 6),  # The twist v; w that the law requests of a camera which no arm moves (drive.kind = 'none', replayed images), in the camera's frame, m/s and rad/s; NaN where an arm moves it, and without a view.
        ("measurements", ctypes.c_uint64),  # Measurements used.
        ("frames", ctypes.c_uint64),  # Frames that vision received.
        ("frames_dropped", ctypes.c_uint64),  # Frames that vision skipped.
        ("target_lost", ctypes.c_uint64),  # How often the target was lost.
        ("missed_deadlines", ctypes.c_uint64),  # Deadlines missed.
        ("camera_state_s", ctypes.c_double),  # For how long the camera has been in its state, s; NaN where unknown.
        ("stability", ctypes.c_double),  # Share of the gain at which the slowest error near the goal falls with what the law believes of depth, lens, mount and target, as vservo check tells it (stability); 0 or less: unstable. NaN for other laws than scheme D, and without a scene.
        ("at_goal_s", ctypes.c_double),  # For how long the goal has been reached and held, s; NaN where it is not, or was left again.
        ("contact_torque", ctypes.c_double),  # The torque from outside of the joint that feels what touches the arm most, N m or N; NaN where nothing touches it, or torques are not known.
        ("contact_force", ctypes.c_double * 3),  # The force on the flange's origin in the frame of the base that explains the torques best, N; NaN likewise.
        ("state", ctypes.c_uint32),  # Code of a ControlState: what control does.
        ("target", ctypes.c_uint32),  # Code of the TargetStatus of the last measurement.
        ("limits", ctypes.c_uint32),  # The limits that acted since the last status: bits of motion.Limit.
        ("limited_joints", ctypes.c_uint32),  # The joints on which they acted: bit 0 is the first.
        ("arm", ctypes.c_uint32),  # Which arm.
        ("flags", ctypes.c_uint32),  # Bits of status_flag.
        ("camera_state", ctypes.c_uint32),  # Code of a CameraState of a real camera.
        ("goal", ctypes.c_uint32),  # Number of the goal in the run: 0 is that of the run file, each new one has the next number.
        ("camera_restarts", ctypes.c_uint32),  # How often the supervisor has started a camera process anew.
        ("vision_restarts", ctypes.c_uint32),  # How often it has started vision anew.
        ("target_number", ctypes.c_uint32),  # Number of the target of the goal, as in JointState.target_number.
        ("contact_joint", ctypes.c_uint32),  # That joint, counted from 1; 0 where nothing touches the arm.
    ]

    @staticmethod
    def type_name():
        return "vservo.Status.v8"


assert ctypes.sizeof(Status) == 288
assert Status.tick.offset == 0
assert Status.sequence.offset == 8
assert Status.stamp.offset == 16
assert Status.time_s.offset == 24
assert Status.feature_error_px.offset == 32
assert Status.position_error_m.offset == 40
assert Status.orientation_error_rad.offset == 48
assert Status.exposure_to_command_us.offset == 56
assert Status.exposure_to_frame_us.offset == 64
assert Status.frame_to_vision_us.offset == 72
assert Status.vision_us.offset == 80
assert Status.measurement_to_command_us.offset == 88
assert Status.V_C.offset == 96
assert Status.measurements.offset == 144
assert Status.frames.offset == 152
assert Status.frames_dropped.offset == 160
assert Status.target_lost.offset == 168
assert Status.missed_deadlines.offset == 176
assert Status.camera_state_s.offset == 184
assert Status.stability.offset == 192
assert Status.at_goal_s.offset == 200
assert Status.contact_torque.offset == 208
assert Status.contact_force.offset == 216
assert Status.state.offset == 240
assert Status.target.offset == 244
assert Status.limits.offset == 248
assert Status.limited_joints.offset == 252
assert Status.arm.offset == 256
assert Status.flags.offset == 260
assert Status.camera_state.offset == 264
assert Status.goal.offset == 268
assert Status.camera_restarts.offset == 272
assert Status.vision_restarts.offset == 276
assert Status.target_number.offset == 280
assert Status.contact_joint.offset == 284


class Trace(ctypes.Structure):
    """One tick: the inputs of control, its command, and the reasons. A code of 0 means none; codes of control's enumerations count from 1 in the order of their variants."""

    _fields_ = [
        ("tick", ctypes.c_uint64),  # Number of the control tick; in real time a gap is a tick that was skipped.
        ("sequence", ctypes.c_uint64),  # Counts the ticks that were served, from 0: a gap is a record that was lost on the way.
        ("lost", ctypes.c_uint64),  # Records that control itself had to drop before this one.
        ("stamp", ctypes.c_int64),  # Time of the tick.
        ("commanded", ctypes.c_int64),  # When its command was written.
        ("frame_id", ctypes.c_uint64),  # Frame of the measurement that arrived; valid with trace_flag.MEASUREMENT, like the next five.
        ("exposure", ctypes.c_int64),  # Middle of its exposure.
        ("frame_sent", ctypes.c_int64),  # When the camera sent it.
        ("vision_start", ctypes.c_int64),  # When vision began to process it.
        ("vision_end", ctypes.c_int64),  # When vision had processed it.
        ("feature_error_px", ctypes.c_double),  # Root mean square feature error, px; NaN where the measurement has no feature error.
        ("arm", ctypes.c_uint32),  # Which arm.
        ("camera", ctypes.c_uint32),  # Which camera.
        ("joints", ctypes.c_uint32),  # Joints in use.
        ("flags", ctypes.c_uint32),  # Bits of trace_flag.
        ("state", ctypes.c_uint32),  # Code of a ControlState, from 0.
        ("verdict", ctypes.c_uint32),  # Whether the measurement was used, and if not why: code of a servo.MeasurementVerdict.
        ("fault", ctypes.c_uint32),  # Code of a control.safety.Fault; those of an external drive from 17 on, in the order of drive.DriveFault.
        ("outcome", ctypes.c_uint32),  # With the last record, how the run ended: code of a control.outcome.Outcome.
        ("events", ctypes.c_uint32),  # Events of the tick: bit n is the n-th of control.trace.Event, from 0.
        ("orders", ctypes.c_uint32),  # Orders of the mission that control has obeyed up to this tick.
        ("limits", ctypes.c_uint8 * 16),  # The joints on which each motion.Limit acted: bit 0 is the first joint. Entries beyond the limits that there are are 0.
        ("q", ctypes.c_double * 7),  # Measured positions, rad or m.
        ("qd", ctypes.c_double * 7),  # Measured velocities, rad/s or m/s.
        ("q_true", ctypes.c_double * 7),  # With trace_flag.TRUTH, the true positions of a simulated arm.
        ("qd_true", ctypes.c_double * 7),  # With trace_flag.TRUTH, its true velocities.
        ("requested_qd", ctypes.c_double * 7),  # Joint velocities that the servo law requested, before limits, rad/s or m/s.
        ("tau", ctypes.c_double * 7),  # The command of this tick: torques or forces, N m or N.
        ("q_r", ctypes.c_double * 7),  # The command of this tick: reference positions.
        ("qd_r", ctypes.c_double * 7),  # The command of this tick: reference velocities.
        ("external_torque", ctypes.c_double * 7),  # Torques or forces from outside, N m or N; NaN where the joints' torques are not known.
        ("external_torque_sd", ctypes.c_double * 7),  # Their standard deviations.
        ("measured_torque", ctypes.c_double * 7),  # Torques or forces that the drive's state carries, N m or N; NaN where it measures none.
    ]

    @staticmethod
    def type_name():
        return "vservo.Trace.v5"


assert ctypes.sizeof(Trace) == 760
assert Trace.tick.offset == 0
assert Trace.sequence.offset == 8
assert Trace.lost.offset == 16
assert Trace.stamp.offset == 24
assert Trace.commanded.offset == 32
assert Trace.frame_id.offset == 40
assert Trace.exposure.offset == 48
assert Trace.frame_sent.offset == 56
assert Trace.vision_start.offset == 64
assert Trace.vision_end.offset == 72
assert Trace.feature_error_px.offset == 80
assert Trace.arm.offset == 88
assert Trace.camera.offset == 92
assert Trace.joints.offset == 96
assert Trace.flags.offset == 100
assert Trace.state.offset == 104
assert Trace.verdict.offset == 108
assert Trace.fault.offset == 112
assert Trace.outcome.offset == 116
assert Trace.events.offset == 120
assert Trace.orders.offset == 124
assert Trace.limits.offset == 128
assert Trace.q.offset == 144
assert Trace.qd.offset == 200
assert Trace.q_true.offset == 256
assert Trace.qd_true.offset == 312
assert Trace.requested_qd.offset == 368
assert Trace.tau.offset == 424
assert Trace.q_r.offset == 480
assert Trace.qd_r.offset == 536
assert Trace.external_torque.offset == 592
assert Trace.external_torque_sd.offset == 648
assert Trace.measured_torque.offset == 704
