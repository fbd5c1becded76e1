//! The arguments of `vservo place` and `vservo view`.
#![allow(rustdoc::broken_intra_doc_links)] // the words of commands have brackets

use super::completion;
use crate::sim::place::Look;
use clap::{Args, ValueEnum};
use clap_complete::engine::{ArgValueCandidates, ArgValueCompleter};
use std::path::PathBuf;

/// Arguments of `vservo place`.
#[derive(Debug, Args)]
pub struct PlaceArguments {
    /// Run file (TOML) with what is to stay as it is; the embedded default where it is left out
    #[arg(add = ArgValueCompleter::new(completion::run_file))]
    pub config: Option<PathBuf>,
    /// Change one value first; may be repeated: robot.model=arm.urdf#tool0 names the arm
    #[arg(long, value_name = "key.path=value", add = ArgValueCandidates::new(completion::keys))]
    pub set: Vec<String>,
    /// Run file to write; stdout where it is left out
    #[arg(long, value_name = "FILE.toml")]
    pub out: Option<PathBuf>,
    /// Where the object lies in the base frame (on the flange for a camera beside the arm), m, and how it is turned, deg; left out: where
    /// it suits the arm
    #[arg(long, value_name = "X,Y,Z[,ROLL,PITCH,YAW]", allow_hyphen_values = true)]
    pub object: Option<String>,
    /// Where the camera is to look; left out: down, or as suits the arm
    #[arg(long, value_enum)]
    pub look: Option<LookArgument>,
    /// From the camera to the target at the goal, m; left out: the target fills a good part of the image
    #[arg(long, value_name = "M")]
    pub distance_m: Option<f64>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Where a camera is to look.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LookArgument {
    /// Down, at a table
    Down,
    /// Level, at a wall
    Level,
    /// Up
    Up,
    /// As suits the arm
    Any,
}

impl From<LookArgument> for Look {
    fn from(look: LookArgument) -> Self {
        match look {
            LookArgument::Down => Self::Down,
            LookArgument::Level => Self::Level,
            LookArgument::Up => Self::Up,
            LookArgument::Any => Self::Any,
        }
    }
}

/// Arguments of `vservo view`.
#[derive(Debug, Args)]
pub struct ViewArguments {
    /// Run file (TOML); the embedded default where it is left out
    #[arg(add = ArgValueCompleter::new(completion::run_file))]
    pub config: Option<PathBuf>,
    /// Change one value first; may be repeated
    #[arg(long, value_name = "key.path=value", add = ArgValueCandidates::new(completion::keys))]
    pub set: Vec<String>,
    /// Image to write: .png or .svg
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
}
