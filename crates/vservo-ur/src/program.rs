//! The program that runs on the controller: it reads registers in every cycle and moves the arm as they say.
//!
//! ```text
//! input registers, from o = 24 (or 0)            output registers
//! int o      command: 0 hold, 1 position,        int o      what the program does: 1 holds, 2 moves,
//!            2 velocity, 3 and 5 torque, 4 end              3 ended because nothing came, 4 ended when asked to
//! int o+1    counts commands                     int o+1    the count that it obeys
//! int o+2    the session                         int o+2    the session
//! int o+3    the robot's cycle that the numbers below are of
//! double o to o+5   q, rad, or torques, N m; o+6 to o+11   qd, rad/s; o+12 to o+17   qdd, rad/s2
//! ```
//! The program counts its cycles, and so knows by how many a command is later than the quickest that it has seen. It carries positions and velocities on for so long by
//! their velocity and acceleration, and what brakes no farther than to rest. Nothing is carried on for longer than `CARRIED_S`, and when nothing new has come for so long the joints brake: commands that come are obeyed however slow the network is. In all this their velocity changes from cycle
//! to cycle by no more than the acceleration that is allowed: `servoj` and `speedj` get nothing else. A target that the joints are not at (the network stood still)
//! is approached with `v = qd + sign(e) min(|e|/T, sqrt(a |e|))`, from which half of the acceleration `a` brakes, and no joint is faster than it may be: a robot takes a leap for a
//! collision course.
//! What registers hold from another session is not obeyed. When the count stands still for the watchdog's time, the program brakes the arm with `stopj`
//! and ends: it stops by itself when the driver, its machine, or the network fails. Under torques, which drive an arm away where nobody corrects them, that time is
//! shorter. A new start takes a new program.
//!
//! Torques are commanded by `direct_torque`, to which the controller adds the weight of arm and payload. Its friction it compensates as it is set there (3), or not at all (5).

use crate::{Joints, Series};
use std::fmt::Write;
use std::time::Duration;

/// The port that takes programs (secondary interface), by the maker's documentation.
pub const PORT: u16 = 30_002;

/// Values of the first input register. The numbers here are the protocol between [`ProgramSettings::text`] and [`Arm`](crate::Arm).
pub mod command {
    /// The arm is braked, or held where it stands.
    pub const HOLD: i32 = 0;
    /// `servoj` to the positions.
    pub const POSITION: i32 = 1;
    /// `speedj` with the velocities.
    pub const VELOCITY: i32 = 2;
    /// `direct_torque` with the torques, and with the controller's own compensation of friction.
    pub const TORQUE: i32 = 3;
    /// `direct_torque` with the torques, which compensate the friction themselves.
    pub const TORQUE_WITH_FRICTION: i32 = 5;
    /// Brakes the arm, and ends the program.
    pub const END: i32 = 4;
}

/// Values of the first output register. The numbers here are the protocol between the program and [`Arm`](crate::Arm).
pub mod state {
    /// Holds the arm.
    pub const HOLDS: i32 = 1;
    /// Moves it.
    pub const MOVES: i32 = 2;
    /// Has stopped it because no command came.
    pub const MISSED: i32 = 3;
    /// Has stopped it because it was asked to.
    pub const ENDED: i32 = 4;
}

/// What hangs on the flange.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Payload {
    /// kg.
    pub mass_kg: f64,
    /// Centre of mass in the frame of the tool flange, m.
    pub com_m: [f64; 3],
    /// Inertia about it, along the axes of the flange, xx, yy, zz, xy, xz, yz, kg m2; none where that is not known.
    pub inertia_kg_m2: Option<[f64; 6]>,
}

/// How the program moves the arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProgramSettings {
    /// The first register: 24, or 0 where another program has these.
    pub registers: u8,
    /// The controller's series, which tells its cycle.
    pub series: Series,
    /// Tells this program's commands from older ones.
    pub session: i32,
    /// `lookahead_time` of `servoj`, s: 0.03 to 0.2 by the maker's documentation.
    pub lookahead_s: f64,
    /// `gain` of `servoj`: 100 to 2000 by the maker's documentation.
    pub gain: f64,
    /// Fastest that the target of `servoj` moves, rad/s.
    pub fastest_rad_s: f64,
    /// Largest acceleration of each joint with which late commands are made up for, rad/s2.
    pub acceleration_rad_s2: Joints,
    /// Acceleration of `speedj`, rad/s2.
    pub speed_acceleration_rad_s2: f64,
    /// Deceleration of `stopj`, rad/s2.
    pub stop_deceleration_rad_s2: f64,
    /// How long the program goes on without a new command while the arm moves.
    pub watchdog: Duration,
    /// The same under torques, which drive an arm away where nobody corrects them.
    pub torque_watchdog: Duration,
    /// What the controller is told to carry before the arm moves; none: as it is set there.
    pub payload: Option<Payload>,
    /// Whether the controller takes the inertia of a payload.
    pub takes_inertia: bool,
    /// How the controller takes torques; none where its software does not.
    pub torques: Option<TorqueInterface>,
}

