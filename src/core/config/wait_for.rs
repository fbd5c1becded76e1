//! What a program or `vservo ctl wait` waits for.

use crate::messages::ControlState;
use std::fmt;
use std::str::FromStr;

/// What is waited for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WaitFor {
    /// The goal is reached and held.
    Converged,
    /// The view is lost: the arm holds, or returns to where it saw the target last.
    Holding,
    /// There is a fault.
    Fault,
    /// Control is in this state.
    State(ControlState),
}

impl FromStr for WaitFor {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let state = |word: &str| ControlState::ALL.into_iter().find(|state| state.as_str() == word);
        match (text, text.strip_prefix("state=")) {
            ("converged", _) => Ok(Self::Converged),
            ("holding", _) => Ok(Self::Holding),
            ("fault", _) => Ok(Self::Fault),
            (_, Some(word)) => state(word).map(Self::State).ok_or_else(|| {
                let words: Vec<_> = ControlState::ALL.iter().map(|state| state.as_str()).collect();
                format!("`{word}` is no state; there are {}", words.join(", "))
            }),
            _ => Err(format!(
                "`{text}` is nothing to wait for; there are converged, holding, fault and state=NAME"
            )),
        }
    }
}

impl fmt::Display for WaitFor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Converged => f.write_str("converged"),
            Self::Holding => f.write_str("holding"),
            Self::Fault => f.write_str("fault"),
            Self::State(state) => write!(f, "state={}", state.as_str()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_of_waits_are_understood_and_others_are_told() {
        assert_eq!("converged".parse(), Ok(WaitFor::Converged));
        assert_eq!("state=held".parse(), Ok(WaitFor::State(ControlState::Held)));
        let told = "state=dancing".parse::<WaitFor>().unwrap_err();
        assert!(told.contains("servoing") && told.contains("dancing"), "{told}");
        assert!("done".parse::<WaitFor>().unwrap_err().contains("state=NAME"));
    }
}
