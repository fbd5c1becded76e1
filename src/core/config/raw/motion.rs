//! `[motion]`: joint reference and joint controller.

use serde::{Deserialize, Serialize};

word! {
    /// From the joint reference to what the drive obeys.
    JointControl {
        /// Torques by inverse dynamics.
        InverseDynamics,
        /// Torques by inverse dynamics in operational space: of the flange's pose.
        OperationalSpace,
        /// Torques by PD with gravity compensation.
        PdGravity,
        /// The reference itself, for drives that close their own loop.
        PassThrough,
    }
}

table! {
    /// Joint reference and joint controller.
    RawMotion {
        /// Joint controller.
        controller: JointControl = JointControl::InverseDynamics,
        /// Largest acceleration of each joint, rad/s^2 or m/s^2; one value stands for all.
        max_acceleration_rad_s2_or_m_s2: Vec<f64> = vec![10.0],
        /// Largest jerk of each joint, rad/s^3 or m/s^3; one value stands for all.
        max_jerk_rad_s3_or_m_s3: Vec<f64> = vec![500.0],
        /// Time in which the torque or force of a joint may rise from zero to its largest, ms.
        effort_rise_ms: f64 = 10.0,
        /// Natural frequency of the joint controller, rad/s.
        natural_frequency_rad_s: f64 = 40.0,
        /// Damping ratio of the joint controller.
        damping_ratio: f64 = 1.0,
        /// Of `pd_gravity`: stiffness of each joint, N m/rad or N/m; one value stands for all. Left out: from natural
        /// frequency and the mass matrix at the start.
        stiffness_n_m_rad_or_n_m: Vec<f64> = Vec::new(),
        /// Of `pd_gravity`: damping of each joint, N m s/rad or N s/m; likewise.
        damping_n_m_s_rad_or_n_s_m: Vec<f64> = Vec::new(),
        /// Of torques: bandwidth of the observer of disturbances (load, friction, masses) that the model does not contain, rad/s; 0: none.
        disturbance_rad_s: f64 = 10.0,
        /// Of torques: bandwidth of the observer that estimates velocities from positions, rad/s; 0: the velocities that the drive
        /// reports are used. Left out: 400 where the simulated encoders have steps, 50 where they have more noise, else 0.
        velocity_observer_rad_s: Option<f64> = None,
        /// Step of each encoder and twice its noise, within which a position is not significant, rad or m; one value stands for
        /// all. Left out: that of the simulated drive, else what readings show.
        encoder_step_rad_or_m: Vec<f64> = Vec::new(),
    }
}
