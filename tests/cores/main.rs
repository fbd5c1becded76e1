//! The cores, driven in this process: no other process, no shared memory, no clock.

mod arm_unlike_model;
mod boundary;
mod calibration_rendered;
mod camera_on_link;
mod camera_response;
mod chessboard;
mod client_velocities;
mod comparison_metrics;
mod contact;
mod controller_limits;
mod corrupted_images;
mod detection;
mod dot_grid;
mod dot_grid_truth;
mod dots_on_faces;
mod dots_truth;
mod edges_real;
mod everything_at_once;
mod following;
mod friction;
mod goal_noise;
mod goal_path;
mod goals_at_random;
mod held_gain;
mod hostile;
mod identity;
mod injected_faults;
mod lens;
mod limit_avoidance;
mod load_calibration;
mod look_and_move;
mod lost_views;
mod moments;
mod object_at_rest;
mod occlusion;
#[path = "../common/plant.rs"]
mod plant;
mod plausible_numbers;
mod pnp_accuracy;
mod points_in_space;
mod pose_methods;
mod position_laws_on_arms;
mod position_up_to_scale;
mod random_starts;
#[path = "../chessboard/render.rs"]
mod render;
#[path = "../rendered/mod.rs"]
mod rendered;
mod rendered_targets;
mod robot_consistency;
mod robot_energy;
mod robot_errors;
mod robot_fixtures;
mod robot_states;
mod run_refinement;
mod settling;
mod shapes;
#[path = "../supersampled/mod.rs"]
mod supersampled;
#[path = "../tag_scene/mod.rs"]
mod tag_scene;
mod tags;
mod tags_in_bad_light;
mod textbook_errata;
mod three_points;
mod trusted;
mod truth;
mod turned_camera;
mod uncalibrated;
mod untold_friction;
mod untold_payload;
mod untold_rotors;
mod untrue_events;
mod workspace;
