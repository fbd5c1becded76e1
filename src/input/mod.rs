//! Text from outside: how files are read, and how what stands in them is shown to people.

pub mod file;
mod printable;
mod shell;

pub use printable::{number, printable};
pub use shell::shell_word;
