//! Which pose belongs to which image: by the names in a table, or by the order of files with one pose each.

use crate::calibration::hand_eye::{ArmPose, read_poses, read_visp_pose};
use crate::input::{file, printable};
use std::path::{Path, PathBuf};

/// Longest file of poses, bytes. Chosen by hand: 20 000 poses of 200 bytes.
const LARGEST: u64 = 4 << 20;

/// The pose of each image, or what is wrong.
pub(super) fn of_images(images: &[PathBuf], files: &[PathBuf]) -> Result<Vec<ArmPose>, String> {
    let is_yaml = |path: &PathBuf| {
        path.extension().is_some_and(|e| e.eq_ignore_ascii_case("yaml") || e.eq_ignore_ascii_case("yml"))
    };
    match files {
        [table] if !is_yaml(table) => by_name(images, table),
        files if files.iter().all(is_yaml) => by_order(images, files),
        _ => Err("--poses: give one table (CSV), or files of one pose each (.yaml) alone".into()),
    }
}

fn text(path: &Path) -> Result<String, String> {
    file::read(path, LARGEST).map_err(|e| format!("--poses: {}: {e}", path.display()))
}

/// A table names images as they were given, or by the last part of their paths.
fn by_name(images: &[PathBuf], table: &Path) -> Result<Vec<ArmPose>, String> {
    let poses = read_poses(&text(table)?).map_err(|e| format!("--poses: {}: {e}", table.display()))?;
    let last = |name: &str| Path::new(name).file_name().map(|n| n.to_string_lossy().into_owned());
    images
        .iter()
        .map(|image| {
            let name = image.display().to_string();
            let same = poses.iter().find(|pose| pose.image == name);
            let mut alike = poses.iter().filter(|pose| last(&pose.image) == last(&name));
            match (same, alike.next(), alike.next()) {
                (Some(pose), ..) | (None, Some(pose), None) => Ok(pose.clone()),
                (None, Some(_), Some(_)) => Err(format!(
                    "--poses: {} names several images that end in {}: write the paths as they are given to this command",
                    table.display(),
                    printable(&last(&name).unwrap_or_default())
                )),
                (None, None, _) => Err(format!("--poses: {} has no line for {name}", table.display())),
            }
        })
        .collect()
}

fn by_order(images: &[PathBuf], files: &[PathBuf]) -> Result<Vec<ArmPose>, String> {
    if files.len() != images.len() {
        return Err(format!(
            "--poses: {} files for {} images: each image needs one, in the same order",
            files.len(),
            images.len()
        ));
    }
    files
        .iter()
        .zip(images)
        .map(|(path, image)| {
            let pose = read_visp_pose(&text(path)?);
            let X_BE = pose.map_err(|e| format!("--poses: {}: {e}", path.display()))?;
            Ok(ArmPose { image: image.display().to_string(), X_BE, V_BE_E: None })
        })
        .collect()
}
