//! The drive of an arm of Franka.

fn main() -> std::process::ExitCode {
    vservo::cli::drive_franka_main()
}
