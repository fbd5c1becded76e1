//! The variables of RTDE that the emulator knows, by the maker's documentation. Those that it does not emulate are zero.

use super::core::{Core, REGISTERS};
use crate::rtde::{DataType, Writer};
use crate::{RobotMode, RuntimeState, SafetyMode};

/// Where the value of an output comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Source {
    Time,
    ActualQ,
    ActualQd,
    TargetQ,
    TargetQd,
    Mode,
    Safety,
    Runtime,
    RobotBits,
    SafetyBits,
    Slider,
    PayloadMass,
    PayloadCentre,
    PayloadInertia,
    OutInt(usize),
    OutDouble(usize),
    Zero(DataType),
}

/// Where the value of an input goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Sink {
    Int(usize),
    Double(usize),
    SliderMask,
    Slider,
    Nothing(DataType),
}

impl Sink {
    pub(super) fn size(self) -> usize {
        match self {
            Self::Int(_) | Self::SliderMask => DataType::Int32.size(),
            Self::Double(_) | Self::Slider => DataType::Double.size(),
            Self::Nothing(kind) => kind.size(),
        }
    }
}

/// The variables that are zero, by type.
const ZERO: [(DataType, &str); 6] = [
    (
        DataType::Vector6D,
        "target_qdd target_current target_moment actual_current actual_current_window actual_current_as_torque \
         joint_control_output actual_TCP_pose actual_TCP_speed actual_TCP_force target_TCP_pose target_TCP_speed \
         joint_temperatures actual_joint_voltage ft_raw_wrench tcp_offset actual_qdd actual_moment",
    ),
    (DataType::Vector3D, "actual_tool_accelerometer elbow_position elbow_velocity"),
    (
        DataType::Double,
        "actual_execution_time target_execution_time actual_momentum actual_main_voltage actual_robot_voltage \
         actual_robot_current standard_analog_input0 standard_analog_input1 standard_analog_output0 \
         standard_analog_output1 io_current tool_analog_input0 tool_analog_input1 tool_output_current \
         tool_temperature tcp_force_scalar",
    ),
    (DataType::Uint64, "actual_digital_input_bits actual_digital_output_bits"),
    (
        DataType::Uint32,
        "analog_io_types tool_mode tool_analog_input_types output_bit_registers0_to_31 output_bit_registers32_to_63 \
         script_control_line",
    ),
    (DataType::Vector6Int32, "joint_mode"),
];

/// The number at the end of a name.
fn register(name: &str, prefix: &str) -> Option<usize> {
    name.strip_prefix(prefix)?.parse().ok().filter(|i| *i < REGISTERS)
}

/// An output, with its type.
pub(super) fn output(name: &str) -> Option<(DataType, Source)> {
    use DataType::{Double, Int32, Uint32, Vector3D, Vector6D};
    if let Some(i) = register(name, "output_int_register_") {
        return Some((Int32, Source::OutInt(i)));
    }
    if let Some(i) = register(name, "output_double_register_") {
        return Some((Double, Source::OutDouble(i)));
    }
    Some(match name {
        "timestamp" => (Double, Source::Time),
        "actual_q" => (Vector6D, Source::ActualQ),
        "actual_qd" => (Vector6D, Source::ActualQd),
        "target_q" => (Vector6D, Source::TargetQ),
        "target_qd" => (Vector6D, Source::TargetQd),
        "robot_mode" => (Int32, Source::Mode),
        "safety_mode" | "safety_status" => (Int32, Source::Safety),
        "runtime_state" => (Uint32, Source::Runtime),
        "robot_status_bits" => (Uint32, Source::RobotBits),
        "safety_status_bits" => (Uint32, Source::SafetyBits),
        "speed_scaling" | "target_speed_fraction" => (Double, Source::Slider),
        "payload" => (Double, Source::PayloadMass),
        "payload_cog" => (Vector3D, Source::PayloadCentre),
        "payload_inertia" => (Vector6D, Source::PayloadInertia),
        other => {
            let zero = ZERO.iter().find(|(_, names)| names.split_whitespace().any(|name| name == other));
            let kind = zero.map(|(kind, _)| *kind)?;
            (kind, Source::Zero(kind))
        }
    })
}

