//! What the kernel's video interface looks like in memory: records, request numbers and constants of `<linux/videodev2.h>`, for
//! 64-bit machines (x86-64 and aarch64 agree in all of them). The numbers here are the kernel's, as that header has them, and the C compiler's
//! sizes must be ours. Nothing but layout: who calls is `device.rs`.
//!
//! Every record holds plain integers, for which zeroes are a value, and its size is asserted below.

use rustix::ioctl::{Opcode, opcode};

macro_rules! record {
    ($(#[$doc:meta])* $name:ident: $size:literal $([$packed:ident])? {
        $( $(#[$field_doc:meta])* $field:ident : $type:ty, )*
    }) => {
        $(#[$doc])*
        #[repr(C $(, $packed)?)]
        #[derive(Clone, Copy)]
        pub(super) struct $name { $( $(#[$field_doc])* pub(super) $field: $type, )* }

        const _: () = assert!(size_of::<$name>() == $size);

        impl Default for $name {
            #[allow(unsafe_code)]
            fn default() -> Self {
                // SAFETY: integers and arrays of integers alone, for which every bit pattern is a value.
                unsafe { std::mem::zeroed() }
            }
        }
    };
}

record! {
    /// `v4l2_capability`
    AbiCapability: 104 {
        driver: [u8; 16],
        card: [u8; 32],
        bus_info: [u8; 32],
        version: u32,
        capabilities: u32,
        device_caps: u32,
        reserved: [u32; 3],
    }
}

record! {
    /// `v4l2_fmtdesc`
    AbiFormatDescription: 64 {
        index: u32,
        kind: u32,
        flags: u32,
        description: [u8; 32],
        fourcc: u32,
        mbus_code: u32,
        reserved: [u32; 3],
    }
}

record! {
    /// `v4l2_pix_format`
    AbiPixels: 48 {
        width: u32,
        height: u32,
        fourcc: u32,
        field: u32,
        bytes_per_line: u32,
        size_image: u32,
        colorspace: u32,
        private: u32,
        flags: u32,
        encoding: u32,
        quantization: u32,
        transfer: u32,
    }
}

record! {
    /// `v4l2_plane_pix_format`
    AbiPlaneFormat: 20 {
        size_image: u32,
        bytes_per_line: u32,
        reserved: [u16; 6],
    }
}

record! {
    /// `v4l2_pix_format_mplane`
    AbiPixelsPlanar: 192 {
        width: u32,
        height: u32,
        fourcc: u32,
        field: u32,
        colorspace: u32,
        planes: [AbiPlaneFormat; MAX_PLANES],
        num_planes: u8,
        flags: u8,
        encoding: u8,
        quantization: u8,
        transfer: u8,
        reserved: [u8; 7],
    }
}

/// The union of `v4l2_format`; which member counts is said by the kind of queue.
#[repr(C, align(8))]
#[derive(Clone, Copy)]
pub(super) union AbiFormatUnion {
    pub(super) single: AbiPixels,
    pub(super) planar: AbiPixelsPlanar,
    raw: [u8; 200],
}

record! {
    /// `v4l2_format`
    AbiFormat: 208 {
        kind: u32,
        pad: u32,
        format: AbiFormatUnion,
    }
}

record! {
    /// `v4l2_requestbuffers`
    AbiRequestBuffers: 20 {
        count: u32,
        kind: u32,
        memory: u32,
        capabilities: u32,
        flags_and_reserved: u32,
    }
}

record! {
    /// `v4l2_plane`
    AbiPlane: 64 {
        bytes_used: u32,
        length: u32,
        /// Offset to map at, in its low half; or an address, or a descriptor.
        memory: u64,
        data_offset: u32,
        reserved: [u32; 11],
    }
}

record! {
    /// `v4l2_buffer`
    AbiBuffer: 88 {
        index: u32,
        kind: u32,
        bytes_used: u32,
        flags: u32,
        field: u32,
        pad: u32,
        stamp_s: i64,
        stamp_us: i64,
        timecode: [u32; 4],
        sequence: u32,
        memory_kind: u32,
        /// Offset to map at, in its low half; or the address of the planes.
        memory: u64,
        length: u32,
        reserved2: u32,
        request_fd: i32,
        tail: u32,
    }
}

record! {
    /// `v4l2_streamparm` with `v4l2_captureparm` in its union
    AbiStreamParameters: 204 {
        kind: u32,
        capability: u32,
        capture_mode: u32,
        numerator: u32,
        denominator: u32,
        extended_mode: u32,
        read_buffers: u32,
        reserved: [u32; 44],
    }
}

record! {
    /// `v4l2_frmsizeenum`: discrete in the first two of `sizes`, else min, max and step of the width, then of the height
    AbiFrameSize: 44 {
        index: u32,
        fourcc: u32,
        kind: u32,
        sizes: [u32; 6],
        reserved: [u32; 2],
    }
}

record! {
    /// `v4l2_frmivalenum`: fractions; one where discrete, else shortest, longest and step
    AbiFrameInterval: 52 {
        index: u32,
        fourcc: u32,
        width: u32,
        height: u32,
        kind: u32,
        fractions: [[u32; 2]; 3],
        reserved: [u32; 2],
    }
}

record! {
    /// `v4l2_query_ext_ctrl`
    AbiQueryControl: 232 {
        id: u32,
        kind: u32,
        name: [u8; 32],
        minimum: i64,
        maximum: i64,
        step: u64,
        default: i64,
        flags: u32,
        element_size: u32,
        elements: u32,
        dimensions: u32,
        sizes: [u32; 4],
        reserved: [u32; 32],
    }
}

record! {
    /// `v4l2_querymenu`: a name, or a number in its first eight bytes
    AbiQueryMenu: 44 [packed] {
        id: u32,
        index: u32,
        name: [u8; 32],
        reserved: u32,
    }
}

record! {
    /// `v4l2_control`
    AbiControl: 8 {
        id: u32,
        value: i32,
    }
}

record! {
    /// `v4l2_ext_control`
    AbiExtControl: 20 [packed] {
        id: u32,
        size: u32,
        reserved: u32,
        value: i64,
    }
}

record! {
    /// `v4l2_ext_controls`
    AbiExtControls: 32 {
        which: u32,
        count: u32,
        error_index: u32,
        request_fd: i32,
        reserved: u32,
        pad: u32,
        /// Address of the controls.
        controls: u64,
    }
}

record! {
    /// `v4l2_selection`
    AbiSelection: 64 {
        kind: u32,
        target: u32,
        flags: u32,
        left: i32,
        top: i32,
        width: u32,
        height: u32,
        reserved: [u32; 9],
    }
}

/// Most planes that an image may have.
pub(super) const MAX_PLANES: usize = 8;

const V: u8 = b'V';
pub(super) const QUERYCAP: Opcode = opcode::read::<AbiCapability>(V, 0);
pub(super) const ENUM_FMT: Opcode = opcode::read_write::<AbiFormatDescription>(V, 2);
pub(super) const G_FMT: Opcode = opcode::read_write::<AbiFormat>(V, 4);
pub(super) const S_FMT: Opcode = opcode::read_write::<AbiFormat>(V, 5);
pub(super) const REQBUFS: Opcode = opcode::read_write::<AbiRequestBuffers>(V, 8);
pub(super) const QUERYBUF: Opcode = opcode::read_write::<AbiBuffer>(V, 9);
pub(super) const QBUF: Opcode = opcode::read_write::<AbiBuffer>(V, 15);
pub(super) const DQBUF: Opcode = opcode::read_write::<AbiBuffer>(V, 17);
pub(super) const STREAMON: Opcode = opcode::write::<u32>(V, 18);
pub(super) const STREAMOFF: Opcode = opcode::write::<u32>(V, 19);
pub(super) const G_PARM: Opcode = opcode::read_write::<AbiStreamParameters>(V, 21);
pub(super) const S_PARM: Opcode = opcode::read_write::<AbiStreamParameters>(V, 22);
pub(super) const G_CTRL: Opcode = opcode::read_write::<AbiControl>(V, 27);
pub(super) const S_CTRL: Opcode = opcode::read_write::<AbiControl>(V, 28);
pub(super) const QUERYMENU: Opcode = opcode::read_write::<AbiQueryMenu>(V, 37);
pub(super) const S_INPUT: Opcode = opcode::read_write::<u32>(V, 39);
pub(super) const G_EXT_CTRLS: Opcode = opcode::read_write::<AbiExtControls>(V, 71);
pub(super) const S_EXT_CTRLS: Opcode = opcode::read_write::<AbiExtControls>(V, 72);
pub(super) const ENUM_FRAMESIZES: Opcode = opcode::read_write::<AbiFrameSize>(V, 74);
pub(super) const ENUM_FRAMEINTERVALS: Opcode = opcode::read_write::<AbiFrameInterval>(V, 75);
pub(super) const G_SELECTION: Opcode = opcode::read_write::<AbiSelection>(V, 94);
pub(super) const S_SELECTION: Opcode = opcode::read_write::<AbiSelection>(V, 95);
pub(super) const QUERY_EXT_CTRL: Opcode = opcode::read_write::<AbiQueryControl>(V, 103);

/// Bits of a node's capabilities.
pub(super) mod capability {
    pub(in super::super) const CAPTURE: u32 = 0x0000_0001;
    pub(in super::super) const CAPTURE_PLANAR: u32 = 0x0000_1000;
    pub(in super::super) const MEMORY_TO_MEMORY_PLANAR: u32 = 0x0000_4000;
    pub(in super::super) const MEMORY_TO_MEMORY: u32 = 0x0000_8000;
    pub(in super::super) const METADATA_CAPTURE: u32 = 0x0080_0000;
    pub(in super::super) const STREAMING: u32 = 0x0400_0000;
    pub(in super::super) const HAS_DEVICE_CAPS: u32 = 0x8000_0000;
}

/// Kinds of queues.
pub(super) const QUEUE_CAPTURE: u32 = 1;
pub(super) const QUEUE_CAPTURE_PLANAR: u32 = 9;

/// Buffers that the driver allocates and we map.
pub(super) const MEMORY_MMAP: u32 = 1;

/// Bits of `AbiStreamParameters::capability`.
pub(super) const HAS_TIME_PER_FRAME: u32 = 0x1000;

/// Kinds of enumerated sizes and intervals.
pub(super) const DISCRETE: u32 = 1;

/// Of selections.
pub(super) const TARGET_CROP: u32 = 0;
pub(super) const TARGET_CROP_DEFAULT: u32 = 1;

/// Of controls.
pub(super) const NEXT_CONTROL: u32 = 0x8000_0000;

/// Text that ends at its first zero.
pub(super) fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|b| *b == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(bytes.get(..end).unwrap_or_default()).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::mem::offset_of;

    /// The numbers that the kernel's header gives for 64-bit machines; the sizes are asserted where the records are.
    #[test]
    fn request_numbers_are_the_kernel_s() {
        let known = [
            (QUERYCAP, 0x8068_5600_u32),
            (ENUM_FMT, 0xc040_5602),
            (G_FMT, 0xc0d0_5604),
            (S_FMT, 0xc0d0_5605),
            (REQBUFS, 0xc014_5608),
            (QUERYBUF, 0xc058_5609),
            (QBUF, 0xc058_560f),
            (DQBUF, 0xc058_5611),
            (STREAMON, 0x4004_5612),
            (STREAMOFF, 0x4004_5613),
            (G_PARM, 0xc0cc_5615),
            (S_PARM, 0xc0cc_5616),
            (G_CTRL, 0xc008_561b),
            (S_CTRL, 0xc008_561c),
            (QUERYMENU, 0xc02c_5625),
            (S_INPUT, 0xc004_5627),
            (G_EXT_CTRLS, 0xc020_5647),
            (S_EXT_CTRLS, 0xc020_5648),
            (ENUM_FRAMESIZES, 0xc02c_564a),
            (ENUM_FRAMEINTERVALS, 0xc034_564b),
            (G_SELECTION, 0xc040_565e),
            (S_SELECTION, 0xc040_565f),
            (QUERY_EXT_CTRL, 0xc0e8_5667),
        ];
        for (ours, kernel) in known {
            assert_eq!(ours, kernel, "{kernel:#x}");
        }
    }

    #[test]
    fn fields_lie_where_the_kernel_has_them() {
        assert_eq!(offset_of!(AbiFormat, format), 8);
        assert_eq!(offset_of!(AbiPixelsPlanar, planes), 20);
        assert_eq!(offset_of!(AbiPixelsPlanar, num_planes), 180);
        assert_eq!((offset_of!(AbiBuffer, stamp_s), offset_of!(AbiBuffer, sequence)), (24, 56));
        assert_eq!((offset_of!(AbiBuffer, memory), offset_of!(AbiBuffer, length)), (64, 72));
        assert_eq!((offset_of!(AbiPlane, memory), offset_of!(AbiPlane, data_offset)), (8, 16));
        assert_eq!((offset_of!(AbiQueryControl, minimum), offset_of!(AbiQueryControl, flags)), (40, 72));
        assert_eq!((offset_of!(AbiExtControl, value), offset_of!(AbiExtControls, controls)), (12, 24));
        assert_eq!((offset_of!(AbiFrameInterval, fractions), offset_of!(AbiSelection, left)), (20, 12));
    }

    #[test]
    fn text_ends_at_its_zero_or_with_its_field() {
        assert_eq!(text(b"vivid\0\0junk"), "vivid");
        assert_eq!(text(b"full"), "full");
        assert_eq!(text(&[0xff, 0]), "\u{fffd}");
    }
}
