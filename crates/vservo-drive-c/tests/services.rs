//! The functions as a program in C calls them, before the services of a control: what arrives, and what is refused with which code.

#![allow(clippy::unwrap_used, unsafe_code)] // tests; they call functions in C

use std::ffi::{CStr, CString, c_char};
use std::ptr::{null, null_mut};
use vservo::drive::DriveProperties;
use vservo::ipc::{Halt, Instance, Receiver, Role, Sender, Services};
use vservo::messages::{
    DriveCommandMsg, DriveStateMsg, DriveTextMsg, MAX_JOINTS, MessageRecord, RobotState, drive_flag,
    text_kind,
};
use vservo::time::SpanNs;
use vservo_drive::*;

/// A control with the ports that face a drive, and a drive that was opened by its name.
struct Pair {
    instance: Instance,
    commands: Sender<DriveCommandMsg>,
    states: Receiver<DriveStateMsg>,
    texts: Receiver<DriveTextMsg>,
    drive: *mut DriveHandle,
    _services: Services,
    /// Last: cleans up when nobody is there any more.
    _place: Place,
}

struct Place(Instance);

impl Drop for Place {
    fn drop(&mut self) {
        self.0.remove_leftovers(None);
    }
}

fn open(instance: &str) -> *mut DriveHandle {
    open_with(instance, DriveStateMsg::LAYOUT.type_name)
}

fn open_with(instance: &str, state_type: &str) -> *mut DriveHandle {
    let [instance, command, state, text] =
        [instance, DriveCommandMsg::LAYOUT.type_name, state_type, DriveTextMsg::LAYOUT.type_name]
            .map(|text| CString::new(text).unwrap());
    // SAFETY: all are texts.
    unsafe { vservo_drive_open_with(instance.as_ptr(), command.as_ptr(), state.as_ptr(), text.as_ptr()) }
}

fn last_error() -> String {
    // SAFETY: a text, which no function changes meanwhile.
    unsafe { CStr::from_ptr(vservo_drive_last_error()) }.to_str().unwrap().to_owned()
}

impl Pair {
    fn new(test: &str) -> Self {
        let instance: Instance = format!("{test}-{}", std::process::id()).parse().unwrap();
        let services = Services::join(&instance).unwrap();
        let drive = open(&instance.to_string());
        assert!(!drive.is_null(), "{}", last_error());
        Self {
            commands: services.drive_command_sender().unwrap(),
            states: services.drive_state_receiver().unwrap().0,
            texts: services.drive_text_receiver().unwrap(),
            _place: Place(instance.clone()),
            instance,
            drive,
            _services: services,
        }
    }

    fn send(&self, state: &DriveStateMsg) -> i32 {
        // SAFETY: a handle that is open, and a record.
        unsafe { vservo_drive_send(self.drive, state) }
    }

    fn receive(&self) -> (i32, DriveCommandMsg) {
        let mut command = DriveCommandMsg::default();
        // SAFETY: a handle that is open, and room for a record.
        (unsafe { vservo_drive_receive(self.drive, &mut command) }, command)
    }

    fn names(&self, names: &[&str], signs: *const f64, offsets: *const f64) -> i32 {
        let texts: Vec<_> = names.iter().map(|name| CString::new(*name).unwrap()).collect();
        let pointers: Vec<*const c_char> = texts.iter().map(|text| text.as_ptr()).collect();
        let n = names.len() as u32;
        // SAFETY: as many texts as are told; numbers are null, or as many.
        unsafe { vservo_drive_send_joint_names(self.drive, pointers.as_ptr(), n, signs, offsets) }
    }

    fn properties(&self, period_ns: i64, watchdog_ns: i64, lag_ns: i64, rates: &[f64]) -> i32 {
        let list = if rates.is_empty() { null() } else { rates.as_ptr() };
        // SAFETY: a handle that is open; numbers are null, or as many as are told.
        unsafe {
            vservo_drive_send_properties(self.drive, period_ns, watchdog_ns, lag_ns, list, rates.len() as u32)
        }
    }

    fn words(&self, state: u32, words: &[u8]) -> i32 {
        let words = CString::new(words).unwrap();
        // SAFETY: a handle that is open, and a text.
        unsafe { vservo_drive_send_robot_text(self.drive, state, 7, words.as_ptr()) }
    }
}

impl Drop for Pair {
    fn drop(&mut self) {
        // SAFETY: open, and not used any more.
        assert_eq!(unsafe { vservo_drive_close(self.drive) }, 0, "{}", last_error());
    }
}

