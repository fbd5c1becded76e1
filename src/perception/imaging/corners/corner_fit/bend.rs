//! What edges that a lens bends do to a fit with straight ones.

use super::{CornerFitter, Vector};
use crate::imaging::corners::corner_model::parameter::{COUNT, TURN_U, TURN_V, X, Y};
use crate::linalg::Eight;

impl CornerFitter {
    /// `J' (d a^2)` of both edges, from the rows of the last step: a shift of the corner by (x, y) shifts the edges by `n_u (x, y)` and
    /// `n_v (x, y)`, which gives the derivatives by a shift of either.
    pub(super) fn drawn_by_bend(&self, p: &Vector) -> [Vector; 2] {
        #[cfg(target_arch = "x86_64")]
        if self.wide {
            // SAFETY: `wide` is set only where the processor has AVX2.
            #[allow(unsafe_code)]
            return unsafe { self.drawn_by_bend_avx2(p) };
        }
        self.drawn_by_bend_with(p)
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn drawn_by_bend_avx2(&self, p: &Vector) -> [Vector; 2] {
        self.drawn_by_bend_with(p)
    }

    #[inline(always)]
    fn drawn_by_bend_with(&self, p: &Vector) -> [Vector; 2] {
        let ((su, cu), (sv, cv)) = (p[TURN_U].sin_cos(), p[TURN_V].sin_cos());
        let scale = 1.0 / (cu * sv - su * cv);
        let [by_u, by_v] = [[sv, -cv], [-su, cu]].map(|both| both.map(|k| (k * scale) as f32));
        let along = [[-su, cu], [-sv, cv]].map(|both| both.map(|k| k as f32));
        let (x, y) = (p[X] as f32, p[Y] as f32);
        let mut sums = [[Eight::ZERO; COUNT]; 2];
        for (pixels, row) in self.window.blocks().iter().zip(&self.rows) {
            let (dx, dy) = (pixels.x + (-x), pixels.y + (-y));
            for ((sums, by), along) in sums.iter_mut().zip([by_u, by_v]).zip(along) {
                let a = dx * along[0] + dy * along[1];
                let level = (row[X] * by[0] + row[Y] * by[1]) * (a * a);
                for (sum, derivative) in sums.iter_mut().zip(row) {
                    *sum = *sum + *derivative * level;
                }
            }
        }
        sums.map(|sums| sums.map(|sum| f64::from(sum.sum())))
    }
}
