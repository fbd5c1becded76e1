//! A target made of tags, as points with ids: corner `c` of tag `i` of the list is point `4 i + c`.

use super::finder::{MAX_TAGS, PredictedTag, TagDetection, TagFinder};
use crate::detect::Detection;
use crate::imaging::ImageView;
use crate::messages::TargetStatus;

/// Finds the corners of listed tags. Owns its buffers.
#[derive(Debug, Clone)]
pub struct TagPoints {
    finder: TagFinder,
    /// Ids of the tags and their places in the list, ids rising.
    tags: Box<[(u32, u32)]>,
    seen: Vec<TagDetection>,
}

impl TagPoints {
    /// A finder of the tags `ids`; of an id that is listed twice the first place counts.
    #[must_use]
    pub fn new(finder: TagFinder, ids: &[u32]) -> Self {
        let mut tags: Vec<(u32, u32)> = (0..).zip(ids).map(|(place, &id)| (id, place)).collect();
        tags.sort_unstable();
        tags.dedup_by_key(|(id, _)| *id);
        Self { finder, tags: tags.into(), seen: Vec::with_capacity(MAX_TAGS) }
    }

    /// The same for a camera whose response is not known: see [`TagFinder::for_unknown_response`].
    #[must_use]
    pub fn for_unknown_response(mut self) -> Self {
        self.finder = self.finder.for_unknown_response();
        self
    }

    /// All tags of the last frame, listed or not.
    #[must_use]
    pub fn seen(&self) -> &[TagDetection] {
        &self.seen
    }

    /// Searches the whole frame: fills `found` with the corners of the listed tags, ids rising. A tag that was detected twice is ambiguous and
    /// is left out.
    ///
    /// # Errors
    /// The status that says why there is none of them; `found` is then empty.
    pub fn search(&mut self, image: &ImageView<'_>, found: &mut Vec<Detection>) -> Result<(), TargetStatus> {
        found.clear();
        self.finder.search(image, &mut self.seen).map_err(TargetStatus::from)?;
        let twice = self.collect(found);
        match (found.is_empty(), twice) {
            (false, _) => Ok(()),
            (true, true) => Err(TargetStatus::Ambiguous),
            (true, false) => Err(TargetStatus::OtherTags),
        }
    }

    /// In words, which tags the last frame showed, and which are looked for.
    #[must_use]
    pub fn seen_in_words(&self) -> String {
        let seen = self.seen.iter().map(|tag| tag.id);
        let wanted = self.tags.iter().map(|(id, _)| *id);
        let tags = if self.seen.len() == 1 { "tag" } else { "tags" };
        format!("saw {tags} {}, not {}", ids_in_words(seen), ids_in_words(wanted))
    }

    /// Tracks expected tags: fills `found` with the corners of those that were detected, ids rising. Returns whether there is any.
    pub fn track(
        &mut self,
        image: &ImageView<'_>,
        expected: &[PredictedTag],
        found: &mut Vec<Detection>,
    ) -> bool {
        found.clear();
        self.finder.track(image, expected, &mut self.seen);
        self.collect(found);
        !found.is_empty()
    }

    /// Adds the corners of the listed tags that were detected once. Returns whether any was detected twice.
    fn collect(&self, found: &mut Vec<Detection>) -> bool {
        let mut twice = false;
        for (i, tag) in self.seen.iter().enumerate() {
            let Ok(at) = self.tags.binary_search_by_key(&tag.id, |(id, _)| *id) else { continue };
            // ids rise: equal ones stand together
            let same = |j: Option<usize>| j.and_then(|j| self.seen.get(j)).is_some_and(|t| t.id == tag.id);
            if same(i.checked_sub(1)) || same(Some(i + 1)) {
                twice = true;
                continue;
            }
            let Some(&(_, place)) = self.tags.get(at) else { continue };
            let [a, b, c, d] = tag.corners_px;
            let area_px2 = 0.5 * (c - a).perp(&(d - b)).abs();
            for (corner, px) in tag.corners_px.iter().enumerate() {
                found.push(Detection {
                    id: 4 * place + corner as u32,
                    px: *px,
                    sd_px: tag.sd_px(corner),
                    area_px2,
                    covariance_px2: tag.covariance_px2.get(corner).copied().unwrap_or_default(),
                    dark_level: tag.dark_level,
                    plate_level: tag.light_level,
                    disturbance_px: 0.0,
                });
            }
        }
        found.sort_unstable_by_key(|f| f.id);
        twice
    }
}

/// Most runs of ids that are listed one by one. Chosen by hand: a line of a terminal.
const TOLD_RUNS: usize = 6;

/// Rising ids, what lies side by side as a range: `3, 8 to 19`.
fn ids_in_words(ids: impl Iterator<Item = u32>) -> String {
    let mut runs: Vec<(u32, u32)> = Vec::new();
    for id in ids {
        match runs.last_mut() {
            Some((_, last)) if id <= last.saturating_add(1) => *last = id,
            _ => runs.push((id, id)),
        }
    }
    let told = runs.iter().take(TOLD_RUNS).map(|&(first, last)| match last - first {
        0 => first.to_string(),
        1 => format!("{first}, {last}"),
        _ => format!("{first} to {last}"),
    });
    let told = told.collect::<Vec<_>>().join(", ");
    if runs.len() > TOLD_RUNS { told + " and others" } else { told }
}

#[cfg(test)]
mod tests {
    use super::ids_in_words;

    #[test]
    fn ids_are_told_as_people_write_them() {
        for (ids, told) in [
            (&[5][..], "5"),
            (&[5, 5, 6], "5, 6"),
            (&[3, 8, 9, 10, 11, 19], "3, 8 to 11, 19"),
            (&[0, 2, 4, 6, 8, 10, 12], "0, 2, 4, 6, 8, 10 and others"),
        ] {
            assert_eq!(ids_in_words(ids.iter().copied()), told);
        }
    }
}
