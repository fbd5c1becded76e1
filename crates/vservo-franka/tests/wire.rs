//! Bytes that come in any pieces, and bytes that are nothing.

#![allow(clippy::unwrap_used)]

use proptest::prelude::*;
use vservo_franka::JointLimits;
use vservo_franka::wire::{
    Framer, RequestKind, RobotCommand, RobotState, WireError, encode_connect_reply, encode_reply,
    read_request,
};

fn push(framer: &mut Framer, mut bytes: &[u8], mut each: impl FnMut(&mut Framer)) {
    while !bytes.is_empty() {
        let room = framer.room();
        let count = room.len().min(bytes.len());
        room[..count].copy_from_slice(&bytes[..count]);
        framer.filled(count);
        bytes = &bytes[count..];
        each(framer);
    }
}

#[test]
fn pieces_are_put_together() {
    let urdf = JointLimits::fr3().urdf().repeat(8); // longer than the room that is there from the begin
    let messages = [
        encode_connect_reply(0, 10),
        encode_reply(RequestKind::GetRobotModel, 1, 0, urdf.as_bytes()),
        encode_reply(RequestKind::Move, 2, 1, &[]),
        encode_reply(RequestKind::Move, 2, 8, &[]),
    ];
    let expected: Vec<_> = [(0, 3), (1, 1 + urdf.len()), (2, 1), (2, 1)].into();
    let bytes = messages.concat();
    for size in [1, 2, 5, 11, 13, 500, bytes.len()] {
        let (mut framer, mut found) = (Framer::default(), Vec::new());
        for piece in bytes.chunks(size) {
            push(&mut framer, piece, |framer| {
                while let Some(message) = framer.message().unwrap() {
                    found.push((message.number, message.payload.len()));
                }
            });
        }
        assert_eq!(found, expected, "in pieces of {size}");
    }
}

#[test]
fn what_is_no_message_is_refused() {
    let mut framer = Framer::default();
    push(&mut framer, &[0; 12], |_| {});
    assert_eq!(framer.message().unwrap_err(), WireError::Size { size: 0 });
    let mut framer = Framer::default();
    push(&mut framer, &[77, 0, 0, 0, 0, 0, 0, 0, 13, 0, 0, 0, 0], |_| {});
    assert_eq!(framer.message().unwrap_err(), WireError::UnknownCommand { number: 77 });
    let mut framer = Framer::default();
    push(&mut framer, &[1, 0, 0, 0, 0, 0, 0, 0, 255, 255, 255, 255], |_| {});
    assert!(framer.message().is_err(), "nobody waits for four gigabytes");
    assert!(read_request(RequestKind::Move, &[9; 113]).is_err());
}

proptest! {
    #[test]
    fn any_bytes_end_in_a_value_or_an_error(bytes in proptest::collection::vec(any::<u8>(), 0..2000), size in 1..40_usize) {
        let _ = RobotState::decode(&bytes);
        let _ = RobotCommand::decode(&bytes);
        let mut framer = Framer::default();
        'all: for piece in bytes.chunks(size) {
            let room = framer.room();
            room[..piece.len()].copy_from_slice(piece);
            framer.filled(piece.len());
            loop {
                match framer.message() {
                    Ok(Some(message)) => drop(read_request(message.kind, message.payload)),
                    Ok(None) => break,
                    Err(_) => break 'all,
                }
            }
        }
    }
}