/// What `direct_torque` is told of friction, which differs between versions of the software.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TorqueInterface {
    /// Whether it is compensated.
    FrictionSwitch,
    /// Which share of it is compensated, of each joint.
    FrictionScales,
}

/// How long a program that holds the arm waits for a command, s. Chosen by hand: a driver sends one in every cycle, also while it holds, but a loaded
/// machine may take its time between the start of the program and the first.
const IDLE_S: f64 = 2.0;

/// How long late commands are carried on by their acceleration, s. Chosen by hand: as long as a Franka robot does by its maker's documentation, twenty cycles of 1 kHz;
/// what a reference with a jerk of 500 rad/s3 is off by after that is 0.7 mrad.
const CARRIED_S: f64 = 0.02;
/// What the change of a joint's velocity may be beyond the acceleration that is told. Chosen by hand: commands that keep their limit are never cut for the rounding of clocks.
const SLACK: f64 = 1.05;
/// Factor from the `gain` of `servoj` to a rate, 1/s. Chosen so that the quickest parameters lag by 34 ms, as users measure.
pub(crate) const RATE_OF_GAIN: f64 = 1.0 / 8.0;
/// Later than every command: before the first none is the quickest.
const NEVER: i32 = 1_000_000_000;

/// Numbers of a list.
fn list(values: impl Iterator<Item = f64>) -> String {
    values.map(|value| value.to_string()).collect::<Vec<_>>().join(", ")
}

impl ProgramSettings {
    /// Names of the input registers, in the order of [`Arm`](crate::Arm)'s commands.
    #[must_use]
    pub fn inputs(&self) -> Vec<String> {
        let o = self.registers;
        let ints = (o..o + 4).map(|i| format!("input_int_register_{i}"));
        ints.chain((o..o + 18).map(|i| format!("input_double_register_{i}"))).collect()
    }

    /// Name of the output register `i`, 0 to 2.
    #[must_use]
    pub fn output(&self, i: u8) -> String {
        format!("output_int_register_{}", self.registers + i)
    }

    /// The line of the program that tells the payload. Without its inertia the controller makes its own of mass and centre.
    fn payload_line(&self) -> String {
        let Some(Payload { mass_kg, com_m, inertia_kg_m2 }) = self.payload else { return String::new() };
        match inertia_kg_m2.filter(|_| self.takes_inertia) {
            Some(inertia) => format!("  set_target_payload({mass_kg}, {com_m:?}, {inertia:?}, 0)\n"),
            None => format!("  set_payload({mass_kg}, {com_m:?})\n"),
        }
    }

    /// The branches of the program that command torques. A controller refuses whole programs with a function that it does not know.
    fn torque_branches(&self, joints: &str, cycles: u64) -> String {
        let Some(interface) = self.torques else { return String::new() };
        let none = match interface {
            TorqueInterface::FrictionSwitch => "friction_comp=False",
            TorqueInterface::FrictionScales => {
                "viscous_scale=[0, 0, 0, 0, 0, 0], coulomb_scale=[0, 0, 0, 0, 0, 0]"
            }
        };
        let (with, without, missed) = (command::TORQUE_WITH_FRICTION, command::TORQUE, state::MISSED);
        let (o0, moves) = (self.registers, state::MOVES);
        format!(
            "\
    elif command == {without} or command == {with}:
      moving = True
      write_output_integer_register({o0}, {moves})
      if silent > {cycles}:
        why = {missed}
        running = False
      else:
        tau = [{joints}]
        if command == {without}:
          direct_torque(tau)
        else:
          direct_torque(tau, {none})
        end
        goal = get_target_joint_positions()
      end
"
        )
    }

    /// By how much `servoj` is behind its target, s. The maker publishes no equation: users measure 34 ms with its quickest parameters.
    #[must_use]
    pub fn servoj_lag_s(&self) -> f64 {
        self.lookahead_s + 1.0 / (self.gain * RATE_OF_GAIN)
    }

