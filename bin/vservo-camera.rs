//! The camera process as a binary of its own, so that rights can be given to it alone.

fn main() -> std::process::ExitCode {
    vservo::cli::role_main(vservo::ipc::Role::Camera(vservo::messages::CameraId::FIRST))
}