fn state() -> DriveStateMsg {
    DriveStateMsg { joints: 6, modes: 0b110, tick: 3, sequence: 99, ..Default::default() }
}

const ARGUMENT: i32 = ErrorCode::Argument as i32;
const VALUE: i32 = ErrorCode::Value as i32;

#[test]
fn commands_arrive_in_order_and_none_is_told() {
    let pair = Pair::new("order");
    // SAFETY: a handle that is open.
    let wait = |ns| unsafe { vservo_drive_wait(pair.drive, ns) };
    assert_eq!((wait(0), wait(-5), wait(1_000_000)), (0, 0, 0));
    let before = DriveCommandMsg::default();
    assert_eq!(pair.receive(), (0, before), "what is there stays");
    for tick in 0..3 {
        pair.commands.send(&DriveCommandMsg { tick, joints: 6, ..Default::default() }).unwrap();
    }
    assert_eq!(wait(i64::MAX), 1);
    for tick in 0..3 {
        let (answer, command) = pair.receive();
        assert_eq!((answer, command.tick), (1, tick));
    }
    assert_eq!((wait(0), pair.receive().0), (0, 0), "bells that were heard do not ring again");
}

#[test]
fn states_are_counted_and_numbers_that_are_none_refused() {
    let pair = Pair::new("states");
    for sequence in 0..2 {
        assert_eq!(pair.send(&state()), 0, "{}", last_error());
        let received = *pair.states.receive().unwrap().unwrap();
        assert_eq!((received.sequence, received.tick, received.modes), (sequence, 3, 0b110));
    }
    let refused: [fn(&mut DriveStateMsg); 6] = [
        |s| s.joints = 0,
        |s| s.joints = MAX_JOINTS as u32 + 1,
        |s| s.q[5] = f64::NAN,
        |s| s.qd[0] = f64::INFINITY,
        |s| s.tau[2] = f64::NAN,
        |s| (s.flags, s.q_true[0]) = (drive_flag::TRUTH, f64::NAN),
    ];
    for (k, change) in refused.iter().enumerate() {
        let mut bad = state();
        change(&mut bad);
        assert_eq!(pair.send(&bad), VALUE, "{k}");
        assert!(last_error().contains("state"), "{}", last_error());
    }
    // What is not in use may be anything.
    let mut odd = state();
    (odd.q[6], odd.q_true[0]) = (f64::NAN, f64::NAN);
    assert_eq!(pair.send(&odd), 0);
    let received = *pair.states.receive().unwrap().unwrap();
    assert_eq!(received.sequence, 2, "what is refused is not counted");
}

#[test]
fn names_and_words_arrive_and_odd_ones_are_refused() {
    let pair = Pair::new("texts");
    let signs = [1.0, -1.0];
    assert_eq!(pair.names(&["a", "b"], signs.as_ptr(), null()), 0, "{}", last_error());
    let text = *pair.texts.receive().unwrap().unwrap();
    assert_eq!((text.names(), text.joints, text.sequence), (vec!["a".into(), "b".into()], 2, 0));
    assert_eq!((text.signs[..3].to_vec(), text.zero_offsets[1]), (vec![1.0, -1.0, 0.0], 0.0));
    assert!(text.stamp.0 > 0);
    let (half, endless) = ([1.0, 0.5], [0.0, f64::NAN]);
    assert_eq!(pair.names(&["a", "b"], half.as_ptr(), null()), VALUE);
    assert_eq!(pair.names(&["a", "b"], null(), endless.as_ptr()), VALUE);
    assert_eq!(pair.names(&["a", " "], null(), null()), ARGUMENT);
    assert_eq!(pair.names(&["a", "b\nc"], null(), null()), ARGUMENT);
    assert_eq!(pair.names(&[], null(), null()), ARGUMENT);
    assert_eq!(pair.names(&["a"; MAX_JOINTS + 1], null(), null()), ARGUMENT);
    assert_eq!(pair.names(&["n".repeat(511).as_str()], null(), null()), 0, "as many as there is room for");
    assert_eq!(pair.names(&["n".repeat(512).as_str()], null(), null()), ARGUMENT);
    assert_eq!(pair.texts.receive().unwrap().unwrap().text().len(), 511);

    assert_eq!(pair.words(RobotState::ProtectiveStop as u32, b"zu schnell: \xfcber 2 m/s"), 0);
    let text = *pair.texts.receive().unwrap().unwrap();
    assert_eq!(
        (text.text().as_str(), text.robot_code, text.sequence),
        ("zu schnell: \u{fffd}ber 2 m/s", 7, 2)
    );
    assert_eq!(pair.words(99, b"no such state"), VALUE);
    assert!(pair.texts.receive().unwrap().is_none());
}

