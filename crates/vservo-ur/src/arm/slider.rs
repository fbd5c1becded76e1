//! The speed slider of the pendant while a program runs: the arm lags behind what it is commanded where that is below 100 %.

use super::readiness::SLIDER;

/// How long the slider must stand before it is told where, s. Chosen by hand: longer than a finger rests on its way.
const STANDS_S: f64 = 0.3;
/// What counts as a step of it. Chosen by hand: the percents that are told.
const STEP: f64 = 0.01;

/// What was seen and told of it.
#[derive(Debug)]
pub(super) struct SliderWatch {
    slows: bool,
    told: f64,
    /// Where it was seen last, and since when, by the robot's clock, s.
    stands: f64,
    since_s: f64,
}

impl Default for SliderWatch {
    fn default() -> Self {
        Self { slows: false, told: 1.0, stands: 1.0, since_s: 0.0 }
    }
}

impl SliderWatch {
    /// What is newly to be told: at once that it slows the arm or does no longer, and where it stands when it was moved on.
    pub(super) fn note(&mut self, slider: f64, robot_s: f64) -> Option<String> {
        if (slider - self.stands).abs() >= 0.5 * STEP {
            (self.stands, self.since_s) = (slider, robot_s);
        }
        let slows = slider < SLIDER;
        let has_changed = std::mem::replace(&mut self.slows, slows) != slows;
        let has_moved_on = slows && robot_s - self.since_s >= STANDS_S && (slider - self.told).abs() >= STEP;
        if !has_changed && !has_moved_on {
            return None;
        }
        self.told = slider;
        Some(if slows {
            format!(
                "the speed slider of the pendant stands at {:.0} % now: the robot slows what it is commanded, so that the arm lags, as one does that something touches; set it to 100 %",
                100.0 * slider
            )
        } else {
            "the speed slider of the pendant stands at 100 % again".into()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A finger takes it down within a second, rests at 40 %, and takes it up again: told are the first step, the end, and 100 %.
    #[test]
    fn the_begin_and_the_end_of_a_move_are_told() {
        let mut watch = SliderWatch::default();
        let place = |t: f64| match t {
            t if t < 1.0 => 1.0,
            t if t < 2.0 => 1.0 - 0.6 * (t - 1.0),
            t if t < 4.0 => 0.4,
            _ => 1.0,
        };
        let told: Vec<_> =
            (0..3000).filter_map(|k| watch.note(place(0.002 * f64::from(k)), 0.002 * f64::from(k))).collect();
        assert_eq!(told.len(), 3, "{told:#?}");
        assert!(told[0].contains("at 99 %") || told[0].contains("at 98 %"), "{}", told[0]);
        assert!(told[1].contains("stands at 40 % now"), "{}", told[1]);
        assert!(told[2].contains("100 % again"), "{}", told[2]);
    }
}
