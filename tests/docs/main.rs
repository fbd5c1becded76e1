//! What the documents say: their commands, the examples, the layers of the crate.

mod architecture;
mod constants;
mod docs_commands;
mod equations;
mod examples;
mod first_hour;
mod names;
