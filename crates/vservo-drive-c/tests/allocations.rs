//! What this thread allocates while commands are taken and states are sent.

#![allow(clippy::unwrap_used, clippy::print_stdout, unsafe_code)] // tests; they call functions in C, and tell what was counted

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::ffi::CString;
use vservo::ipc::{Instance, Services};
use vservo::messages::{DriveCommandMsg, DriveStateMsg, DriveTextMsg, MessageRecord};
use vservo_drive::*;

thread_local! {
    static COUNT: Cell<u64> = const { Cell::new(0) };
}

/// Cycles in which the ends find each other, for which the transport allocates. Chosen by hand: one suffices.
const WARM_UP: u32 = 20;
/// Cycles that are counted.
const CYCLES: u32 = 200;

struct Counting;

// SAFETY: the system's allocator does the work.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.set(COUNT.get() + 1);
        // SAFETY: the caller promises what is needed there.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        // SAFETY: the caller promises what is needed there.
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn allocations(work: impl FnOnce()) -> u64 {
    let before = COUNT.get();
    work();
    COUNT.get() - before
}

#[test]
fn nothing_of_this_library_allocates_in_a_cycle() {
    let instance: Instance = format!("alloc-{}", std::process::id()).parse().unwrap();
    let services = Services::join(&instance).unwrap();
    let [name, command_type, state_type, text_type] = [
        instance.to_string().as_str(),
        DriveCommandMsg::LAYOUT.type_name,
        DriveStateMsg::LAYOUT.type_name,
        DriveTextMsg::LAYOUT.type_name,
    ]
    .map(|text| CString::new(text).unwrap());
    // SAFETY: texts.
    let drive = unsafe {
        vservo_drive_open_with(name.as_ptr(), command_type.as_ptr(), state_type.as_ptr(), text_type.as_ptr())
    };
    assert!(!drive.is_null());
    let (commands, states) =
        (services.drive_command_sender().unwrap(), services.drive_state_receiver().unwrap());
    let state = DriveStateMsg { joints: 6, ..Default::default() };
    let mut command = DriveCommandMsg::default();
    let (mut taken, mut sent, mut sent_by_itself) = (0, 0, 0);
    for cycle in 0..WARM_UP + CYCLES {
        if cycle == WARM_UP {
            (taken, sent, sent_by_itself) = (0, 0, 0);
        }
        // What the transport allocates in a send, without this library.
        sent_by_itself +=
            allocations(|| commands.send(&DriveCommandMsg { joints: 6, ..Default::default() }).unwrap());
        // SAFETY: a handle that is open, and records.
        taken += allocations(|| unsafe {
            assert_eq!(vservo_drive_wait(drive, 1_000_000), 1);
            assert_eq!(vservo_drive_receive(drive, &mut command), 1);
            assert_eq!(vservo_drive_is_valid_command(&command, 6), 1);
            assert_eq!(vservo_drive_is_stopped_by_guardian(drive), 0);
        });
        // SAFETY: as above.
        sent += allocations(|| assert_eq!(unsafe { vservo_drive_send(drive, &state) }, 0));
        states.1.wait(std::time::Duration::ZERO).unwrap();
        assert!(states.0.receive().unwrap().is_some());
    }
    println!(
        "{CYCLES} cycles: {taken} allocations to take a command, {sent} to send a state, {sent_by_itself} of the transport alone to send"
    );
    assert_eq!(taken, 0);
    assert!(sent <= sent_by_itself, "{sent}, and {sent_by_itself} of the transport alone");
    // SAFETY: open, and not used any more.
    assert_eq!(unsafe { vservo_drive_close(drive) }, 0);
    drop((commands, states, services));
    instance.remove_leftovers(None);
}
