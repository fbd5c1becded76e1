//! Which features of the target a law compares, and how much each one counts.

use crate::messages::MAX_FEATURES;

/// One feature, made of points of the target by their index from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FeatureKind {
    /// An image point, (10.27).
    Point(usize),
    /// The line segment between two image points, (10.28).
    Segment(usize, usize),
}

impl FeatureKind {
    /// The points that make it.
    pub fn points(self) -> impl Iterator<Item = usize> + Clone {
        let (first, second) = match self {
            Self::Point(i) => (i, None),
            Self::Segment(i, j) => (i, Some(j)),
        };
        std::iter::once(first).chain(second)
    }
}

/// Features with their weights, in the order in which they are stacked; memory of fixed size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Selection {
    entries: [(FeatureKind, f64); MAX_FEATURES],
    count: usize,
}

impl Selection {
    /// The points 0 to `count - 1`, all of weight 1.
    #[must_use]
    pub fn all_points(count: usize) -> Self {
        let entries = std::array::from_fn(|i| (FeatureKind::Point(i), 1.0));
        Self { entries, count: count.min(MAX_FEATURES) }
    }

    /// The given features and weights (of the squared errors).
    ///
    /// `None` when there are none or more than [`MAX_FEATURES`], a weight is not positive and finite, or a segment
    /// has one point twice.
    #[must_use]
    pub fn new(features: impl IntoIterator<Item = (FeatureKind, f64)>) -> Option<Self> {
        let mut selection = Self { entries: [(FeatureKind::Point(0), 1.0); MAX_FEATURES], count: 0 };
        for (kind, weight) in features {
            let good =
                weight > 0.0 && weight.is_finite() && !matches!(kind, FeatureKind::Segment(i, j) if i == j);
            *selection.entries.get_mut(selection.count).filter(|_| good)? = (kind, weight);
            selection.count += 1;
        }
        (selection.count > 0).then_some(selection)
    }

    /// The features with their weights.
    #[must_use]
    pub fn features(&self) -> &[(FeatureKind, f64)] {
        self.entries.get(..self.count).unwrap_or(&self.entries)
    }

    /// Whether every point that is used is one of `points`.
    #[must_use]
    pub fn fits(&self, points: usize) -> bool {
        self.features().iter().flat_map(|(kind, _)| kind.points()).all(|i| i < points)
    }

    /// Indices of the points that are used, each one once and in order of first use.
    pub fn points(&self) -> impl Iterator<Item = usize> + Clone + '_ {
        let mut seen = [false; MAX_FEATURES];
        self.features()
            .iter()
            .flat_map(|(kind, _)| kind.points())
            .filter(move |&i| seen.get_mut(i).is_some_and(|seen| !std::mem::replace(seen, true)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn selections_are_checked_and_list_their_points_once() {
        use FeatureKind::{Point, Segment};
        let s = Selection::new([(Segment(2, 0), 1.0), (Point(0), 0.5), (Point(3), 2.0)]).unwrap();
        assert_eq!(s.points().collect::<Vec<_>>(), [2, 0, 3]);
        assert!(s.fits(4) && !s.fits(3));
        assert_eq!(Selection::all_points(3).points().count(), 3);
        assert!(Selection::new([]).is_none());
        assert!(Selection::new([(Segment(1, 1), 1.0)]).is_none());
        assert!(Selection::new([(Point(1), -1.0)]).is_none());
        assert!(Selection::new([(Point(1), f64::NAN)]).is_none());
        assert!(Selection::new([(Point(0), 1.0); MAX_FEATURES + 1]).is_none());
    }
}
