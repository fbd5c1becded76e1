//! Which features of the target an image-based law compares (points, segments, one area), and their weights in the squared error.
//!
//! The order of the selection is that of the rows of `L_s` and `e_s`. Points are indices into the points of the [`SetPoint`](super::SetPoint), from 0.

use crate::messages::MAX_FEATURES;

/// One feature, made of points of the target by their index from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FeatureKind {
    /// An image point, (10.27).
    Point(usize),
    /// The line segment between two image points, (10.28).
    Segment(usize, usize),
    /// The area within the selection's outline.
    Outline(OutlineFeature),
}

impl FeatureKind {
    /// How many numbers the feature has in the stacked error.
    #[must_use]
    pub fn numbers(self) -> usize {
        match self {
            Self::Point(_) => 2,
            Self::Segment(..) | Self::Outline(OutlineFeature::Area) => 4,
            Self::Outline(OutlineFeature::Ellipse) => 5,
            Self::Outline(OutlineFeature::Moments) => 6,
        }
    }
}

/// Which features of an area are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OutlineFeature {
    /// Centroid, area and orientation, [`crate::features::AreaFeature`].
    Area,
    /// Normalized moments to third order, [`crate::features::MomentFeature`].
    Moments,
    /// Centroid and second moments, [`crate::features::EllipseFeature`].
    Ellipse,
}

/// Features with their weights, in the order in which they are stacked; memory of fixed size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Selection {
    entries: [(FeatureKind, f64); MAX_FEATURES],
    count: usize,
    /// Points along the outline of the area; a byte each, because a selection is copied.
    outline: [u8; MAX_FEATURES],
    corners: usize,
}

impl Selection {
    /// The points 0 to `count - 1`, all of weight 1.
    #[must_use]
    pub fn all_points(count: usize) -> Self {
        let entries = std::array::from_fn(|i| (FeatureKind::Point(i), 1.0));
        Self { entries, count: count.min(MAX_FEATURES), outline: [0; MAX_FEATURES], corners: 0 }
    }

    /// The given features and weights (of the squared errors).
    ///
    /// `None` when there are none or more than [`MAX_FEATURES`], a weight is not positive and finite, or a segment
    /// has one point twice.
    #[must_use]
    pub fn new(features: impl IntoIterator<Item = (FeatureKind, f64)>) -> Option<Self> {
        let mut selection = Self::all_points(0);
        for (kind, weight) in features {
            let good =
                weight > 0.0 && weight.is_finite() && !matches!(kind, FeatureKind::Segment(i, j) if i == j);
            *selection.entries.get_mut(selection.count).filter(|_| good)? = (kind, weight);
            selection.count += 1;
        }
        (selection.count > 0).then_some(selection)
    }

    /// The same features, the area of which lies within the polygon through the points `outline`, one after the other.
    ///
    /// `None` when these are fewer than three or more than [`MAX_FEATURES`], or one of them comes twice.
    #[must_use]
    pub fn with_outline(mut self, outline: impl IntoIterator<Item = usize>) -> Option<Self> {
        self.corners = 0;
        for i in outline {
            let place = self.outline.get_mut(self.corners)?;
            *place = u8::try_from(i).ok().filter(|_| i < MAX_FEATURES)?;
            self.corners += 1;
        }
        let outline = self.outline();
        let once = outline.iter().enumerate().all(|(k, i)| !outline.iter().skip(k + 1).any(|j| i == j));
        (self.corners >= 3 && once).then_some(self)
    }

    /// The features with their weights.
    #[must_use]
    pub fn features(&self) -> &[(FeatureKind, f64)] {
        self.entries.get(..self.count).unwrap_or(&self.entries)
    }

    /// How many numbers the features have together: k of the text.
    #[must_use]
    pub fn numbers(&self) -> usize {
        self.features().iter().map(|(kind, _)| kind.numbers()).sum()
    }

    /// The points along the area's outline, by index.
    #[must_use]
    pub fn outline(&self) -> &[u8] {
        self.outline.get(..self.corners).unwrap_or(&self.outline)
    }

    /// Whether an area is compared, so that every point of its outline has to be there.
    #[must_use]
    pub fn needs_outline(&self) -> bool {
        self.features().iter().any(|(kind, _)| matches!(kind, FeatureKind::Outline(_)))
    }

    /// Whether every point that is used is one of `points`, and an area has its outline.
    #[must_use]
    pub fn fits(&self, points: usize) -> bool {
        (self.corners >= 3 || !self.needs_outline())
            && self.features().iter().flat_map(|(kind, _)| self.points_of(*kind)).all(|i| i < points)
    }

    /// Indices of the points that are used, each one once and in order of first use.
    pub fn points(&self) -> impl Iterator<Item = usize> + Clone + '_ {
        let mut seen = [false; MAX_FEATURES];
        self.features()
            .iter()
            .flat_map(|(kind, _)| self.points_of(*kind))
            .filter(move |&i| seen.get_mut(i).is_some_and(|seen| !std::mem::replace(seen, true)))
    }

    /// The points that make a feature.
    fn points_of(&self, kind: FeatureKind) -> impl Iterator<Item = usize> + Clone + '_ {
        let (ends, outline) = match kind {
            FeatureKind::Point(i) => ([Some(i), None], [].as_slice()),
            FeatureKind::Segment(i, j) => ([Some(i), Some(j)], [].as_slice()),
            FeatureKind::Outline(_) => ([None, None], self.outline()),
        };
        ends.into_iter().flatten().chain(outline.iter().map(|i| usize::from(*i)))
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

    #[test]
    fn an_area_has_an_outline_of_three_points_or_more() {
        use FeatureKind::{Outline, Point};
        let s = Selection::new([(Outline(OutlineFeature::Area), 1.0), (Point(5), 1.0)]).unwrap();
        assert!(s.needs_outline() && !s.fits(6));
        let s = s.with_outline([3, 1, 0]).unwrap();
        assert!(s.fits(6) && !s.fits(5));
        assert_eq!(s.points().collect::<Vec<_>>(), [3, 1, 0, 5]);
        assert!(s.with_outline([3, 1]).is_none() && s.with_outline([3, 1, 3]).is_none());
        assert!(s.with_outline(0..MAX_FEATURES + 1).is_none() && s.with_outline([0, 1, 1 << 8]).is_none());
        assert!(s.with_outline(0..MAX_FEATURES).unwrap().fits(MAX_FEATURES));
    }
}
