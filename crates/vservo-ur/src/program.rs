//! The program that runs on the controller: it reads registers in every cycle and moves the arm as they say.
//!
//! ```text
//! input registers, from o = 24 (or 0)            output registers
//! int o      command: 0 hold, 1 position,        int o      what the program does: 1 holds, 2 moves,
//!            2 velocity, 3 and 5 torque, 4 end              3 ended because nothing came, 4 ended when asked to
//! int o+1    counts commands                     int o+1    the count that it obeys
//! int o+2    the session                         int o+2    the session
//! double o to o+5   q, rad, qd, rad/s, or torques, N m
//! ```
//! The target of `servoj` goes from where it is to what is commanded at most as fast as a joint may: after a network that stood still the next position
//! is ahead by all that the arm was to go meanwhile, and a robot takes that leap for a collision course.
//! What registers hold from another session is not obeyed. When the count stands still for the watchdog's time, the program brakes the arm with `stopj`
//! and ends: it stops by itself when the driver, its machine, or the network fails. Under torques, which drive an arm away where nobody corrects them, that time is
//! shorter. A new start takes a new program.
//!
//! Torques are commanded by `direct_torque`, to which the controller adds the weight of arm and payload. Its friction it compensates as it is set there (3), or not at all (5).

use crate::Series;
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

impl ProgramSettings {
    /// Names of the input registers, in the order of [`Arm`](crate::Arm)'s commands.
    #[must_use]
    pub fn inputs(&self) -> Vec<String> {
        let o = self.registers;
        let ints = (o..o + 3).map(|i| format!("input_int_register_{i}"));
        ints.chain((o..o + 6).map(|i| format!("input_double_register_{i}"))).collect()
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

    /// The program.
    #[must_use]
    pub fn text(&self) -> String {
        let o = usize::from(self.registers);
        let step_s = 1.0 / self.series.rate_hz();
        let cycles = |s: f64| (s / step_s).ceil().max(1.0) as u64;
        let most = self.fastest_rad_s * step_s;
        let joints: Vec<_> = (o..o + 6).map(|i| format!("read_input_float_register({i})")).collect();
        let joints = joints.join(", ");
        let payload = self.payload_line();
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
  goal = get_target_joint_positions()
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
    if came == count:
      silent = silent + 1
    else:
      silent = 0
      count = came
    end
    write_output_integer_register({o1}, count)
    if (moving and silent > {longest}) or silent > {idle}:
      why = {missed}
      running = False
    elif (command == {position} or command == {velocity}) and moving and silent > {watchdog}:
      why = {missed}
      running = False
    elif command == {position}:
      moving = True
      write_output_integer_register({o0}, {moves})
      i = 0
      while i < 6:
        step = read_input_float_register({o0} + i) - goal[i]
        if step > {most}:
          step = {most}
        elif step < -{most}:
          step = -{most}
        end
        goal[i] = goal[i] + step
        i = i + 1
      end
      servoj(goal, 0, 0, {step_s}, {lookahead}, {gain})
    elif command == {velocity}:
      moving = True
      write_output_integer_register({o0}, {moves})
      qd = [{joints}]
      speedj(qd, {acceleration}, {step_s})
      goal = get_target_joint_positions()
{torques}    elif command == {end}:
      running = False
    else:
      if moving:
        stopj(stop_deceleration)
        moving = False
        write_output_integer_register({o0}, {holds})
      end
      sync()
      goal = get_target_joint_positions()
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
            moves = state::MOVES,
            hold = command::HOLD,
            position = command::POSITION,
            velocity = command::VELOCITY,
            end = command::END,
            o0 = o,
            o1 = o + 1,
            o2 = o + 2,
            watchdog = cycles(self.watchdog.as_secs_f64()),
            longest = cycles(self.watchdog.max(self.torque_watchdog).as_secs_f64()),
            idle = cycles(IDLE_S),
            lookahead = self.lookahead_s,
            gain = self.gain,
            acceleration = self.speed_acceleration_rad_s2,
        );
        text
    }
}
