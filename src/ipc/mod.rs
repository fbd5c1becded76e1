//! Everything that touches shared memory between processes: one instance's names and places, every service with
//! its limits, and the few kinds of ports that the processes use.
//!
//! ```text
//! service                    payload                    rate      made by    read by
//! camera/N/frame             [u8] + FrameHeader         camera's  camera     vision
//! camera/N/image             [u8] + ImageHeader         camera's  ext. camera camera
//! camera/N/health            CameraHealth               5 Hz      camera     control
//! vision/N/measurement       Measurement                camera's  vision     control
//! control/joint_state        JointState                 1 kHz     control    camera
//! control/trace              TraceMsg                    1 kHz     control    recorders
//! control/status             Status                     50 Hz     control    supervisor, views
//! control/request            RequestMsg                 on demand control    recorders
//! control/command            ControlCommand, -Answer    on demand ctl        control, which answers
//! drive/command              DriveCommandMsg            1 kHz     control    external drive
//! drive/state                DriveStateMsg              1 kHz     ext. drive control
//! drive/text                 DriveTextMsg               on demand ext. drive control
//! ```
//! All but health, status, trace, request, command and text have an event of the same name beside them that wakes the reader.

mod agreement;
mod caretaker;
mod channel;
mod command;
mod error;
mod frame_shape;
mod image_ports;
mod instance;
mod last_words;
mod ports;
mod runtime_dir;
#[cfg(test)]
pub(crate) use ports::breakage;
mod heartbeat;
mod presence;
mod role;
mod scarcity;
mod services;
mod spin;
mod stop_word;

pub use agreement::{Agreement, Disagreement};
pub use channel::Channel;
pub use command::{Asked, CommandClient, CommandServer, Pending};
pub use error::IpcError;
pub use frame_shape::{FrameShape, SPACE_BESIDE_FRAMES_BYTES, SPACE_OF_MEASUREMENTS_BYTES};
pub use heartbeat::{Heartbeat, TICKS_ARE_OVER};
pub use image_ports::{ImagePorts, ImageSender, ReceivedImage};
pub use instance::{Instance, InstanceError, RoleLock};
pub(crate) use instance::{is_suspended, process_state};
pub use ports::{
    BorrowedFrame, FrameReceiver, FrameSender, QuietFrameReceiver, QuietSender, ReceivedFrame, Receiver,
    Sender, WakeListener, WakeNotifier,
};
pub use presence::{DrivePresence, PeerPresence, Peers, type_of};
pub use role::Role;
pub use scarcity::Scarcity;
pub use services::{DriveViews, MAX_CLIENTS, Services};
pub use spin::Spin;
pub use stop_word::{Halt, RestartCounts, STOP_WORD_OFFSETS, StopWord};

type IpcService = iceoryx2::prelude::ipc::Service;
type Node = iceoryx2::node::Node<IpcService>;
type PubSub<T, H = ()> = iceoryx2::service::port_factory::publish_subscribe::PortFactory<IpcService, T, H>;
