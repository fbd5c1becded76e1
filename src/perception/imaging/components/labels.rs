//! What belongs to which region, when it is asked for: of runs, of pixels, and moments weighted with grey levels.

use super::Components;
use crate::imaging::{ImageView, MomentSums, Plane, Runs};

impl Components {
    /// The region of each run that [`Components::find`] was given, in their order: indices in [`Components::as_slice`].
    pub fn of_runs(&mut self) -> &[u32] {
        self.indices.clear();
        self.of_runs.clear();
        let mut count = 0;
        for (part, &parent) in (0u32..).zip(&self.parents) {
            // parents are smaller: their region is known
            let known = if parent == part { None } else { self.indices.get(parent as usize).copied() };
            self.indices.push(known.unwrap_or(count));
            count += u32::from(known.is_none());
        }
        self.of_runs
            .extend(self.labels.iter().map(|&part| self.indices.get(part as usize).copied().unwrap_or(0)));
        &self.of_runs
    }

    /// Writes the labels of all pixels of an image of the given size: 0 for background, else 1 + the index in
    /// [`Components::as_slice`]. `runs` are those that [`Components::find`] was given.
    pub fn label_image(&mut self, runs: &Runs, width: usize, height: usize, labels: &mut Plane<u32>) {
        labels.reshape(width, height);
        (0..height).for_each(|y| labels.row_mut(y).fill(0));
        for (run, &region) in runs.as_slice().iter().zip(self.of_runs()) {
            let part = run.x0 as usize..(run.x1 as usize).min(width);
            if let Some(pixels) = labels.row_mut(run.y as usize).get_mut(part) {
                pixels.fill(region + 1);
            }
        }
    }

    /// Moments of one region to third order, each pixel of weight one. `runs` are those that [`Components::find`] was given, and `region`
    /// an index in [`Components::as_slice`].
    #[must_use]
    pub fn sums(&mut self, runs: &Runs, region: usize) -> MomentSums {
        let mut sums = MomentSums::default();
        for (run, &of) in runs.as_slice().iter().zip(self.of_runs()) {
            if of as usize == region {
                sums += MomentSums::of_run(run);
            }
        }
        sums
    }

    /// Moments of each region, in the order of [`Components::as_slice`], with each pixel weighted with its level. `runs` are those
    /// that [`Components::find`] was given, and `image` that in which they were found.
    pub fn grey_sums(&mut self, image: &ImageView<'_>, runs: &Runs, sums: &mut Vec<MomentSums>) {
        sums.clear();
        sums.resize(self.list.len(), MomentSums::default());
        for (run, &region) in runs.as_slice().iter().zip(self.of_runs()) {
            let pixels = image.row(run.y as usize).get(run.x0 as usize..run.x1 as usize);
            if let (Some(own), Some(pixels)) = (sums.get_mut(region as usize), pixels) {
                own.add_grey(pixels, run.x0, run.y);
            }
        }
    }
}