#[test]
fn properties_arrive_as_control_reads_them() {
    let pair = Pair::new("properties");
    let told = || {
        let text = *pair.texts.receive().unwrap().unwrap();
        assert_eq!(text.kind, text_kind::PROPERTIES);
        DriveProperties::parse(&text.text()).unwrap()
    };
    assert_eq!(pair.properties(2_000_000, 100_000_000, 38_000_000, &[1000.0, 12.5]), 0, "{}", last_error());
    let span = |ns| Some(SpanNs(ns));
    let (period, watchdog) = (span(2_000_000), span(100_000_000));
    let lag = span(38_000_000);
    assert_eq!(told(), DriveProperties { period, watchdog, lag, effort_rate: vec![1000.0, 12.5] });
    assert_eq!(pair.properties(0, 20_000_000, -1, &[]), 0, "{}", last_error());
    assert_eq!(told(), DriveProperties { watchdog: span(20_000_000), ..DriveProperties::default() });
    assert_eq!(pair.properties(0, 0, 0, &[]), 0, "{}", last_error());
    assert_eq!(told(), DriveProperties { lag: span(0), ..DriveProperties::default() });
    for (period, watchdog, rate) in [(-1, 0, 1.0), (0, -1, 1.0), (0, 0, 0.0), (0, 0, f64::NAN)] {
        assert_eq!(pair.properties(period, watchdog, 0, &[rate]), VALUE, "{period} {watchdog} {rate}");
    }
    assert_eq!(pair.properties(0, 0, 0, &[1.0; MAX_JOINTS + 1]), ARGUMENT);
    assert_eq!(pair.properties(1_000_000, 0, 0, &[f64::MAX; MAX_JOINTS]), VALUE, "more than a text holds");
    assert!(pair.texts.receive().unwrap().is_none());
}

#[test]
fn the_guardians_stop_is_seen_from_start_on_until_reset() {
    let pair = Pair::new("guarded");
    // SAFETY: a handle that is open.
    let stopped = || unsafe { vservo_drive_is_stopped_by_guardian(pair.drive) };
    assert_eq!(stopped(), 0, "there is no page yet");
    let lock = pair.instance.lock(Role::Control).unwrap();
    let word = pair.instance.make_stop_word().unwrap();
    let start = || {
        pair.commands.send(&DriveCommandMsg { flags: drive_flag::START, ..Default::default() }).unwrap();
        assert_eq!(pair.receive().0, 1);
    };
    start();
    assert_eq!(stopped(), 0);
    let number = word.ask(Halt::Guardian);
    assert_eq!(stopped(), 1);
    word.take(Halt::Guardian, number, Default::default());
    assert_eq!(stopped(), 0);
    // The next control has another page.
    let next = pair.instance.make_stop_word().unwrap();
    let _ = next.ask(Halt::Guardian);
    assert_eq!(stopped(), 0);
    start();
    assert_eq!(stopped(), 1);
    drop(lock);
}

#[test]
fn commands_that_no_drive_may_obey_are_told_apart() {
    let good = DriveCommandMsg { joints: 6, mode: 2, ..Default::default() };
    // SAFETY: a record, or null.
    let valid =
        |command: *const DriveCommandMsg, joints| unsafe { vservo_drive_is_valid_command(command, joints) };
    let unused = DriveCommandMsg { q_r: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, f64::NAN], ..good };
    assert_eq!((valid(&good, 6), valid(&unused, 6)), (1, 1));
    let mut endless = good;
    endless.qdd_r[3] = f64::INFINITY;
    let mode = DriveCommandMsg { mode: 3, ..good };
    let many = DriveCommandMsg { joints: 8, ..good };
    assert_eq!((valid(&good, 5), valid(&endless, 6), valid(&mode, 6), valid(&many, 8)), (0, 0, 0, 0));
    assert_eq!(valid(&DriveCommandMsg { joints: 0, ..good }, 0), 0);
    assert_eq!(valid(null(), 6), ARGUMENT);
}

