//! A run file with what `vservo calibrate from` has refined.

use super::Config;
use super::raw::RawTool;
use crate::calibration::from_run::RunRefinement;
use crate::calibration::load::LoadEstimate;
use nalgebra::Rotation3;

/// A rest of the simulated payload below which there is none, kg. Chosen by hand: below what torques tell of a mass.
const LIGHTEST_KG: f64 = 0.01;
/// Farthest centre of mass of such a rest, m. Chosen by hand: a small difference of two moments may be anywhere.
const FARTHEST_M: f64 = 0.3;

impl Config {
    /// The whole run file with lens, mount, stamp offset and size of the target as `found`, and with the `load` that shows. What a simulated cell really is stays as it was.
    ///
    /// # Errors
    /// When it cannot be written as TOML, which no valid configuration causes.
    pub fn refined_toml(
        &self,
        found: &RunRefinement,
        load: Option<&LoadEstimate>,
    ) -> Result<String, toml::ser::Error> {
        let mut refined = self.clone();
        let raw = &mut refined.effective;
        let old = self.camera.model.full_intrinsics();
        let (position, rpy) = (raw.camera.mount.position_m, raw.camera.mount.rotation_rpy_rad);
        if self.scene.is_some() {
            let truth = &mut raw.scene.camera;
            truth.lens.fx_px.get_or_insert(old.fx_px);
            truth.lens.fy_px.get_or_insert(old.fy_px);
            truth.lens.cx_px.get_or_insert(old.cx_px);
            truth.lens.cy_px.get_or_insert(old.cy_px);
            truth.lens.k1.get_or_insert(raw.camera.lens.k1);
            truth.mount.position_m.get_or_insert(position);
            truth.mount.rotation_rpy_rad.get_or_insert(rpy);
            raw.scene.target.scale = Some(raw.scene.target.scale.unwrap_or(1.0) / found.size);
        }
        let new = found.camera.full_intrinsics();
        let k1 = |camera: &crate::camera_model::CameraModel| {
            camera.lens().coefficients().iter().find(|(name, _)| *name == "k1").map_or(0.0, |(_, k1)| *k1)
        };
        let lens = &mut raw.camera.lens;
        (lens.fx_px, lens.fy_px) = (new.fx_px, new.fy_px);
        (lens.cx_px, lens.cy_px) = (Some(new.cx_px), Some(new.cy_px));
        lens.k1 = k1(&found.camera);
        let X = *found.mount.pose();
        let (roll, pitch, yaw) = Rotation3::from(X.rotation).euler_angles();
        raw.camera.mount.position_m = X.translation.vector.into();
        raw.camera.mount.rotation_rpy_rad = [roll, pitch, yaw];
        raw.camera.stamp_offset_ms += found.stamp_change_s * 1e3;
        raw.target = raw.target.scaled(found.size);
        if let Some(load) = load.filter(|load| load.is_there) {
            refined.carry(load);
        }
        refined.to_toml()
    }

    /// Tells the load that was found. A simulated arm carries what is told and its payload: the whole stays as it was.
    fn carry(&mut self, load: &LoadEstimate) {
        let raw = &mut self.effective;
        let told = raw.tool.clone();
        let rounded = |x: f64| (x * 1e4).round() * 1e-4 + 0.0; // a tenth of a gram or millimetre: less than torques tell
        let (body, I) = (&load.load, &load.load.about_com);
        let moments = [I.m11, I.m22, I.m33, I.m12, I.m13, I.m23];
        let inertia_kg_m2 = if load.has_inertia { moments } else { told.inertia_kg_m2 };
        let com_m = [body.com.x, body.com.y, body.com.z].map(rounded);
        raw.tool = RawTool { mass_kg: rounded(body.mass), com_m, inertia_kg_m2 };
        let simulated = &mut raw.drive.simulated;
        let rest_kg = simulated.payload_kg + told.mass_kg - raw.tool.mass_kg;
        if !(rest_kg > LIGHTEST_KG) {
            // an estimate above the truth leaves nothing
            simulated.payload_kg = 0.0;
            return;
        }
        let moment = |k: usize| {
            simulated.payload_kg * simulated.payload_com_m[k] + told.mass_kg * told.com_m[k]
                - raw.tool.mass_kg * raw.tool.com_m[k]
        };
        let com_m = std::array::from_fn(|k| (moment(k) / rest_kg).clamp(-FARTHEST_M, FARTHEST_M));
        (simulated.payload_kg, simulated.payload_com_m) = (rest_kg, com_m);
    }
}
