//! How the tables of a run file are declared.

/// What stands in a table beside position and `rotation_rpy_rad`.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct RotationForms {
    pub(super) rpy_deg: Option<[f64; 3]>,
    pub(super) xyzw: Option<[f64; 4]>,
    pub(super) vector_rad: Option<[f64; 3]>,
    pub(super) matrix: Option<[[f64; 4]; 4]>,
}

/// A table that holds a pose; see `pose_table`.
pub(super) trait PoseTable {
    /// Takes out what is not roll, pitch, yaw in rad.
    fn take_forms(&mut self) -> RotationForms;
    /// Sets the position, m.
    fn set_position_m(&mut self, position_m: [f64; 3]);
    /// Sets roll, pitch, yaw, rad.
    fn set_rotation_rpy_rad(&mut self, rotation_rpy_rad: [f64; 3]);
}

/// Declares a table whose keys all have a default, so that a file needs to name only what it changes.
macro_rules! table {
    ($(#[$doc:meta])* $name:ident { $( $(#[$field_doc:meta])* $field:ident : $type:ty = $default:expr, )* }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields, default)]
        pub struct $name { $( $(#[$field_doc])* pub $field: $type, )* }

        impl Default for $name {
            fn default() -> Self {
                Self { $( $field: $default, )* }
            }
        }
    };
}

/// Declares a table that holds a pose: `position_m` and `rotation_rpy_rad`, which it names with their defaults, and beside them all
/// other ways to write a pose, which `pose_forms` converts to those two.
macro_rules! pose_table {
    ($(#[$doc:meta])* $name:ident { $($own:tt)* }) => {
        table! {
            $(#[$doc])*
            $name {
                $($own)*
                /// Roll, pitch, yaw, deg; instead of `rotation_rpy_rad`.
                #[serde(skip_serializing_if = "Option::is_none")]
                rotation_rpy_deg: Option<[f64; 3]> = None,
                /// Unit quaternion x, y, z, w; instead of `rotation_rpy_rad`.
                #[serde(skip_serializing_if = "Option::is_none")]
                rotation_xyzw: Option<[f64; 4]> = None,
                /// Axis times angle, rad; instead of `rotation_rpy_rad`.
                #[serde(skip_serializing_if = "Option::is_none")]
                rotation_vector_rad: Option<[f64; 3]> = None,
                /// Homogeneous transformation, row by row, m; instead of position and rotation.
                #[serde(skip_serializing_if = "Option::is_none")]
                matrix: Option<[[f64; 4]; 4]> = None,
            }
        }

        impl crate::config::keys::PoseTable for $name {
            fn take_forms(&mut self) -> crate::config::keys::RotationForms {
                crate::config::keys::RotationForms {
                    rpy_deg: self.rotation_rpy_deg.take(),
                    xyzw: self.rotation_xyzw.take(),
                    vector_rad: self.rotation_vector_rad.take(),
                    matrix: self.matrix.take(),
                }
            }

            fn set_position_m(&mut self, position_m: [f64; 3]) {
                self.position_m = position_m.into();
            }

            fn set_rotation_rpy_rad(&mut self, rotation_rpy_rad: [f64; 3]) {
                self.rotation_rpy_rad = rotation_rpy_rad.into();
            }
        }
    };
}

/// Declares a choice that is written as a word in lower case.
macro_rules! word {
    ($(#[$doc:meta])* $name:ident { $( $(#[$variant_doc:meta])* $variant:ident, )* }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum $name { $( $(#[$variant_doc])* $variant, )* }
    };
}
