//! Real processes under instances of their own, and whole runs.

mod arms;
mod bad_input;
mod broken_output;
mod calibrate_camera;
mod calibrate_hand_eye;
mod calibrate_latency;
mod cameras;
mod clients;
#[path = "../common/mod.rs"]
mod common;
mod detect_and_print;
#[path = "../common/drive.rs"]
mod drive;
mod drive_imperfections;
mod dry_run;
mod experiments;
mod external_drive;
mod external_drive_joins;
mod gains;
mod goal_reached;
mod hanging;
mod hostile_files;
mod in_process;
mod laws;
mod lockstep;
mod moving_target;
mod mujoco;
mod place;
mod places;
mod pose_tool;
mod process_image;
mod rates;
mod real_cameras;
mod record;
mod report;
mod result_files;
mod run_ends;
mod scarcity;
mod serve;
mod spans;
mod stamps;
mod stereo;
mod stereo_tool;
mod torque_safety;
mod trace;
mod wrong_description;
