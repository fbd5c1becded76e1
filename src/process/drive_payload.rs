//! What a robot is told of what hangs on its flange: `[tool]` of the run file, or what the drive's own options say.

use super::ProcessError;
use crate::config::Config;
use crate::ipc::Instance;
use crate::robot::{Defect, Inertia};
use crate::rt::tell;
use nalgebra::{Matrix3, Vector3};

/// What is told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DrivePayload {
    /// `[tool]` of the run file, where it has a mass; otherwise nothing.
    OfRunFile,
    /// Nothing: it stays as it is set on the robot.
    AsSet,
    /// This, in the frame of the flange.
    Given(Inertia),
}

impl DrivePayload {
    /// From options: mass, kg, centre, m, and the moments about it xx, yy, zz, xy, xz, yz, kg m2, zero for a point.
    ///
    /// # Errors
    /// Where no body can be so.
    pub fn given(mass_kg: f64, com_m: [f64; 3], moments: [f64; 6]) -> Result<Self, Defect> {
        let [xx, yy, zz, xy, xz, yz] = moments;
        let about_com = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        let body = Inertia { mass: mass_kg, com: Vector3::from(com_m), about_com };
        body.check_load()?;
        Ok(Self::Given(body))
    }

    /// The body that the robot is told when the run of `instance` begins; none where it is told nothing.
    ///
    /// # Errors
    /// When the run file cannot be read.
    pub(super) fn of_run(self, program: &str, instance: &Instance) -> Result<Option<Inertia>, ProcessError> {
        let path = instance.config_path();
        let (body, whose) = match self {
            Self::AsSet => return Ok(None),
            Self::Given(body) => (body, "the options"),
            // Control that was started by hand leaves none.
            Self::OfRunFile if !path.exists() => return Ok(None),
            Self::OfRunFile => (Config::load(Some(&path), &[])?.tool, "[tool] of the run file"),
        };
        if self == Self::OfRunFile && body.mass <= 0.0 {
            return Ok(None);
        }
        let (mass, com) = (body.mass, body.com);
        tell(format_args!(
            "{program}: the robot is told {mass} kg at {}, {}, {} m on its flange, by {whose}",
            com.x, com.y, com.z
        ));
        Ok(Some(body))
    }
}

/// Moments of a body about its centre, xx, yy, zz, xy, xz, yz; none of a point.
pub(super) fn moments(body: &Inertia) -> Option<[f64; 6]> {
    let I = &body.about_com;
    let is_point = I.iter().all(|x| *x == 0.0);
    (!is_point).then(|| [I[(0, 0)], I[(1, 1)], I[(2, 2)], I[(0, 1)], I[(0, 2)], I[(1, 2)]])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bodies_that_cannot_be_are_refused_and_moments_keep_order() {
        let given = [3e-3, 2e-3, 1.5e-3, 1e-4, -2e-4, 3e-4];
        let DrivePayload::Given(body) = DrivePayload::given(1.2, [0.0, 0.01, 0.07], given).unwrap() else {
            panic!("that was given")
        };
        assert_eq!((moments(&body), body.about_com[(2, 0)]), (Some(given), -2e-4));
        assert_eq!(moments(&Inertia::point(1.0, Vector3::z())), None);
        assert!(DrivePayload::given(1.0, [0.0; 3], [1e-3, 1e-3, 5e-3, 0.0, 0.0, 0.0]).is_err());
        assert!(DrivePayload::given(-1.0, [0.0; 3], [0.0; 6]).is_err());
        assert!(DrivePayload::given(1.0, [f64::NAN, 0.0, 0.0], [0.0; 6]).is_err());
    }

    /// Without the run file of a supervisor, and without `[tool]` in it, a robot is told nothing.
    #[test]
    fn a_run_file_tells_its_tool_and_nothing_else() {
        let instance: Instance = format!("payload-{}", std::process::id()).parse().unwrap();
        let told = |choice: DrivePayload| {
            choice.of_run("test", &instance).unwrap().map(|body| (body.mass, body.com.z))
        };
        assert_eq!(told(DrivePayload::OfRunFile), None);
        instance.check_place().unwrap();
        for (set, tool) in [(None, None), (Some("tool.mass_kg=1.5"), Some((1.5, 0.06)))] {
            let set: Vec<_> =
                set.into_iter().chain(["tool.com_m=[0.0, 0.0, 0.06]"]).map(String::from).collect();
            let config = Config::load(Some("ur5".as_ref()), &set).unwrap();
            let _written = instance.write_config(&config.to_toml().unwrap()).unwrap();
            assert_eq!(told(DrivePayload::OfRunFile), tool);
            assert_eq!(told(DrivePayload::AsSet), None);
            let own = DrivePayload::given(0.4, [0.0, 0.0, 0.02], [0.0; 6]).unwrap();
            assert_eq!(told(own), Some((0.4, 0.02)), "options come first");
        }
        instance.remove_leftovers(None);
    }
}
