//! The controller's end of the dashboard: words by the maker's documentation.

use super::{Shared, accept};
use crate::RuntimeState;
use crate::socket::receive;
use std::io::Write;
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// Takes clients in until the emulator ends.
pub(super) fn serve(shared: &Arc<Shared>, listener: &TcpListener) {
    let mut threads = Vec::new();
    while let Some(stream) = accept(shared, listener) {
        let shared = Arc::clone(shared);
        let thread = std::thread::Builder::new().name("ur-dashboard-client".into());
        threads.extend(thread.spawn(move || talk(&shared, stream)).ok());
        threads.retain(|thread| !thread.is_finished());
    }
    for thread in threads {
        let _ = thread.join();
    }
}

fn talk(shared: &Shared, mut stream: TcpStream) {
    // Chosen by hand: so often a thread looks whether the emulator ends.
    if stream.set_read_timeout(Some(Duration::from_millis(20))).is_err()
        || shared.core().faults.silent_dashboard
    {
        while !shared.ends.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(20));
        }
        return;
    }
    let mut waiting = Vec::new();
    if stream.write_all(b"Connected: Universal Robots Dashboard Server\n").is_err() {
        return;
    }
    while !shared.ends.load(Ordering::Relaxed) {
        let mut piece = [0; 256];
        let Ok(count) = receive(&mut stream, &mut piece) else { return };
        waiting.extend_from_slice(piece.get(..count.unwrap_or(0)).unwrap_or_default());
        while let Some(end) = waiting.iter().position(|byte| *byte == b'\n') {
            let line: Vec<u8> = waiting.drain(..=end).collect();
            let line = String::from_utf8_lossy(&line);
            let line = line.trim();
            let answer = answer(shared, line);
            if stream.write_all(format!("{answer}\n").as_bytes()).is_err() || line == "quit" {
                return;
            }
        }
    }
}

fn answer(shared: &Shared, line: &str) -> String {
    let mut core = shared.core();
    let program = if core.runtime == RuntimeState::Playing { "PLAYING" } else { "STOPPED" };
    match line {
        "power on" => core.power_on().into(),
        "power off" => core.power_off().into(),
        "brake release" => core.release_brakes().into(),
        "unlock protective stop" => core.unlock().into(),
        "close safety popup" => "closing safety popup".into(),
        "close popup" => "closing popup".into(),
        "stop" => {
            core.end_program();
            "Stopped".into()
        }
        "robotmode" => format!("Robotmode: {}", core.mode.word()),
        "safetymode" => format!("Safetymode: {}", core.safety.word()),
        "safetystatus" => format!("Safetystatus: {}", core.safety.word()),
        "running" => format!("Program running: {}", core.runtime == RuntimeState::Playing),
        "programState" => format!("{program} unnamed.urp"),
        "get loaded program" => "Loaded program: unnamed.urp".into(),
        "is in remote control" => core.remote_control.to_string(),
        "PolyscopeVersion" => format!("URSoftware {} (Nov 24 2023)", core.version),
        "version" => core.version.to_string(),
        "get robot model" => "UR5".into(),
        "get serial number" => "20000000000".into(),
        "quit" => "Disconnected".into(),
        other => format!("could not understand: '{other}'"),
    }
}
