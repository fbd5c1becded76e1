//! What the flange carries, from the torques of an arm that moves through some postures: `vservo calibrate load`.
//!
//! ```text
//! tour: postures about the start ─► control ─► Trace: q, tau ─► [`LoadRecording`] ─► smoothing: q, qd, qdd, tau by one kernel
//!       ─► equations: tau - (B qdd + C qd + g) = Y (m, h, I) + friction + rotors ─► fit: [`LoadEstimate`]
//! ```
//! The torques of a body on the flange are linear in ten numbers: its mass `m`, its first moment `h = m c` and its moments of inertia `I`, the last two
//! about the flange's origin. The columns of `Y` are the inverse dynamics of an arm whose links are massless and whose last link has one of
//! these numbers. Beside them each joint has its Coulomb and viscous friction and the inertia of its rotor, none of which need be as the
//! file says. What differs otherwise between the arm and its model, such as the masses of the links, counts as load: nothing in the torques
//! tells them apart.

mod equations;
mod estimate;
mod fit;
mod recording;
mod smoothing;
mod tour;

pub use estimate::{JointFrictionEstimate, LoadEstimate};
pub use fit::{LoadError, fit_load};
pub use recording::LoadRecording;
pub use tour::{LoadTour, LoadTourCell};
