//! The code words of AprilTag 25h9: 35 words of 25 bits, from `tag25h9.c` of github.com/AprilRobotics/apriltag (BSD-2-Clause, Copyright (C)
//! 2013-2016, The Regents of The University of Michigan). First bit of the layout highest, 1 = white.
//! The numbers here must be those of that file.

#[rustfmt::skip]
pub(super) const CODES: [u64; 35] = [
    0x156_f1f4, 0x1f2_8cd5, 0x16c_e32c, 0x1ea_379c, 0x139_0f89, 0x034_fad0, 0x07d_cdb5, 0x119_ba95,
    0x1ae_9daa, 0x0df_02aa, 0x082_fc15, 0x046_5123, 0x0ce_ee98, 0x1f1_7260, 0x144_29cd, 0x172_48a8,
    0x16a_d452, 0x096_70ad, 0x16f_65b2, 0x0b8_322b, 0x05d_715b, 0x1a1_c7e7, 0x0d7_890d, 0x181_3522,
    0x1c9_c611, 0x099_e4a4, 0x085_5234, 0x17b_81c0, 0x0c2_94bb, 0x089_fae3, 0x044_df5f, 0x136_0159,
    0x0ec_31e8, 0x1bc_c0f6, 0x0a6_4f8d,
];