    /// The branches of the program that command positions and velocities.
    fn motion_branches(&self, step_s: f64) -> String {
        let (o, moves) = (self.registers, state::MOVES);
        let (velocities, accelerations) = (o + 6, o + 12);
        let (position, velocity) = (command::POSITION, command::VELOCITY);
        let (lookahead, gain, fastest) = (self.lookahead_s, self.gain, self.fastest_rad_s);
        let acceleration = self.speed_acceleration_rad_s2;
        let limited = "\
        if want - speed[i] > change[i]:
          want = speed[i] + change[i]
        elif speed[i] - want > change[i]:
          want = speed[i] - change[i]
        end
        speed[i] = want
";
        format!(
            "\
    elif command == {position}:
      moving = True
      write_output_integer_register({o}, {moves})
      i = 0
      while i < 6:
        want = 0
        if late <= carried:
          v = read_input_float_register({velocities} + i)
          a = read_input_float_register({accelerations} + i)
          t = late * {step_s}
          if v * (v + t * a) < 0:
            t = -v / a
          end
          ahead = read_input_float_register({o} + i) + t * (v + 0.5 * t * a) - goal[i]
          want = ahead / {step_s}
          if want - speed[i] > change[i] or speed[i] - want > change[i]:
            v = v + t * a
            apart = ahead - v * {step_s}
            sign = 1
            if apart < 0:
              sign = -1
            end
            near = sign * apart / {step_s}
            far = sqrt(acceleration[i] * sign * apart)
            if far < near:
              near = far
            end
            want = v + sign * near
          end
          if want > {fastest}:
            want = {fastest}
          elif want < -{fastest}:
            want = -{fastest}
          end
        end
{limited}        goal[i] = goal[i] + want * {step_s}
        i = i + 1
      end
      servoj(goal, 0, 0, {step_s}, {lookahead}, {gain})
    elif command == {velocity}:
      moving = True
      write_output_integer_register({o}, {moves})
      i = 0
      while i < 6:
        want = 0
        if late <= carried:
          v = read_input_float_register({velocities} + i)
          want = v + late * {step_s} * read_input_float_register({accelerations} + i)
          if v * want < 0:
            want = 0
          end
        end
{limited}        i = i + 1
      end
      speedj(speed, {acceleration}, {step_s})
      goal = get_target_joint_positions()
"
        )
    }

    /// The program.
    #[must_use]
    pub fn text(&self) -> String {
        let o = usize::from(self.registers);
        let step_s = 1.0 / self.series.rate_hz();
        let cycles = |s: f64| (s / step_s).ceil().max(1.0) as u64;
        let joints: Vec<_> = (o..o + 6).map(|i| format!("read_input_float_register({i})")).collect();
        let joints = joints.join(", ");
        let payload = self.payload_line();
        let motions = self.motion_branches(step_s);
        let torques = self.torque_branches(&joints, cycles(self.torque_watchdog.as_secs_f64()));
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = write!(
            text,
            "\
def vservo_drive():
  session = {session}
  stop_deceleration = {stop}
  count = -1
  silent = 0
  moving = False
  cycle = 0
  lead = {NEVER}
  carried = {carried}
  goal = get_target_joint_positions()
  speed = [0, 0, 0, 0, 0, 0]
  acceleration = [{accelerations}]
  change = [{changes}]
  running = True
  why = {ended}
{payload}  write_output_integer_register({o1}, count)
  write_output_integer_register({o0}, {holds})
  write_output_integer_register({o2}, session)
  while running:
    command = {hold}
    came = count
    if read_input_integer_register({o2}) == session:
      command = read_input_integer_register({o0})
      came = read_input_integer_register({o1})
    end
    cycle = cycle + 1
    behind = cycle - read_input_integer_register({o3})
    if came == count:
      silent = silent + 1
    else:
      silent = 0
      count = came
      if behind < lead:
        lead = behind
      end
    end
    late = behind - lead
    if late > carried and silent <= carried:
      late = carried
    end
    write_output_integer_register({o1}, count)
    if (moving and silent > {longest}) or silent > {idle}:
      why = {missed}
      running = False
    elif (command == {position} or command == {velocity}) and moving and silent > {watchdog}:
      why = {missed}
      running = False
{motions}{torques}    elif command == {end}:
      running = False
    else:
      if moving:
        stopj(stop_deceleration)
        moving = False
        write_output_integer_register({o0}, {holds})
      end
      sync()
      goal = get_target_joint_positions()
      speed = [0, 0, 0, 0, 0, 0]
    end
  end
  stopj(stop_deceleration)
  write_output_integer_register({o0}, why)
  sync()
end
",
            session = self.session,
            stop = self.stop_deceleration_rad_s2,
            ended = state::ENDED,
            missed = state::MISSED,
            holds = state::HOLDS,
            hold = command::HOLD,
            position = command::POSITION,
            velocity = command::VELOCITY,
            end = command::END,
            o0 = o,
            o1 = o + 1,
            o2 = o + 2,
            o3 = o + 3,
            carried = cycles(CARRIED_S),
            accelerations = list(self.acceleration_rad_s2.iter().copied()),
            changes = list(self.acceleration_rad_s2.iter().map(|a| SLACK * a * step_s)),
            watchdog = cycles(self.watchdog.as_secs_f64()),
            longest = cycles(self.watchdog.max(self.torque_watchdog).as_secs_f64()),
            idle = cycles(IDLE_S),
        );
        text
    }
}
