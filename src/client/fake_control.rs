//! A control of tests: it answers as its state says, and moves nothing.

#![allow(clippy::unwrap_used)]
use super::Client;
use crate::control::lifecycle::Request;
use crate::ipc::{CommandServer, Instance, Role, Services};
use crate::messages::{ControlAnswer, ControlState, Status, answer_flag};
use crate::process::StopFlag;
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::JoinHandle;
use std::time::Duration;

/// One that goes on in a thread until it is dropped.
pub(super) struct FakeControl {
    instance: Instance,
    standing: Arc<Mutex<ControlAnswer>>,
    last: Arc<Mutex<Option<Status>>>,
    ended: StopFlag,
    thread: Option<JoinHandle<()>>,
}

impl Drop for FakeControl {
    fn drop(&mut self) {
        self.ended.request();
        self.thread.take().unwrap().join().unwrap();
        self.instance.remove_leftovers(None);
    }
}

impl FakeControl {
    pub(super) fn start(name: &str, flags: u32) -> Self {
        let instance: Instance = format!("u-{name}-{}", std::process::id()).parse().unwrap();
        let first = ControlAnswer { flags, state: ControlState::Idle as u32, ..ControlAnswer::default() };
        let (standing, last) = (Arc::new(Mutex::new(first)), Arc::new(Mutex::new(None)));
        let ended = StopFlag::default();
        let (tell, begun) = std::sync::mpsc::channel();
        let shared = (instance.clone(), Arc::clone(&standing), Arc::clone(&last), ended.clone());
        let thread = std::thread::Builder::new()
            .name("fake-control".into())
            .spawn(move || {
                let (instance, standing, last, ended) = shared;
                let _role = instance.lock(Role::Control).unwrap();
                let services = Services::join(&instance).unwrap();
                let (server, statuses) =
                    (services.command_server().unwrap(), services.status_sender().unwrap());
                tell.send(()).unwrap();
                while !ended.is_requested() {
                    answer_all(&server, &standing);
                    std::thread::sleep(Duration::from_millis(1));
                }
                let last: Option<Status> = last.lock().unwrap().take();
                last.iter().for_each(|status| statuses.send_quietly(status).unwrap());
            })
            .unwrap();
        begun.recv().unwrap();
        Self { instance, standing, last, ended, thread: Some(thread) }
    }

    pub(super) fn served(name: &str) -> Self {
        Self::start(name, answer_flag::SERVED)
    }

    pub(super) fn client(&self) -> Client {
        Client::connect(&self.instance.to_string()).unwrap()
    }

    pub(super) fn standing(&self) -> MutexGuard<'_, ControlAnswer> {
        self.standing.lock().unwrap()
    }

    pub(super) fn state(&self) -> ControlState {
        ControlState::from_code(self.standing().state)
    }

    pub(super) fn fail(&self, fault: u32) {
        let mut standing = self.standing();
        (standing.state, standing.fault) = (ControlState::Fault as u32, fault);
    }

    /// Ends after some looks of a client, and sends this before.
    pub(super) fn end_with(self, status: Option<Status>) -> JoinHandle<()> {
        *self.last.lock().unwrap() = status;
        std::thread::Builder::new()
            .name("fake-control".into())
            .spawn(move || {
                std::thread::sleep(Duration::from_millis(400));
                drop(self);
            })
            .unwrap()
    }
}

fn answer_all(server: &CommandServer, standing: &Mutex<ControlAnswer>) {
    while let Some(asked) = server.receive().unwrap() {
        let mut standing = standing.lock().unwrap();
        let command = asked.command();
        let state = match Request::from_code(command.request) {
            Some(Request::Start) => Some(ControlState::Servoing),
            Some(Request::Hold) => Some(ControlState::Held),
            Some(Request::Reset) => Some(ControlState::Idle),
            _ => None,
        };
        if let Some(state) = state {
            standing.motion_request += 1;
            (standing.state, standing.fault, standing.at_goal_s) = (state as u32, 0, 0.0);
        }
        asked.answer(&ControlAnswer { request: command.request, ..*standing });
    }
}
