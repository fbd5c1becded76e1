//! The arguments of `vservo camera`.

use crate::config::PixelFormatName;
use clap::{Args, Subcommand, ValueEnum};
use std::path::PathBuf;

/// Arguments of `vservo camera`: the process of a run, or a look at the cameras of this machine.
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct CameraArguments {
    /// What to find out about a camera
    #[command(subcommand)]
    pub question: Option<CameraQuestion>,
    /// Run file (TOML), the same for all processes; the embedded default where it is left out
    pub config: Option<PathBuf>,
    /// Name of the run that this process belongs to
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
    /// Change one value of the run file; must be the same for all processes
    #[arg(long, value_name = "key.path=value")]
    pub set: Vec<String>,
    /// For which camera, by its place in `[[cameras]]`, from 0
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub camera: u8,
    /// No process: show all video devices of this machine, with formats, sizes, rates and controls
    #[arg(long, conflicts_with_all = ["config", "probe", "snapshot"])]
    pub list: bool,
    /// No process: measure a camera (path, name or bus), and suggest its table for a run file
    #[arg(long, value_name = "DEVICE", conflicts_with_all = ["config", "snapshot"])]
    pub probe: Option<String>,
    /// No process: write one image, of CONFIG's camera or of --device
    #[arg(long, value_name = "OUT.png")]
    pub snapshot: Option<PathBuf>,
    /// snapshot: of this camera (path, name or bus)
    #[arg(long, value_name = "DEVICE", requires = "snapshot", conflicts_with = "config")]
    pub device: Option<String>,
    /// probe, snapshot --device: columns and rows
    #[arg(long, value_name = "WxH")]
    pub size: Option<SizeArgument>,
    /// probe, snapshot --device: frames per second
    #[arg(long, value_name = "HZ", value_parser = rate)]
    pub rate: Option<f64>,
    /// probe, snapshot --device: pixel format
    #[arg(long, value_enum, ignore_case = true)]
    pub format: Option<FormatArgument>,
    /// probe: how long to measure, s
    #[arg(long, value_name = "S", default_value_t = 3.0)]
    pub duration_s: f64,
    /// list, probe: print JSON
    #[arg(long)]
    pub json: bool,
    /// Process id of the supervisor: this process ends when that one dies
    #[arg(long, hide = true)]
    pub supervised_by: Option<i32>,
    /// The run file is open on stdin; CONFIG is only its name
    #[arg(long, hide = true)]
    pub config_on_stdin: bool,
}

/// Questions about the camera of a run file.
#[derive(Debug, Subcommand)]
pub enum CameraQuestion {
    /// Measure the camera of a run file, an external program or a real one, and tell what it does wrong
    Check(CameraCheckArguments),
}

/// Arguments of `vservo camera check`.
#[derive(Debug, Args)]
pub struct CameraCheckArguments {
    /// Run file (TOML)
    pub config: Option<PathBuf>,
    /// Change one value of the run file
    #[arg(long, value_name = "key.path=value")]
    pub set: Vec<String>,
    /// Instance through which an external program gives its images
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
    /// Which camera, by its place in `[[cameras]]`, from 0
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub camera: u8,
    /// How long to measure, s
    #[arg(long, value_name = "S", default_value_t = 3.0)]
    pub duration_s: f64,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

fn rate(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(hz) if (0.1..=1000.0).contains(&hz) => Ok(hz),
        _ => Err("allowed is 0.1 to 1000 Hz".into()),
    }
}

/// Columns and rows, as in `640x480`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SizeArgument {
    /// Columns, px.
    pub width: u32,
    /// Rows, px.
    pub height: u32,
}

impl std::str::FromStr for SizeArgument {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let sides = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
        match sides {
            Some((width @ 16..=16384, height @ 16..=16384)) => Ok(Self { width, height }),
            _ => Err("expected columns and rows, for example 640x480".into()),
        }
    }
}

/// Pixel format on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "UPPER")]
pub enum FormatArgument {
    /// 8 bits of grey
    Grey,
    /// 10 bits of grey in 16
    Y10,
    /// 12 bits of grey in 16
    Y12,
    /// 16 bits of grey
    Y16,
    /// Grey in every other byte, from the first on
    Yuyv,
    /// Grey in every other byte, from the second on
    Uyvy,
    /// 8 bits of grey, and the colours behind them
    Nv12,
    /// Blue, green and red
    Bgr3,
    /// Red, green and blue
    Rgb3,
    /// A JPEG file for each image
    Mjpg,
}

impl From<FormatArgument> for PixelFormatName {
    fn from(format: FormatArgument) -> Self {
        match format {
            FormatArgument::Grey => Self::Grey,
            FormatArgument::Y10 => Self::Y10,
            FormatArgument::Y12 => Self::Y12,
            FormatArgument::Y16 => Self::Y16,
            FormatArgument::Yuyv => Self::Yuyv,
            FormatArgument::Uyvy => Self::Uyvy,
            FormatArgument::Nv12 => Self::Nv12,
            FormatArgument::Bgr3 => Self::Bgr3,
            FormatArgument::Rgb3 => Self::Rgb3,
            FormatArgument::Mjpg => Self::Mjpg,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_and_nonsense_is_not() {
        let size = |text: &str| text.parse::<SizeArgument>();
        assert_eq!(size("1280x720"), Ok(SizeArgument { width: 1280, height: 720 }));
        for bad in ["", "640", "640x", "x480", "640*480", "0x0", "-1x480", "640x99999", "640x480x3"] {
            assert!(size(bad).unwrap_err().contains("640x480"), "{bad}");
        }
    }
}
