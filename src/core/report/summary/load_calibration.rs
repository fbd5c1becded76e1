//! What `vservo calibrate load` found, for people, programs and run files.

use crate::calibration::load::{JointFrictionEstimate, LoadEstimate};
use crate::robot::{Inertia, joint_in_words};
use serde::{Deserialize, Serialize};
use std::fmt::Write;

/// What the flange carries.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LoadCalibration {
    /// Mass of all that the flange carries, what `[tool]` told included, kg.
    pub mass_kg: f64,
    /// Its standard deviation.
    pub mass_sd_kg: f64,
    /// Centre of mass in the flange's frame, m.
    pub com_m: [f64; 3],
    /// Its standard deviation along each axis.
    pub com_sd_m: [f64; 3],
    /// Moments about the centre of mass along the flange's axes: xx, yy, zz, xy, xz, yz, kg m^2. Those that are not seen are near to what `[tool]` told.
    pub inertia_kg_m2: [f64; 6],
    /// Their standard deviations.
    pub inertia_sd_kg_m2: [f64; 6],
    /// Whether a load shows at all.
    pub is_there: bool,
    /// Whether all moments of inertia are seen, so that they stand among the lines for the run file.
    pub has_inertia: bool,
    /// Mass that `[tool]` told, kg.
    pub told_kg: f64,
    /// What the motion has not shown, and what would.
    pub unseen: Vec<String>,
    /// What each joint resists with, from the base on.
    pub joints: Vec<JointFriction>,
}

/// What a joint was found to resist with, and what is left of its torques.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JointFriction {
    /// Its name in the robot file.
    #[serde(default)]
    pub name: String,
    /// Coulomb friction and its standard deviation, N m or N.
    pub coulomb_n_m_or_n: [f64; 2],
    /// Viscous friction and its standard deviation, N m s/rad or N s/m.
    pub viscous_n_m_s_rad_or_n_s_m: [f64; 2],
    /// Inertia of the rotor beyond the robot file and its standard deviation, kg m^2 or kg.
    pub rotor_kg_m2_or_kg: [f64; 2],
    /// Root mean square of the torques that nothing explains, as a share of the largest effort.
    pub residual_share: f64,
}

impl LoadCalibration {
    /// What was found of an arm that was told to carry `tool`, and whose joints have these `names`.
    #[must_use]
    pub fn new(found: &LoadEstimate, tool: &Inertia, names: &[String]) -> Self {
        let I = &found.load.about_com;
        let joint = |(i, (joint, residual_share)): (usize, (&JointFrictionEstimate, &f64))| JointFriction {
            name: names.get(i).cloned().unwrap_or_default(),
            coulomb_n_m_or_n: joint.coulomb,
            viscous_n_m_s_rad_or_n_s_m: joint.viscous,
            rotor_kg_m2_or_kg: joint.rotor,
            residual_share: *residual_share,
        };
        Self {
            mass_kg: found.load.mass,
            mass_sd_kg: found.mass_sd_kg,
            com_m: found.load.com.into(),
            com_sd_m: found.com_sd_m,
            inertia_kg_m2: [I.m11, I.m22, I.m33, I.m12, I.m13, I.m23],
            inertia_sd_kg_m2: found.inertia_sd_kg_m2,
            is_there: found.is_there,
            has_inertia: found.has_inertia,
            told_kg: tool.mass,
            unseen: found.unseen.clone(),
            joints: found.joints.iter().zip(&found.residual_shares).enumerate().map(joint).collect(),
        }
    }

    /// One line for people.
    #[must_use]
    pub fn describe(&self) -> String {
        if !self.is_there {
            return format!("no load shows: {:.3} +- {:.3} kg", self.mass_kg, self.mass_sd_kg);
        }
        let mm = |x: [f64; 3]| x.map(|x| format!("{:.1}", x * 1e3)).join(", ");
        format!(
            "the flange carries {:.3} +- {:.3} kg (told {:.3}), its centre at [{}] +- [{}] mm",
            self.mass_kg,
            self.mass_sd_kg,
            self.told_kg,
            mm(self.com_m),
            mm(self.com_sd_m)
        )
    }

    /// All that was found, for people.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = self.describe() + "\n";
        if self.is_there {
            let scaled = |x: [f64; 6]| x.map(|x| format!("{:.2}", x * 1e3)).join(", ");
            let _ = writeln!(
                text,
                "moments of inertia xx yy zz xy xz yz about it [{}] +- [{}] g m2",
                scaled(self.inertia_kg_m2),
                scaled(self.inertia_sd_kg_m2)
            );
        }
        let names: Vec<_> = self.joints.iter().map(|joint| joint.name.as_str()).collect();
        for (i, joint) in self.joints.iter().enumerate() {
            let ([c, c_sd], [v, v_sd]) = (joint.coulomb_n_m_or_n, joint.viscous_n_m_s_rad_or_n_s_m);
            let [r, r_sd] = joint.rotor_kg_m2_or_kg;
            let _ = writeln!(
                text,
                "{}: friction {c:.2} +- {c_sd:.2} N m or N and {v:.2} +- {v_sd:.2} a rad/s or m/s, inertia beyond the robot file {r:.3} +- {r_sd:.3} kg m2 or \
                 kg; {:.2} % of its effort is not explained",
                joint_in_words(&names, i),
                joint.residual_share * 1e2
            );
        }
        for words in &self.unseen {
            let _ = writeln!(text, "not seen: {words}");
        }
        text
    }

    /// The lines for a run file.
    #[must_use]
    pub fn to_toml(&self) -> String {
        if !self.is_there {
            return "[tool]\nmass_kg = 0.0\n".into();
        }
        // To a gram, a tenth of a millimetre and a mg m2, less than torques tell.
        let [x, y, z] = self.com_m.map(|x| (x * 1e4).round() * 1e-4 + 0.0);
        let mut text = format!("[tool]\nmass_kg = {:.3}\ncom_m = [{x:.4}, {y:.4}, {z:.4}]\n", self.mass_kg);
        if self.has_inertia {
            let moments =
                self.inertia_kg_m2.map(|x| format!("{:.6}", (x * 1e6).round() * 1e-6 + 0.0)).join(", ");
            let _ = writeln!(text, "inertia_kg_m2 = [{moments}]");
        }
        text
    }
}
