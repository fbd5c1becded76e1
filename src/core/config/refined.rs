//! A run file with what `vservo calibrate from` has refined.

use super::Config;
use crate::calibration::from_run::RunRefinement;
use nalgebra::Rotation3;

impl Config {
    /// The whole run file with lens, mount, stamp offset and size of the target as `found`. What a simulated cell really is stays as it was.
    ///
    /// # Errors
    /// When it cannot be written as TOML, which no valid configuration causes.
    pub fn refined_toml(&self, found: &RunRefinement) -> Result<String, toml::ser::Error> {
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
        refined.to_toml()
    }
}
