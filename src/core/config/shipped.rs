//! The run files that come with the program: at hand by name wherever it is installed.

/// A run file that is part of the program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ShippedFile {
    /// Its name: its path below `config/`, without the ending.
    pub name: &'static str,
    /// Its text.
    pub text: &'static str,
    /// Files that it names and that lie beside it in the sources; they are not part of the program.
    pub needs: &'static [&'static str],
}

macro_rules! shipped {
    ($($name:literal $(needs $($file:literal),+)?;)*) => {
        /// All of them, by name.
        pub const SHIPPED_FILES: &[ShippedFile] = &[$(ShippedFile {
            name: $name,
            text: include_str!(concat!("../../../config/", $name, ".toml")),
            needs: &[$($($file),+)?],
        }),*];
    };
}

shipped! {
    "chessboard";
    "default";
    "dot-cube";
    "dot-grid";
    "fr3-emulated";
    "hand-held" needs "real-camera.yaml";
    "pan_tilt";
    "pan_tilt-stereo";
    "panda";
    "panda-a";
    "panda-mujoco" needs "examples/mujoco/mujoco_drive.py", "config/robot/panda.urdf";
    "real-cell" needs "real-camera.yaml";
    "scara-a";
    "scara-b";
    "scara-c";
    "scara-d";
    "scara-eye-to-hand";
    "scara-hybrid";
    "shape";
    "shape-moments";
    "stereo";
    "tag";
    "tag-cube";
    "textbook/problem-10-10";
    "textbook/scara-a";
    "textbook/scara-b";
    "textbook/scara-c";
    "textbook/scara-d";
    "textbook/scara-hybrid";
    "ur5";
    "ur5-a";
    "ur5-b";
    "ur5-c";
    "ur5-hybrid";
    "ur5-mujoco" needs "examples/mujoco/mujoco_drive.py", "config/robot/ur5.urdf";
    "ur5-path";
    "ur5-two-cameras";
    "ur5e-emulated";
    "xarm7";
}

impl ShippedFile {
    /// The file of this name.
    #[must_use]
    pub fn find(name: &str) -> Option<&'static Self> {
        SHIPPED_FILES.iter().find(|file| file.name == name)
    }

    /// What it is, in its own first sentence.
    #[must_use]
    pub fn about(&self) -> String {
        let head = self.text.lines().map_while(|line| line.strip_prefix('#')).map(str::trim);
        let head = head.collect::<Vec<_>>().join(" ");
        let end = head.match_indices(". ").map(|(at, _)| at).find(|at| !head[..*at].ends_with("Sect"));
        head.get(..end.unwrap_or(head.len())).unwrap_or(&head).trim_end_matches('.').to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use std::path::Path;

    #[test]
    fn every_run_file_is_embedded_and_valid_anywhere() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config");
        let mut names = Vec::new();
        for below in ["", "textbook/"] {
            let files = std::fs::read_dir(folder.join(below)).unwrap().map(|entry| entry.unwrap().path());
            names.extend(
                files
                    .filter(|path| path.extension().is_some_and(|e| e == "toml"))
                    .map(|path| format!("{below}{}", path.file_stem().unwrap().to_str().unwrap())),
            );
        }
        names.sort();
        assert_eq!(names, SHIPPED_FILES.iter().map(|file| file.name).collect::<Vec<_>>());
        let elsewhere = tempfile::tempdir().unwrap();
        for file in SHIPPED_FILES {
            let about = file.about();
            assert!((20..200).contains(&about.len()) && !about.contains('#'), "{}: {about}", file.name);
            let good = Config::parse(file.name, file.text, elsewhere.path(), &[]);
            assert!(good.is_ok() || !file.needs.is_empty(), "{}: {good:?}", file.name);
        }
    }
}
