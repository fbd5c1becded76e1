//! What the arm was found to carry.

use super::Summary;
use crate::motion::PayloadFound;
use crate::robot::joint_in_words;
use serde::{Deserialize, Serialize};

/// A centre of mass that is less certain along an axis, m, is not told. Chosen by hand: as `vservo calibrate load` has it.
const UNSEEN_M: f64 = 0.05;

/// Share of a mass that its standard deviation may be for the mass to be told. Chosen by hand: two deviations from none.
const UNSEEN_SHARE: f64 = 0.5;

/// A payload that was estimated from the torques of the joints.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FoundPayload {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Its standard deviation, kg.
    #[serde(default)]
    pub mass_sd_kg: f64,
    /// Centre of mass in the flange's frame, m; `null` where the motion did not show it to 50 mm.
    pub com_m: Option<[f64; 3]>,
    /// Its standard deviation along each axis, m.
    #[serde(default)]
    pub com_sd_m: [f64; 3],
}

impl From<PayloadFound> for FoundPayload {
    fn from(found: PayloadFound) -> Self {
        Self {
            mass_kg: found.mass,
            mass_sd_kg: found.mass_sd,
            com_m: (found.com_sd.amax() < UNSEEN_M).then(|| found.com.into()),
            com_sd_m: found.com_sd.into(),
        }
    }
}

impl FoundPayload {
    /// For people.
    #[must_use]
    pub fn to_text(&self) -> String {
        let [x_sd, y_sd, z_sd] = self.com_sd_m.map(|sd| sd * 1e3);
        let com = match self.com_m.map(|com| com.map(|x| x * 1e3)) {
            Some([x, y, z]) => format!(
                "its centre at [{x:.0}, {y:.0}, {z:.0}] +- [{x_sd:.0}, {y_sd:.0}, {z_sd:.0}] mm of the flange"
            ),
            None => {
                format!("its centre does not show in this motion (+- [{x_sd:.0}, {y_sd:.0}, {z_sd:.0}] mm)")
            }
        };
        if self.mass_sd_kg > UNSEEN_SHARE * self.mass_kg {
            return format!(
                "more than [tool] tells, and this motion does not show of which mass (sd {:.2} kg): `vservo calibrate load` moves the joints so that it shows",
                self.mass_sd_kg
            );
        }
        format!("{:.2} +- {:.2} kg, which [tool] does not tell; {com}", self.mass_kg, self.mass_sd_kg)
    }
}

/// The rotors that were found, for people.
pub(super) fn rotors_text(summary: &Summary) -> Option<String> {
    let found = summary.rotors_kg_m2_or_kg.iter().zip(&summary.rotors_sd_kg_m2_or_kg).enumerate();
    let joint = |(i, (inertia, sd)): (usize, (&f64, &f64))| {
        format!("{} {inertia:.3} +- {sd:.3}", joint_in_words(&summary.joint_names, i))
    };
    let joints: Vec<_> = found.filter(|(_, (inertia, _))| **inertia > 0.0).map(joint).collect();
    (!joints.is_empty()).then(|| {
        format!("armature_kg_m2 (or armature_kg) that the robot file does not tell: {}", joints.join(", "))
    })
}
