//! The drive of an arm of Universal Robots.

fn main() -> std::process::ExitCode {
    vservo::cli::drive_ur_main()
}
