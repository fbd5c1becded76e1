//! Text from outside: how files are read, what somebody may have meant, and how what stands in them is shown to people.

pub mod file;
mod nearest;
mod printable;
mod shell;
pub mod used;

pub use nearest::nearest;
pub use printable::{number, printable};
pub use shell::shell_word;
