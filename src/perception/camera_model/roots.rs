//! Where a polynomial that begins positive stops being so.

/// Farthest place that is looked at, the square of a radius or of an angle: tan(89.9 degrees)^2 is 3e5, so that all that a lens sees is nearer.
const FAR: f64 = 1e6;

/// The first `t` in 0..1e6 at which `c[0] + c[1] t + c[2] t^2 + ...` is not greater than 0, if there is one. Between its own turning
/// points, which are found in the same way, a polynomial goes one way: there it is bisected.
pub(super) fn first_not_positive(c: &[f64]) -> Option<f64> {
    if value(c, 0.0) <= 0.0 {
        return Some(0.0);
    }
    let mut low = 0.0;
    for high in sign_changes(&derivative(c)).into_iter().chain([FAR]) {
        if value(c, high) <= 0.0 {
            return Some(bisect(c, low, high));
        }
        low = high;
    }
    None
}

/// All places in 0..1e6 where the polynomial changes its sign, in order.
fn sign_changes(c: &[f64]) -> Vec<f64> {
    if c.len() < 2 {
        return Vec::new();
    }
    let mut found = Vec::new();
    let mut low = 0.0;
    for high in sign_changes(&derivative(c)).into_iter().chain([FAR]) {
        if (value(c, low) > 0.0) != (value(c, high) > 0.0) {
            found.push(bisect(c, low, high));
        }
        low = high;
    }
    found
}

fn value(c: &[f64], t: f64) -> f64 {
    c.iter().rev().fold(0.0, |sum, c| sum * t + c)
}

fn derivative(c: &[f64]) -> Vec<f64> {
    (1..).zip(c.iter().skip(1)).map(|(power, c)| f64::from(power) * c).collect()
}

/// The place between `low` and `high`, on the side of `low`, where the sign changes.
fn bisect(c: &[f64], mut low: f64, mut high: f64) -> f64 {
    let positive = value(c, low) > 0.0;
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if (value(c, middle) > 0.0) == positive { low = middle } else { high = middle }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn known_roots() {
        assert_eq!(first_not_positive(&[1.0, 0.5]), None);
        let first = first_not_positive(&[1.0, -2.7]).unwrap();
        assert!((first - 1.0 / 2.7).abs() < 1e-12);
        // (t - 1)(t - 2)(t - 3) (-1/6): positive before 1
        let first = first_not_positive(&[1.0, -11.0 / 6.0, 1.0, -1.0 / 6.0]).unwrap();
        assert!((first - 1.0).abs() < 1e-9);
        assert_eq!(first_not_positive(&[]), Some(0.0));
    }

    proptest! {
        #[test]
        fn nothing_before_the_first(c in prop::collection::vec(-3.0..3.0f64, 1..7), part in 0.0..1.0f64) {
            let mut c = c;
            c[0] = c[0].abs() + 0.01;
            let first = first_not_positive(&c);
            let t = part * first.unwrap_or(100.0) * (1.0 - 1e-9);
            prop_assert!(value(&c, t) > -1e-9, "{c:?} {first:?} {t}");
            if let Some(first) = first {
                prop_assert!(value(&c, first * (1.0 + 1e-6) + 1e-9) < 1e-3);
            }
        }
    }
}
