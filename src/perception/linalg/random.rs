//! Repeatable random numbers: SplitMix64 (Steele, Lea, Flood 2014), the same on every machine and in every order of threads.

/// A sequence of numbers from a seed. Seeds that differ in any bit give independent sequences.
#[derive(Debug, Clone)]
pub struct Random {
    state: u64,
}

impl Random {
    /// The sequence of `seed`.
    #[must_use]
    #[inline]
    pub const fn new(seed: u64) -> Self {
        Self { state: seed }
    }

    /// 64 well-mixed bits; the first ones of a sequence are a hash of its seed.
    #[inline]
    pub const fn bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Uniform in `0..1`.
    #[inline]
    pub const fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Uniform in `low..high`.
    #[inline]
    pub const fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Zero mean, standard deviation 1, by the sum of twelve uniform numbers: no function whose last bit depends on a
    /// library.
    #[inline]
    pub fn gaussian(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_those_of_the_published_generator() {
        let mut random = Random::new(1_234_567);
        let first = [6_457_827_717_110_365_317, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423];
        assert_eq!([(); 3].map(|()| random.bits()), first);
    }

    #[test]
    fn moments_are_those_of_the_distributions() {
        let mut random = Random::new(7);
        let n = 100_000;
        let (mut even, mut normal, mut squares) = (0.0, 0.0, 0.0);
        for _ in 0..n {
            let x = random.between(-2.0, 4.0);
            assert!((-2.0..4.0).contains(&x));
            even += x;
            let g = random.gaussian();
            normal += g;
            squares += g * g;
        }
        let n = f64::from(n);
        assert!((even / n - 1.0).abs() < 0.03, "{even}");
        assert!((normal / n).abs() < 0.02 && (squares / n - 1.0).abs() < 0.03, "{normal} {squares}");
    }
}
