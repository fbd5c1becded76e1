//! `--uncalibrated` of `vservo run` and `vservo serve`.

use super::CellArguments;
use crate::config::UNCALIBRATED;
use crate::rt::tell;

impl CellArguments {
    /// The same cell, of which neither lens nor mount nor target is known where `is_uncalibrated`: the keys for that come before those of `--set`, and are shown.
    #[must_use]
    pub fn uncalibrated(&self, is_uncalibrated: bool) -> Self {
        let mut cell = self.clone();
        if is_uncalibrated {
            cell.set = UNCALIBRATED.map(str::to_owned).into_iter().chain(cell.set).collect();
            tell(format_args!("vservo: --uncalibrated: --set {}", UNCALIBRATED.join(" --set ")));
        }
        cell
    }
}
