//! Which region lies in which, and how many holes each has: for regions of [`Components`](super::Components), when it is asked for.

use super::{Connectivity, Outlines, Runs};

/// What surrounds a region, and what is missing in it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Nested {
    /// The region in one of whose holes it lies.
    pub parent: Option<u32>,
    /// Holes in it.
    pub holes: u32,
    /// Area of its holes, px^2, with all that lies in them.
    pub holes_px2: u64,
    /// Area within its outer outline, px^2: its own and that of its holes.
    pub filled_px2: u64,
}

/// Finds the nesting of regions. The buffers are reused.
#[derive(Debug, Clone, Default)]
pub struct Nesting {
    outlines: Outlines,
    list: Vec<Nested>,
}

impl Nesting {
    /// Buffers for at most `limit` runs, allocated at once.
    #[must_use]
    pub fn with_limit(limit: usize) -> Self {
        Self { outlines: Outlines::with_limit(limit), list: Vec::with_capacity(limit) }
    }

    /// One entry for each region that [`Components::find`](super::Components::find) finds in the same runs, in its order.
    #[must_use]
    pub fn as_slice(&self) -> &[Nested] {
        &self.list
    }

    /// Finds the nesting of the regions of some runs.
    pub fn find(&mut self, runs: &Runs, connectivity: Connectivity) {
        self.outlines.find(runs, connectivity);
        self.list.clear();
        let outlines = self.outlines.as_slice();
        for outline in outlines {
            if !outline.hole {
                let around = outline.parent().and_then(|hole| outlines.get(hole));
                let (parent, filled_px2) = (around.map(|hole| hole.region), outline.area_px2);
                self.list.push(Nested { parent, filled_px2, ..Nested::default() });
            } else if let Some(region) = self.list.get_mut(outline.region as usize) {
                region.holes += 1;
                region.holes_px2 += outline.area_px2;
            }
        }
    }
}
