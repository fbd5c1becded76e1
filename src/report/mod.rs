//! What a run leaves to tell: counts, latencies, histograms, and the summary made of them.

pub mod calibration_page;
pub mod histogram;
pub mod latency;
pub mod statistics;
pub mod summary;
