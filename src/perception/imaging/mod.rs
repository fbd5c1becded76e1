//! Image processing of Sect. 10.2 on 8-bit grey images, and the way to grey from what cameras deliver.
//!
//! ```text
//! a camera's buffer --grey, jpeg--> ImageView
//! ImageView --> Histogram --> Otsu, valley; local mean, local extremes --> dark or light runs of each row
//! runs --> components with moments, nesting; contours with hierarchy --> polygons, perimeter, moments
//! ImageView --> Segmentation: regions merged by a uniformity predicate
//! ImageView --> Gaussian, Pyramid --> Gradient --> magnitude, direction --> Edges --> Chains --> line, ellipse
//! ```
mod chains;
mod components;
mod contours;
pub mod corners;
mod crossings;
mod dual_conic;
mod edge_scan;
mod edge_threshold;
mod edges;
mod ellipse;
mod ellipse_fit;
mod gaussian;
mod gradient;
pub mod grey;
mod histogram;
pub mod jpeg;
mod laplacian;
mod line_fit;
mod local_mean;
mod local_threshold;
mod magnitude;
mod mask;
mod moments;
mod nesting;
mod outlines;
mod perimeter;
mod plane;
mod polygon;
mod pyramid;
mod robust;
mod runs;
mod segmentation;
pub mod simd;
#[cfg(test)]
pub(crate) mod test_image;
mod valley;
mod view;

pub use chains::{Chain, Chains};
pub use components::{Component, Components, Connectivity};
pub use contours::{Contour, Contours, Point};
pub use crossings::WindowPoint;
pub use dual_conic::DualConic;
pub use edge_scan::{Crossing, EdgeScan, ScanAxis};
pub use edge_threshold::{edges_by_laplacian, edges_by_magnitude};
pub use edges::{EdgePixel, EdgeThresholds, Edges, Norm};
pub use ellipse::Ellipse;
pub use ellipse_fit::EllipseFit;
pub use gaussian::{Gaussian, GaussianError};
pub use gradient::{Gradient, Operator};
pub use histogram::{Histogram, Otsu, PairCounter};
pub use laplacian::laplacian;
pub use line_fit::{EdgePoint, Line};
pub use local_mean::LocalMean;
pub use local_threshold::LocalThreshold;
pub use magnitude::{direction, magnitude, magnitude_sum};
pub use moments::{MomentSums, Moments, PrincipalMoments};
pub use nesting::{Nested, Nesting};
pub use outlines::{Outline, Outlines};
pub use perimeter::{chain_length_px, circularity, perimeter_px};
pub use plane::Plane;
pub use polygon::Polygons;
pub use pyramid::Pyramid;
pub use runs::{Polarity, Run, Runs, Window};
pub use segmentation::{GreyRegion, Segmentation, TooManyPixels, Uniformity};
pub use valley::Valley;
pub use view::{ImageSizeError, ImageView, MAX_LEVEL};
