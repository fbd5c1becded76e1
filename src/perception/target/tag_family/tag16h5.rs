//! The code words of AprilTag 16h5: 30 words of 16 bits, from `tag16h5.c` of github.com/AprilRobotics/apriltag (BSD-2-Clause, Copyright (C)
//! 2013-2016, The Regents of The University of Michigan). First bit of the layout highest, 1 = white.
//! The numbers here must be those of that file.

#[rustfmt::skip]
pub(super) const CODES: [u64; 30] = [
    0x27c8, 0x31b6, 0x3859, 0x569c, 0x6c76, 0x7ddb, 0xaf09, 0xf5a1, 0xfb8b, 0x1cb9, 0x28ca, 0xe8dc, 0x1426,
    0x5770, 0x9253, 0xb702, 0x063a, 0x8f34, 0xb4c0, 0x51ec, 0xe6f0, 0x5fa4, 0xdd43, 0x1aaa, 0xe62f, 0x6dbc,
    0xb6eb, 0xde10, 0x154d, 0xb57a,
];