/// An input, with its type.
pub(super) fn input(name: &str) -> Option<(DataType, Sink)> {
    use DataType::{Bool, Double, Int32, Uint8, Uint32, Vector6D};
    if let Some(i) = register(name, "input_int_register_") {
        return Some((Int32, Sink::Int(i)));
    }
    if let Some(i) = register(name, "input_double_register_") {
        return Some((Double, Sink::Double(i)));
    }
    let kind = match name {
        "speed_slider_mask" => return Some((Uint32, Sink::SliderMask)),
        "speed_slider_fraction" => return Some((Double, Sink::Slider)),
        "external_force_torque" => Vector6D,
        "standard_analog_output_0" | "standard_analog_output_1" => Double,
        "input_bit_registers0_to_31" | "input_bit_registers32_to_63" => Uint32,
        "standard_digital_output_mask"
        | "standard_digital_output"
        | "configurable_digital_output_mask"
        | "configurable_digital_output"
        | "tool_digital_output_mask"
        | "tool_digital_output"
        | "standard_analog_output_mask"
        | "standard_analog_output_type" => Uint8,
        other if other.starts_with("input_bit_register_") => Bool,
        _ => return None,
    };
    Some((kind, Sink::Nothing(kind)))
}

/// Writes an output.
pub(super) fn put(core: &Core, source: Source, writer: &mut Writer) {
    match source {
        Source::Time => writer.put(&core.faults.stale_at_s.unwrap_or(core.time_s).to_be_bytes()),
        Source::ActualQ => {
            let mut q = core.q;
            q[0] += core.faults.jump_rad;
            if core.faults.not_a_number {
                q[2] = f64::NAN;
            }
            writer.joints(&q)
        }
        Source::ActualQd => writer.joints(&core.qd),
        Source::TargetQ => writer.joints(&core.reference.q),
        Source::TargetQd => writer.joints(&core.reference.qd),
        Source::Mode => writer.put(&core.mode.number().to_be_bytes()),
        Source::Safety => writer.put(&core.safety.number().to_be_bytes()),
        Source::Runtime => writer.put(&core.runtime.number().to_be_bytes()),
        Source::RobotBits => writer.put(&robot_bits(core).to_be_bytes()),
        Source::SafetyBits => writer.put(&safety_bits(core.safety).to_be_bytes()),
        Source::Slider => writer.put(&core.slider.to_be_bytes()),
        Source::PayloadMass => writer.put(&core.payload.mass_kg.to_be_bytes()),
        Source::PayloadCentre => {
            core.payload.com_m.iter().fold(writer, |writer, m| writer.put(&m.to_be_bytes()))
        }
        Source::PayloadInertia => writer.joints(&core.payload.inertia_kg_m2.unwrap_or_default()),
        Source::OutInt(i) => writer.put(&core.out_ints[i].to_be_bytes()),
        Source::OutDouble(i) => writer.put(&core.out_doubles[i].to_be_bytes()),
        Source::Zero(kind) => writer.put([0; 48].get(..kind.size()).unwrap_or_default()),
    };
}

/// Bits of the robot's status: powered, a program runs, teach button, power button.
fn robot_bits(core: &Core) -> u32 {
    let powered = !matches!(core.mode, RobotMode::PowerOff | RobotMode::Booting);
    u32::from(powered) | u32::from(core.runtime == RuntimeState::Playing) << 1 | u32::from(powered) << 3
}

/// Bits of the safety status, by the maker's documentation.
fn safety_bits(mode: SafetyMode) -> u32 {
    const STOPPED: u32 = 1 << 10;
    match mode {
        SafetyMode::Normal => 1,
        SafetyMode::Reduced => 1 << 1,
        SafetyMode::ProtectiveStop => 1 << 2 | STOPPED,
        SafetyMode::Recovery => 1 << 3,
        SafetyMode::SafeguardStop | SafetyMode::AutomaticModeSafeguardStop => 1 << 4 | STOPPED,
        SafetyMode::SystemEmergencyStop => 1 << 5 | 1 << 7 | STOPPED,
        SafetyMode::RobotEmergencyStop => 1 << 6 | 1 << 7 | STOPPED,
        SafetyMode::Violation => 1 << 8 | STOPPED,
        _ => 1 << 9 | STOPPED,
    }
}
