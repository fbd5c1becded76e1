//! Real-time scheduling: SCHED_FIFO, core, locked memory, timer slack; asked for one by one, so that a line can say
//! what was obtained and what the system refused.

use crate::config::RealtimeRequest;
use crate::time::SpanNs;
use rustix::mm::{MlockAllFlags, mlockall};
use rustix::process::setpriority_process;
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity, set_current_timer_slack};
use std::fmt;
use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::num::NonZeroU64;
use thiserror::Error;

/// What the operating system granted. `None` means not asked for.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Obtained {
    /// SCHED_FIFO at the priority.
    pub fifo: Option<Result<u32, String>>,
    /// Bound to the core.
    pub cpu: Option<Result<u32, String>>,
    /// All memory locked.
    pub memory: Option<Result<(), String>>,
}

/// How long a real-time thread spins before its deadlines where nobody says otherwise: about twice the time that a kernel
/// takes to wake it. More brings nothing, a full spin runs into the kernel's throttling of real-time threads.
pub const USUAL_SPIN: SpanNs = SpanNs(50_000);

/// Something that was asked for under policy `enforce` was refused.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error(
    "real-time scheduling was refused: {0}; grant it (`setcap cap_sys_nice,cap_ipc_lock=ep` on the binary, or \
     LimitRTPRIO= and LimitMEMLOCK= of the service) or set realtime.policy = \"try\""
)]
pub struct SchedulingError(pub String);

impl Obtained {
    /// An error when anything that was asked for was refused.
    ///
    /// # Errors
    /// Names all that was refused.
    pub fn require_all(&self) -> Result<(), SchedulingError> {
        let refused: Vec<String> = [
            self.fifo.as_ref().and_then(|r| r.as_ref().err()).map(|e| format!("SCHED_FIFO: {e}")),
            self.cpu.as_ref().and_then(|r| r.as_ref().err()).map(|e| format!("core: {e}")),
            self.memory.as_ref().and_then(|r| r.as_ref().err()).map(|e| format!("locked memory: {e}")),
        ]
        .into_iter()
        .flatten()
        .collect();
        if refused.is_empty() { Ok(()) } else { Err(SchedulingError(refused.join("; "))) }
    }
}

impl fmt::Display for Obtained {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.fifo {
            Some(Ok(priority)) => write!(f, "SCHED_FIFO {priority}")?,
            Some(Err(e)) => write!(f, "normal priority (SCHED_FIFO: {e})")?,
            None => write!(f, "normal priority")?,
        }
        match &self.cpu {
            Some(Ok(cpu)) => write!(f, ", core {cpu}")?,
            Some(Err(e)) => write!(f, ", any core ({e})")?,
            None => write!(f, ", any core")?,
        }
        match &self.memory {
            Some(Ok(())) => write!(f, ", memory locked"),
            Some(Err(e)) => write!(f, ", memory not locked ({e})"),
            None => write!(f, ", memory not locked"),
        }
    }
}

/// Keeps the cores out of idle states that take long to leave, while it lives: waking from them is most of the latency of
/// an idle machine.
#[derive(Debug)]
pub struct Awake {
    _request: File,
}

impl Awake {
    /// Asks the kernel for it; as a rule it listens to root only.
    ///
    /// # Errors
    /// The system's word for the refusal.
    pub fn keep() -> Result<Self, String> {
        let ask = || {
            let mut file = OpenOptions::new().write(true).open("/dev/cpu_dma_latency")?;
            file.write_all(&0_i32.to_ne_bytes())?;
            Ok::<_, std::io::Error>(file)
        };
        ask().map(|file| Self { _request: file }).map_err(|e| e.to_string())
    }
}

/// Why this process cannot run on core `cpu`, in words; `None` where it can, or where the system does not say.
#[must_use]
pub fn why_not_on(cpu: u32) -> Option<String> {
    let set = sched_getaffinity(None).ok()?;
    let cores: Vec<_> = (0..CpuSet::MAX_CPU).filter(|core| set.is_set(*core)).collect();
    if cores.contains(&(cpu as usize)) {
        return None;
    }
    let cores = cores.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
    Some(format!("core {cpu} is not there, or not for this process; it may use {cores}"))
}

/// Locks the memory of the process, where asked. To be called before the threads start.
#[must_use]
pub fn prepare_process(request: &RealtimeRequest) -> Option<Result<(), String>> {
    // ONFAULT: pages are pinned when they are first touched. Locking whole mapped segments at once would make
    // every untouched frame buffer of every service resident.
    request.lock_memory.then(|| {
        mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE | MlockAllFlags::ONFAULT)
            .map_err(|e| e.to_string())
    })
}