#[test]
fn null_in_place_of_anything_is_an_error_and_no_crash() {
    let pair = Pair::new("null");
    let (none, text) = (null_mut::<DriveHandle>(), c"x".as_ptr());
    let mut odd = DriveCommandMsg::default();
    // SAFETY: null is what is tried, and every other pointer leads to what it should.
    unsafe {
        for (answer, what) in [
            (vservo_drive_close(none), "close"),
            (vservo_drive_wait(none, 0), "wait"),
            (vservo_drive_receive(none, &mut DriveCommandMsg::default()), "receive"),
            (vservo_drive_receive(pair.drive, null_mut()), "receive into nothing"),
            (
                vservo_drive_receive(pair.drive, (&raw mut odd).byte_add(4)),
                "receive into what is not aligned",
            ),
            (vservo_drive_send(none, &state()), "send"),
            (vservo_drive_send(pair.drive, null()), "send nothing"),
            (vservo_drive_send_joint_names(none, &text, 1, null(), null()), "names"),
            (vservo_drive_send_joint_names(pair.drive, null(), 1, null(), null()), "no names"),
            (vservo_drive_send_joint_names(pair.drive, &null(), 1, null(), null()), "a name that is none"),
            (vservo_drive_send_robot_text(none, 1, 0, text), "words"),
            (vservo_drive_send_robot_text(pair.drive, 1, 0, null()), "no words"),
            (vservo_drive_send_properties(none, 0, 0, 0, null(), 0), "properties"),
            (vservo_drive_is_stopped_by_guardian(none), "guardian"),
            (vservo_drive_leave_reason(text, null()), "no reason"),
            (vservo_drive_leave_reason(c"not a/name".as_ptr(), text), "no instance"),
        ] {
            assert_eq!(answer, ARGUMENT, "{what}");
            assert!(!last_error().is_empty(), "{what}");
        }
        assert!(vservo_drive_config_path(none).is_null());
        assert!(vservo_drive_open_with(null(), null(), null(), null()).is_null());
        let path = CStr::from_ptr(vservo_drive_config_path(pair.drive)).to_str().unwrap();
        assert_eq!(path, pair.instance.config_path().to_str().unwrap());
    }
}

#[test]
fn another_thread_is_refused_and_changes_nothing() {
    let pair = Pair::new("threads");
    let address = pair.drive as usize;
    let elsewhere = move || {
        let drive = address as *mut DriveHandle;
        // SAFETY: a handle that is open; that another thread uses it is what is tried.
        let answers = unsafe { [vservo_drive_send(drive, &state()), vservo_drive_close(drive)] };
        (answers, last_error())
    };
    let thread = std::thread::Builder::new().name("elsewhere".into()).spawn(elsewhere).unwrap();
    let (answers, words) = thread.join().unwrap();
    assert_eq!(answers, [ErrorCode::Thread as i32; 2]);
    assert!(words.contains("thread"), "{words}");
    assert!(pair.states.receive().unwrap().is_none());
    assert_eq!(pair.send(&state()), 0, "the owner goes on");
}

#[test]
fn a_header_of_another_version_and_a_second_drive_are_refused() {
    let pair = Pair::new("second");
    let instance = pair.instance.to_string();
    assert!(open_with(&instance, "vservo.DriveState.v2").is_null());
    assert!(
        last_error().contains("vservo.DriveState.v2") && last_error().contains("layouts"),
        "{}",
        last_error()
    );
    assert!(open(&instance).is_null(), "there is one drive");
    assert!(last_error().contains("drive/text"), "{}", last_error());
    assert!(open("no name").is_null());
    assert_eq!(pair.send(&state()), 0, "the first one is as it was");
}

#[test]
fn a_reason_is_left_for_the_summary() {
    let pair = Pair::new("reason");
    let name = CString::new(pair.instance.to_string()).unwrap();
    // SAFETY: texts.
    let leave = |name: &CStr, why: &CStr| unsafe { vservo_drive_leave_reason(name.as_ptr(), why.as_ptr()) };
    assert_eq!(leave(&name, c"joint 3: \nits brake"), 0, "{}", last_error());
    assert_eq!(pair.instance.words_of_drive().as_deref(), Some("joint 3: its brake"));
    assert_eq!(leave(&name, c""), 0);
    assert_eq!(pair.instance.words_of_drive(), None);
    assert_eq!(leave(c"nobody-runs-this", c"why"), ErrorCode::Transport as i32);
}

#[test]
fn the_time_is_that_of_stamps_and_sleep_ends_after_it() {
    let before = vservo::rt::now().0;
    let until = vservo_drive_now_ns() + 2_000_000;
    assert!(until >= before + 2_000_000);
    vservo_drive_sleep_until_ns(until);
    vservo_drive_sleep_until_ns(i64::MIN);
    assert!(vservo_drive_now_ns() >= until);
}
