//! What was learnt of disturbances, when payloads or rotors are found and the model changes.

use super::friction::FrictionShare;
use super::past::Past;
use super::{JointObserver, ObserverSettings};
use crate::motion::payload_estimator::PayloadEstimator;
use nalgebra::{SVector, Vector4};

impl<const N: usize> JointObserver<N> {
    /// Takes over another model of the arm, which stands in `q`: `payload` changes it. What was learnt of disturbances and friction before a
    /// payload was found was the payload; after that, what disturbances take together with gravity stays the same torque, now without a part that is an
    /// acceleration.
    /// The change of the payload's mass and first moment, kg and kg m.
    pub(in crate::motion) fn change_model(
        &mut self,
        q: &SVector<f64, N>,
        payload: &mut PayloadEstimator<N>,
    ) -> Vector4<f64> {
        let zero = SVector::zeros();
        let change;
        if payload.is_new() {
            change = payload.adopt();
            (self.p, self.t, self.past) = (zero, zero, Past::default());
            self.friction = FrictionShare::default();
        } else {
            let kept = [(self.p, self.t), self.past.before, self.past.last];
            let torques = kept.map(|(p, t)| payload.robot().inverse_dynamics(q, &zero, &-p) - t);
            change = payload.adopt();
            let gravity = payload.robot().gravity(q);
            let [now, before, last] = torques.map(|torque| (zero, gravity - torque));
            (self.p, self.t) = now;
            self.past = Past::of(before, last);
        }
        self.settings.inertia = ObserverSettings::free_inertia(payload.robot(), q);
        change
    }

    /// Takes over rotors with the inertia `change` more, kg m^2 or kg, of the arm that stands in `q`. Where they are the first that are found, what was learnt of
    /// disturbances since the reference began to move was they.
    pub(in crate::motion) fn change_rotors(
        &mut self,
        q: &SVector<f64, N>,
        payload: &mut PayloadEstimator<N>,
        change: &SVector<f64, N>,
        first: bool,
    ) {
        let zero = SVector::zeros();
        let now = if first { self.at_rest } else { (self.p, self.t) };
        let kept = [now, self.at_rest, self.past.before, self.past.last];
        let torques = kept.map(|(p, t)| payload.robot().inverse_dynamics(q, &zero, &-p) - t);
        payload.add_rotors(change);
        let gravity = payload.robot().gravity(q);
        let [now, at_rest, before, last] = torques.map(|torque| (zero, gravity - torque));
        (self.p, self.t) = now;
        self.at_rest = at_rest;
        self.past = Past::of(before, last);
        self.settings.inertia = ObserverSettings::free_inertia(payload.robot(), q);
    }
}