/// Gives the calling thread what `request` asks for.
#[must_use]
pub fn prepare_thread(request: &RealtimeRequest) -> Obtained {
    // The least slack that the kernel takes; it only matters when FIFO is refused.
    let _ = set_current_timer_slack(NonZeroU64::new(1));
    Obtained {
        fifo: Some(set_fifo(request.priority).map(|()| request.priority)),
        cpu: request.cpu.map(|cpu| {
            let mut set = CpuSet::new();
            if cpu as usize >= CpuSet::MAX_CPU {
                return Err(format!("core {cpu} does not exist"));
            }
            set.set(cpu as usize);
            sched_setaffinity(None, &set).map(|()| cpu).map_err(|e| format!("core {cpu}: {e}"))
        }),
        memory: None,
    }
}

/// Does `work` on a thread with SCHED_FIFO at `priority`, where that can be had, and waits for it: threads that it starts have the same. 0 asks for nothing.
pub fn with_priority<T: Send>(priority: u32, work: impl FnOnce() -> T + Send) -> T {
    let work = || {
        if priority > 0 {
            // Whom the system refuses has what everybody has.
            let _ = prepare_thread(&RealtimeRequest { priority, cpu: None, lock_memory: false });
        }
        work()
    };
    std::thread::scope(|scope| {
        scope.spawn(work).join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

/// Nice value of what should not wait behind compilers, and is not of the loop. Chosen by hand: about nine times the share of a usual thread (sched(7): a factor of 1.25 a step).
const PREFERRED_NICE: i32 = -10;

/// Puts the calling thread, and those that it starts from then on, before others without real-time priority, and keeps in memory what the process has so far; each as far as the system lets.
pub fn prefer_thread() {
    // Whom the system refuses has what everybody has.
    let _ = setpriority_process(None, PREFERRED_NICE);
    // Without FUTURE: what is allocated later never fails for a limit of locked memory.
    let _ = mlockall(MlockAllFlags::CURRENT | MlockAllFlags::ONFAULT);
}

/// How long a thread that obtained `obtained` spins before its deadlines: as long as `asked`, else [`USUAL_SPIN`] under
/// SCHED_FIFO. Without, other threads would get in between as they do in a sleep.
///
/// Also where there is one core only: what else wants to run waits 50 us in each millisecond.
#[must_use]
pub fn spin_before_deadlines(asked: Option<SpanNs>, obtained: &Obtained) -> SpanNs {
    let fifo = matches!(obtained.fifo, Some(Ok(_)));
    asked.unwrap_or(if fifo { USUAL_SPIN } else { SpanNs::ZERO })
}

#[allow(unsafe_code)]
fn set_fifo(priority: u32) -> Result<(), String> {
    let parameter = libc::sched_param { sched_priority: i32::try_from(priority).map_err(|e| e.to_string())? };
    // SAFETY: the call reads one integer from `parameter`, which lives until it returns; 0 names this thread.
    let result = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &parameter) };
    if result == 0 { Ok(()) } else { Err(std::io::Error::last_os_error().to_string()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_says_what_was_had_and_what_not() {
        let all = Obtained { fifo: Some(Ok(80)), cpu: Some(Ok(1)), memory: Some(Ok(())) };
        assert_eq!(all.to_string(), "SCHED_FIFO 80, core 1, memory locked");
        assert!(all.require_all().is_ok());
        let none = Obtained { fifo: Some(Err("no".into())), cpu: None, memory: Some(Err("full".into())) };
        assert_eq!(none.to_string(), "normal priority (SCHED_FIFO: no), any core, memory not locked (full)");
        let message = none.require_all().unwrap_err().to_string();
        assert!(message.contains("SCHED_FIFO: no; locked memory: full"), "{message}");
    }

    #[test]
    fn threads_spin_as_asked_and_else_where_it_helps() {
        let with = |fifo| Obtained { fifo, ..Obtained::default() };
        let (fifo, refused, off) = (with(Some(Ok(80))), with(Some(Err("no".into()))), with(None));
        assert_eq!(
            [&fifo, &refused, &off].map(|o| spin_before_deadlines(None, o)),
            [USUAL_SPIN, SpanNs::ZERO, SpanNs::ZERO]
        );
        for asked in [SpanNs::ZERO, SpanNs(7_000)] {
            assert_eq!(
                [&fifo, &refused, &off].map(|o| spin_before_deadlines(Some(asked), o)),
                [asked, asked, asked]
            );
        }
    }

    #[test]
    fn a_core_that_does_not_exist_is_refused() {
        let refused = std::thread::Builder::new()
            .name("probe".into())
            .spawn(|| {
                prepare_thread(&RealtimeRequest { priority: 1, cpu: Some(100_000), lock_memory: false })
            })
            .unwrap()
            .join()
            .unwrap();
        assert!(refused.cpu.unwrap().is_err());
    }
}
