//! What keys mean. A stop ends a run that is not served, so that it asks first.

/// What the user wants.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MonitorOrder {
    /// Servo to the goal.
    Start,
    /// Come to rest until the next start.
    Hold,
    /// Come to rest; a run that is not served ends by it.
    Stop,
    /// Make the present view the goal.
    Teach,
    /// Clear the fault.
    Reset,
    /// Leave the monitor; the run goes on.
    Quit,
}

impl MonitorOrder {
    /// Its word.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::Hold => "hold",
            Self::Stop => "stop",
            Self::Teach => "teach",
            Self::Reset => "reset",
            Self::Quit => "quit",
        }
    }
}

/// The byte of Ctrl-C, ETX as ASCII has it: in a raw terminal it is a key like others.
const CTRL_C: u8 = 3;
/// The byte that begins the sequence of a function key, ESC as ASCII has it.
const ESCAPE: u8 = 0x1b;

/// Turns what is typed into orders.
#[derive(Debug, Clone, Copy, Default)]
pub struct MonitorKeys {
    asks: bool,
    in_sequence: bool,
}

impl MonitorKeys {
    /// Whether a stop waits for its confirmation.
    #[must_use]
    pub fn asks(&self) -> bool {
        self.asks
    }

    /// The order of a byte that was typed. Bytes of the sequences of arrow and function keys order nothing.
    pub fn press(&mut self, byte: u8) -> Option<MonitorOrder> {
        if std::mem::take(&mut self.in_sequence) {
            // ESC [ parameters end, or ESC O end, as ECMA-48 has it
            self.in_sequence = byte == b'[' || byte == b'O' || byte.is_ascii_digit() || byte == b';';
            return None;
        }
        let asked = std::mem::take(&mut self.asks);
        match byte {
            ESCAPE => {
                self.in_sequence = true;
                None
            }
            CTRL_C => Some(MonitorOrder::Quit),
            b'y' if asked => Some(MonitorOrder::Stop),
            _ if asked => None,
            b'q' => Some(MonitorOrder::Quit),
            b's' => Some(MonitorOrder::Start),
            b'h' => Some(MonitorOrder::Hold),
            b't' => Some(MonitorOrder::Teach),
            b'r' => Some(MonitorOrder::Reset),
            b'x' => {
                self.asks = true;
                None
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn typed(keys: &str) -> Vec<MonitorOrder> {
        let mut state = MonitorKeys::default();
        keys.bytes().filter_map(|byte| state.press(byte)).collect()
    }

    #[test]
    fn a_stop_needs_its_confirmation() {
        assert_eq!(typed("xy"), [MonitorOrder::Stop]);
        assert_eq!(typed("xn"), []);
        assert_eq!(typed("y"), []);
        // The key after the question answers it, and does nothing else.
        assert_eq!(typed("xsy"), []);
        assert_eq!(typed("xx"), []);
        assert_eq!(typed("xq"), []);
        assert_eq!(typed("xnyxy"), [MonitorOrder::Stop]);
    }

    #[test]
    fn keys_order_and_sequences_do_not() {
        use MonitorOrder::{Hold, Quit, Reset, Start, Teach};
        assert_eq!(typed("shtrq"), [Start, Hold, Teach, Reset, Quit]);
        assert_eq!(typed("\x03"), [Quit]);
        assert_eq!(typed("\x1b[A\x1b[15~\x1bOs\x1b[1;5h"), [], "arrows and function keys");
        assert_eq!(typed("\x1b[As"), [Start]);
    }
}
