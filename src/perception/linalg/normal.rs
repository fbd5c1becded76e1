//! The normal distribution.

/// The normal distribution function at `z`, to 1e-7 (Abramowitz and Stegun 26.2.17), and its density there.
pub fn normal(z: f64) -> (f64, f64) {
    let density = (-0.5 * z * z).exp() * 0.398_942_280_401_432_7;
    let t = 1.0 / (1.0 + 0.231_641_9 * z.abs());
    let poly = t
        * (0.319_381_530
            + t * (-0.356_563_782 + t * (1.781_477_937 + t * (-1.821_255_978 + t * 1.330_274_429))));
    let tail = density * poly;
    (if z > 0.0 { 1.0 - tail } else { tail }, density)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_normal_distribution() {
        for (z, wanted) in [(0.0, 0.5), (1.0, 0.841_344_746), (-2.0, 0.022_750_132), (3.5, 0.999_767_371)] {
            assert!((normal(z).0 - wanted).abs() < 1e-7);
            assert!((normal(z).1 - (normal(z + 5e-4).0 - normal(z - 5e-4).0) / 1e-3).abs() < 5e-4);
        }
    }
}
