//! What touched the arm.

use crate::control::safety::Contact;
use crate::robot::joint_in_words;
use serde::{Deserialize, Serialize};

/// The contact that stopped the arm last.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ContactReport {
    /// The joint that felt it most, from 0.
    pub joint: usize,
    /// Its name in the robot file, where that is known.
    #[serde(default)]
    pub joint_name: Option<String>,
    /// Its torque from outside, N m or N; `null` where the drive does not tell torques.
    pub torque_n_m_or_n: Option<f64>,
    /// The force on the flange's origin in the frame of the base that explains the torques best, N; likewise.
    pub force_n: Option<[f64; 3]>,
}

impl ContactReport {
    /// That of `contact`, of an arm whose joints have these `names`.
    #[must_use]
    pub fn new(contact: &Contact, names: &[String]) -> Self {
        Self {
            joint: contact.joint,
            joint_name: names.get(contact.joint).cloned(),
            torque_n_m_or_n: contact.torque,
            force_n: contact.force_B.map(Into::into),
        }
    }

    /// For people.
    #[must_use]
    pub fn to_text(&self) -> String {
        let called = match &self.joint_name {
            Some(name) => joint_in_words(&[name], 0),
            None => joint_in_words::<&str>(&[], self.joint),
        };
        let mut text = format!("felt by {called}");
        if let Some(torque) = self.torque_n_m_or_n {
            text += &format!(": {torque:.1} N m or N from outside");
        }
        if let Some([x, y, z]) = self.force_n {
            let force = (x * x + y * y + z * z).sqrt();
            text += &format!(
                ", a force of {force:.0} N at the flange: [{x:.0}, {y:.0}, {z:.0}] N in the base's frame"
            );
        }
        text
    }
}
