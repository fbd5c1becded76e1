//! What touched the arm.

use crate::control::safety::Contact;
use serde::{Deserialize, Serialize};

/// The contact that stopped the arm last.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ContactReport {
    /// The joint that felt it most, from 0.
    pub joint: usize,
    /// Its torque from outside, N m or N; `null` where the drive does not tell torques.
    pub torque_n_m_or_n: Option<f64>,
    /// The force on the flange's origin in the frame of the base that explains the torques best, N; likewise.
    pub force_n: Option<[f64; 3]>,
}

impl From<Contact> for ContactReport {
    fn from(contact: Contact) -> Self {
        Self {
            joint: contact.joint,
            torque_n_m_or_n: contact.torque,
            force_n: contact.force_B.map(Into::into),
        }
    }
}

impl ContactReport {
    /// For people.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = format!("felt by joint {}, counted from 0", self.joint);
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
