//! The codec: any bytes, in any pieces, are packages or errors, and never panic.

#![allow(clippy::unwrap_used, clippy::panic)]

use proptest::prelude::*;
use vservo_ur::rtde::{DataType, Framer, PackageType, Reader, Recipe, SetupReply, WireError, Writer};

const KINDS: [PackageType; 8] = [
    PackageType::ProtocolVersion,
    PackageType::ControlVersion,
    PackageType::Text,
    PackageType::Data,
    PackageType::SetupOutputs,
    PackageType::SetupInputs,
    PackageType::Start,
    PackageType::Pause,
];

fn bytes_of(kind: PackageType, payload: &[u8]) -> Vec<u8> {
    Writer::default().begin(kind).put(payload).package().to_vec()
}

/// The packages of a stream that comes in these pieces.
fn received(stream: &[u8], piece: usize) -> Result<Vec<(PackageType, Vec<u8>)>, WireError> {
    let (mut framer, mut found) = (Framer::default(), Vec::new());
    for piece in stream.chunks(piece.max(1)) {
        let mut rest = piece;
        while !rest.is_empty() {
            let taken = framer.push(rest);
            assert!(taken > 0, "there is always room");
            rest = &rest[taken..];
            while let Some(package) = framer.next()? {
                found.push((package.kind, package.payload.to_vec()));
            }
        }
    }
    Ok(found)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    /// What was written is read, whatever the pieces.
    #[test]
    fn packages_survive_any_pieces(
        packages in prop::collection::vec((0..8_usize, prop::collection::vec(any::<u8>(), 0..3000)), 1..20),
        piece in 1..5000_usize,
    ) {
        let packages: Vec<_> = packages.into_iter().map(|(kind, payload)| (KINDS[kind], payload)).collect();
        let stream: Vec<u8> = packages.iter().flat_map(|(kind, payload)| bytes_of(*kind, payload)).collect();
        prop_assert_eq!(received(&stream, piece).unwrap(), packages.clone());
        prop_assert_eq!(received(&stream, 1).unwrap(), packages);
    }

    /// Bytes that mean nothing: packages or an error.
    #[test]
    fn any_bytes_are_borne(stream in prop::collection::vec(any::<u8>(), 0..4000), piece in 1..300_usize) {
        let _ = received(&stream, piece);
        let _ = SetupReply::read(&stream);
    }

    /// A good stream with bytes that were changed, taken away or put in.
    #[test]
    fn mutated_packages_are_borne(
        payload in prop::collection::vec(any::<u8>(), 0..200),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..3_u8), 1..8),
    ) {
        let mut stream: Vec<u8> = KINDS.iter().flat_map(|kind| bytes_of(*kind, &payload)).collect();
        for (at, byte, how) in changes {
            let at = at.index(stream.len());
            match how {
                0 => stream[at] = byte,
                1 => drop(stream.remove(at)),
                _ => stream.insert(at, byte),
            }
        }
        let _ = received(&stream, 7);
    }

    /// Values are read where they were written, and beyond the end there are none.
    #[test]
    fn values_have_their_places(values in prop::array::uniform6(-1e6..1e6), number in any::<i32>(), cut in 0..61_usize) {
        let names = ["q", "n", "t"].map(String::from);
        let reply = SetupReply { id: 3, words: ["VECTOR6D", "INT32", "DOUBLE"].map(String::from).to_vec() };
        let recipe = Recipe::new(&names, &reply).unwrap();
        let mut writer = Writer::default();
        writer.begin(PackageType::Data).put(&[3]).joints(&values);
        writer.put(&number.to_be_bytes()).put(&values[0].to_be_bytes());
        let package = writer.package()[3..].to_vec();
        prop_assert!(recipe.fits(&package));
        prop_assert_eq!(Recipe::joints(&package, recipe.place("q", DataType::Vector6D).unwrap()), values);
        prop_assert_eq!(Recipe::int(&package, recipe.place("n", DataType::Int32).unwrap()), number);
        prop_assert_eq!(Recipe::double(&package, recipe.place("t", DataType::Double).unwrap()), values[0]);
        prop_assert_eq!(recipe.place("t", DataType::Int32), None);
        let cut = &package[..cut];
        prop_assert!(!recipe.fits(cut));
        prop_assert!(Recipe::double(cut, 53).is_nan());
    }
}

/// Bytes by the maker's documentation: the first package of every client.
#[test]
fn the_first_package_is_that_of_the_protocol() {
    assert_eq!(bytes_of(PackageType::ProtocolVersion, &2_u16.to_be_bytes()), [0x00, 0x05, 0x56, 0x00, 0x02]);
    let reply = SetupReply::read(b"\x01DOUBLE,VECTOR6D,NOT_FOUND").unwrap();
    assert_eq!((reply.id, reply.words.len()), (1, 3));
    let names = ["timestamp", "actual_q", "colour"].map(String::from);
    assert_eq!(reply.named("NOT_FOUND", &names), ["colour"]);
    assert!(matches!(Recipe::new(&names, &reply), Err(WireError::ValueType { .. })));
    assert!(matches!(Recipe::new(&names[..2], &reply), Err(WireError::Count { asked: 2, got: 3 })));
}

#[test]
fn sizes_below_the_header_and_unknown_types_end_the_stream() {
    let mut framer = Framer::default();
    framer.push(&[0, 2, b'U']);
    assert_eq!(framer.next(), Err(WireError::Size { size: 2 }));
    let mut framer = Framer::default();
    framer.push(&[0, 9, b'Q']);
    assert_eq!(framer.next(), Err(WireError::Type { byte: b'Q' }));
    let mut reader = Reader::new(&[1, 2]);
    assert_eq!(reader.u32("n"), Err(WireError::Short { field: "n" }));
    assert_eq!(reader.u16("n"), Ok(0x0102));
    assert_eq!(reader.end("n"), Ok(()));
}
