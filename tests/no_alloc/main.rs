//! What may not allocate in steady state: each thread watches its own allocations.

use assert_no_alloc::AllocDisabler;

#[global_allocator]
static ALLOCATOR: AllocDisabler = AllocDisabler;

mod chessboard;
#[path = "../common/mod.rs"]
mod common;
mod control;
mod drive;
mod edges;
mod imaging;
mod jpeg;
#[path = "../chessboard/render.rs"]
mod render;
mod robot;
mod solvers;
mod stereo_rendered;
#[path = "../tag_scene/mod.rs"]
mod tag_scene;
mod tags;
mod vision;
