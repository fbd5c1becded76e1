//! `vservo target`: a target to print, in true size.
#![allow(rustdoc::broken_intra_doc_links)] // the words of commands have brackets

use super::{check_writable, shown, write_result};
use crate::input::printable;
use crate::print::{Format, Paper, describe, paper_in_words, print};
use crate::process::ProcessError;
use crate::rt::tell;
use crate::target::Kind;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Arguments of `vservo target`.
#[derive(Debug, Args)]
pub struct TargetArguments {
    /// Which: four_dots[:SIDE_M[:chiral]], dots:COLSxROWS:PITCH_M, chessboard:COLSxROWS:SQUARE_M (inner corners), tag:FAMILY:SIZE_M[:ID],
    /// polygon:X_M,Y_M;X_M,Y_M;... (corners), ellipse:AxB (half its axes, m)
    pub kind: String,
    /// File to write: .svg, .pdf or .png
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// In the middle of this paper, refused where it does not fit; a sheet as large as the target where it is left out
    #[arg(long)]
    pub paper: Option<PaperArgument>,
}

/// Papers of printers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PaperArgument {
    /// 210 x 297 mm
    A4,
    /// 8.5 x 11 inches
    Letter,
    /// 297 x 420 mm
    A3,
}

impl PaperArgument {
    fn paper(self) -> Paper {
        match self {
            Self::A4 => Paper::A4,
            Self::Letter => Paper::Letter,
            Self::A3 => Paper::A3,
        }
    }
}

pub(super) fn target(arguments: &TargetArguments) -> Result<u8, ProcessError> {
    let refused = |message: &str| {
        tell(format_args!("vservo: {}", printable(message)));
        Ok(2)
    };
    let kind: Kind = match arguments.kind.parse() {
        Ok(kind) => kind,
        Err(e) => return refused(&e.to_string()),
    };
    let extension = arguments.out.extension().and_then(|e| e.to_str()).unwrap_or_default();
    let Some(format) = Format::of_extension(extension) else {
        return refused("--out: the name must end in .svg, .pdf or .png");
    };
    let bytes = match print(&kind.target, format, arguments.paper.map(PaperArgument::paper)) {
        Ok(bytes) => bytes,
        Err(e) => return refused(&e.to_string()),
    };
    check_writable(&arguments.out)?;
    let code = write_result(&arguments.out, bytes, 0);
    if code != 0 {
        return Ok(code);
    }
    let line = format!(
        "{}: {}; {}; print it at 100 % and check the bar with a ruler\n",
        printable(&arguments.out.display().to_string()),
        describe(&kind.target),
        match arguments.paper.map(PaperArgument::paper) {
            Some(paper) => format!("on {}", paper.as_str()),
            None => paper_in_words(&kind.target),
        }
    );
    Ok(shown(&line, 0))
}
