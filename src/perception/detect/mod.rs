//! From a grey frame to the points of the target, each with its identity.
//!
//! ```text
//! frame ─► Finder: search of the whole frame, or tracking where points are PredictedPoint ─► Detection, by id
//!            ├ dots: four dots, grids of dots
//!            ├ chessboard: corners of squares, also of a part
//!            ├ tags: corners of tags
//!            └ shape: the outline of a polygon or an ellipse
//! ```
//! [`segments`] and [`ellipse`] find straight edges and ellipses by their rims, without a target.
//!
//! All positions are pixels of the distorted image.
//!
//! # Terms
//!
//! | term | meaning |
//! | --- | --- |
//! | target | What is to be found: points with ids, known in the object's frame (`target`). |
//! | finder | Finds the points of one kind of target in a frame; it owns its buffers ([`Finder`]). |
//! | search | Detection in the whole frame, without knowledge of where the target is. |
//! | track | Detection in windows about the points where they are expected ([`PredictedPoint`]). |
//! | detection | A point with its id, its position and its standard deviation ([`Detection`]). |
//! | identity | Which point of the target a region, a corner or an edge is. A finder that cannot decide reports an ambiguity. |
//! | region | Connected pixels on one side of a threshold. |
//! | rim, edge | The border of a dot or an ellipse; the straight border of a square, a tag or an outline. |
//! | edge profile | The grey levels across a border: a step, blurred by lens and pixels. |
//! | partly occluded | A dot or a corner that something hides in part, so that its measured centre is shifted; treated like one that is unevenly lit. |
//! | bias | The offset of what is measured (a centroid, a corner) from the projection of the point, by perspective and lens. |
//!
//! # What all finders share, and what they do not
//! Runs, regions ([`Components`](crate::imaging::Components)), outlines ([`Outlines`](crate::imaging::Outlines)) and thresholds that follow the
//! light ([`LocalThreshold`](crate::imaging::LocalThreshold)) are those of [`crate::imaging`]; a camera's response is taken out of the levels
//! before any finder processes them. Edges are located in several ways, for these reasons:
//!
//! | where an edge lies | by | because |
//! |---|---|---|
//! | [`EdgeScan`](crate::imaging::EdgeScan): segments, rims | the sum of one row's levels between two plateaus | nothing is known beyond three pixels on either side; hundreds of scans are fitted |
//! | sides of tags | the same sum, windows of any length, levels from all rows of the side | cells one and two away are known to be black or white, and what blur carries over from them is taken off |
//! | outlines of shapes | offset, blur and both levels of a piece, by all pixels about it | the outline is curved, its pieces are short, and neither levels nor blur are known |
//! | corners of chessboards | the product of two edges | no pixel about a corner belongs to one edge alone |
//! | tags of narrow cells | all cells at once | no side has a plateau |
//! | dots | moments, without an edge | every pixel of a dot contributes to its centroid; its rim is scanned only where the dot is partly occluded or unevenly lit |
//!
//! [`Segmentation`](crate::imaging::Segmentation) joins pixels by their levels, without a threshold, and [`LocalMean`](crate::imaging::LocalMean)
//! is the adaptive threshold of Sect. 10.2: both are the textbook's, and no finder uses them.
//!
//! # Numbers
//! Of a constant that was chosen by hand, what its half and double would change is reasoned from the code. No study has varied it, and where a
//! test is named, that test holds what the constant is for, at its present value.
//!
//! # Example
//!
//! ```
//! # use vservo_perception as vservo;
//! use vservo::camera_model::{CameraModel, Distortion, Intrinsics};
//! use vservo::detect::Finder;
//! use vservo::imaging::ImageView;
//! use vservo::target::{FourDots, Target};
//!
//! let lens = Intrinsics { fx_px: 600.0, fy_px: 600.0, cx_px: 319.5, cy_px: 239.5, width_px: 640, height_px: 480 };
//! let camera = CameraModel::new(lens, Distortion::default())?;
//! let mut finder = Finder::new(camera, &Target::from(FourDots::default()));
//!
//! let pixels = vec![200; 640 * 480]; // an empty scene: no target, and no false one
//! let mut detections = Vec::new();
//! assert!(finder.search(&ImageView::new(&pixels, 640, 480)?, &mut detections).is_err());
//! assert!(detections.is_empty());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod chessboard;
mod dots;
pub mod ellipse;
mod finder;
mod found;
pub mod segments;
pub mod shape;
pub mod tags;

pub use dots::{DotFinder, centre_offset, dot_covariance_px2};
pub use finder::Finder;
pub use found::{Detection, PredictedPoint};
