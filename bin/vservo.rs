//! The command line.

fn main() -> std::process::ExitCode {
    vservo::cli::main()
}
