//! What a run leaves to tell: counts, latencies, histograms, and the summary made of them.

pub mod calibration_page;
pub mod chart;
pub mod compare_page;
pub mod csv_table;
pub mod frame_archive;
pub mod hand_eye_page;
pub mod histogram;
pub mod history;
pub mod isometric;
pub mod latency;
pub mod numbers;
pub mod page;
pub mod run_page;
pub mod statistics;
pub mod summary;
