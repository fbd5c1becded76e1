//! What is asked of an arm in space: how fast camera and flange may be, the half spaces that its parts must stay in, and how large those parts are.

use nalgebra::Vector3;

/// A half space that no checked part may leave: `n . p >= offset`, in B. A plane of a run file is one, a box six.
#[derive(Debug, Clone, PartialEq)]
pub struct HalfSpace {
    /// What the run file calls it.
    pub name: String,
    /// Unit normal in B, into the half space.
    pub normal: Vector3<f64>,
    /// Distance of the plane from B's origin along the normal, m.
    pub offset_m: f64,
}

impl HalfSpace {
    /// How far the point `p` (m, in B) is inside; negative beyond the plane.
    #[must_use]
    pub fn depth_m(&self, p: &Vector3<f64>) -> f64 {
        self.normal.dot(p) - self.offset_m
    }
}

/// Limits in space of one arm.
#[derive(Debug, Clone, PartialEq)]
pub struct WorkspaceSettings {
    /// Largest speed of the camera's centre, m/s; infinite where none is set.
    pub camera_speed_m_s: f64,
    /// Largest rate at which the camera turns, rad/s.
    pub camera_turn_rad_s: f64,
    /// Largest speed of the flange's centre, m/s.
    pub flange_speed_m_s: f64,
    /// Distance that the reference keeps from the planes, and from one part to another, m.
    pub margin_m: f64,
    /// The half spaces.
    pub sides: Vec<HalfSpace>,
    /// Radius of each link about the straight line from its joint to the next one, m; empty where links are not checked.
    pub link_radius_m: Vec<f64>,
    /// Place of the camera's centre on the flange, m, in E, and the radius about it; `None` where it does not move with the arm.
    pub camera: Option<(Vector3<f64>, f64)>,
    /// Place of the tool's tip on the flange, m, in E, and its radius; `None` for no tool.
    pub tool: Option<(Vector3<f64>, f64)>,
    /// Whether links are kept off each other.
    pub self_collision: bool,
}

/// One of the limits in space.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum SpaceLimit {
    /// The speed of the camera's centre.
    CameraSpeed,
    /// The rate at which the camera turns.
    CameraTurn,
    /// The speed of the flange's centre.
    FlangeSpeed,
    /// One part of the arm before another.
    SelfCollision,
    /// The half space of this place in [`WorkspaceSettings::sides`].
    Side(u8),
}

impl SpaceLimit {
    /// Number of limits that are none of a half space; the number of the first half space follows from it.
    const BEFORE_SIDES: usize = 4;
    /// Most half spaces, of which a box is six. Chosen by hand: four boxes; the time of a tick rises with their number.
    pub const MAX_SIDES: usize = 24;
    /// One more than the largest [`Self::number`].
    pub const COUNT: usize = Self::BEFORE_SIDES + Self::MAX_SIDES;

    /// A number for each, from 0.
    #[must_use]
    pub fn number(self) -> usize {
        match self {
            Self::CameraSpeed => 0,
            Self::CameraTurn => 1,
            Self::FlangeSpeed => 2,
            Self::SelfCollision => 3,
            Self::Side(side) => Self::BEFORE_SIDES + usize::from(side),
        }
    }

    /// Whether it keeps the arm from places, and not from being fast.
    #[must_use]
    pub fn is_of_places(self) -> bool {
        matches!(self, Self::SelfCollision | Self::Side(_))
    }
}

impl WorkspaceSettings {
    /// The largest speed of the camera's centre (m/s), its rate of turning (rad/s), and the largest speed of the flange's centre (m/s), as [`SpaceLimit`] numbers them.
    #[must_use]
    pub fn speeds(&self) -> [f64; 3] {
        [self.camera_speed_m_s, self.camera_turn_rad_s, self.flange_speed_m_s]
    }

    /// What the limit with this [`SpaceLimit::number`] is called in a run file.
    #[must_use]
    pub fn name_of(&self, number: usize) -> String {
        match number {
            0 => "workspace.camera_speed_m_s".into(),
            1 => "workspace.camera_turn_rad_s".into(),
            2 => "workspace.flange_speed_m_s".into(),
            3 => "workspace.self_collision".into(),
            _ => {
                let side = self.sides.get(number - SpaceLimit::BEFORE_SIDES);
                side.map_or_else(String::new, |side| format!("\"{}\"", side.name))
            }
        }
    }
}
