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
            let key = |argument: &str| argument.split('=').next().unwrap_or_default().trim().to_owned();
            let is_own = |argument: &&str| cell.set.iter().any(|own| key(own) == key(argument));
            let added: Vec<&str> = UNCALIBRATED.into_iter().filter(|argument| !is_own(argument)).collect();
            tell(format_args!("vservo: --uncalibrated: --set {}", added.join(" --set ")));
            cell.set = added.into_iter().map(str::to_owned).chain(cell.set).collect();
        }
        cell
    }
}
