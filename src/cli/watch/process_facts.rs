//! What the processes of a run take of the machine, as /proc tells it to everybody: nothing is asked of them.

use crate::ipc::Instance;
use crate::monitor::ProcessRow;
use crate::time::{MonoNs, SpanNs};
use std::collections::BTreeMap;
use std::path::Path;

/// Period of looks. Chosen by hand: a look reads the command lines of all processes of the machine, some milliseconds, and shares over a second are steady.
const PERIOD: SpanNs = SpanNs(1_000_000_000);
/// Ticks in a second of /proc: USER_HZ, which is a part of the kernel's interface and 100 on x86 and arm.
const TICKS_PER_S: f64 = 100.0;
/// Commands that take part in a run, or look at it for long; the shells and clients of a moment are left out.
const COMMANDS: [&str; 8] = ["run", "serve", "camera", "vision", "control", "record", "monitor", "watch"];

/// The processes of an instance, looked at now and then.
#[derive(Debug)]
pub(super) struct ProcessFacts {
    instance: String,
    next: MonoNs,
    /// Processor time of each process, s, at its time.
    before: BTreeMap<u32, (f64, MonoNs)>,
    rows: Vec<ProcessRow>,
}

impl ProcessFacts {
    pub(super) fn of(instance: &Instance) -> Self {
        Self { instance: instance.to_string(), next: MonoNs::ZERO, before: BTreeMap::new(), rows: Vec::new() }
    }

    /// The processes as they were at the last look, which is now where that was too long ago.
    pub(super) fn rows(&mut self, now: MonoNs) -> Vec<ProcessRow> {
        if now >= self.next {
            self.next = now + PERIOD;
            self.look(now);
        }
        self.rows.clone()
    }

    fn look(&mut self, now: MonoNs) {
        let (mut rows, mut times) = (Vec::new(), BTreeMap::new());
        for entry in std::fs::read_dir("/proc").into_iter().flatten().flatten() {
            let Some(pid) = entry.file_name().to_str().and_then(|name| name.parse::<u32>().ok()) else {
                continue;
            };
            let read = |name: &str| std::fs::read(Path::new("/proc").join(pid.to_string()).join(name)).ok();
            let Some(role) = read("cmdline").and_then(|line| role_of(&line, &self.instance)) else {
                continue;
            };
            // It may have ended meanwhile.
            let Some((cpu_s, memory_mb)) =
                read("stat").and_then(|s| cpu_s(&s)).zip(read("status").and_then(|s| memory_mb(&s)))
            else {
                continue;
            };
            let share = |(before_s, then): &(f64, MonoNs)| (cpu_s - before_s).max(0.0) / (now - *then).as_s();
            let core_share = self.before.get(&pid).map(share).filter(|share| share.is_finite());
            times.insert(pid, (cpu_s, now));
            rows.push(ProcessRow { role, pid, core_share, memory_mb });
        }
        rows.sort_by_key(|row| (COMMANDS.iter().position(|word| *word == row.role), row.pid));
        (self.rows, self.before) = (rows, times);
    }
}

/// The role of a process of `instance` by its command line; `None` where it is none.
fn role_of(line: &[u8], instance: &str) -> Option<String> {
    let text = std::str::from_utf8(line).ok()?;
    let mut words = text.split('\0');
    let program = words.next()?.rsplit('/').next()?;
    let words: Vec<&str> = words.collect();
    let role = match program.strip_prefix("vservo")? {
        // `vservo` alone, or with a run file, is `vservo run`
        "" => words.first().filter(|word| COMMANDS.contains(word)).copied().or_else(|| {
            let is_run = words.first().is_none_or(|w| w.is_empty() || w.starts_with("--") || w.contains('.'));
            is_run.then_some("run")
        })?,
        rest => rest.strip_prefix('-')?,
    };
    let beside = |pair: &[&str]| match pair {
        ["--instance", name] => Some((*name).to_owned()),
        [word, ..] => word.strip_prefix("--instance=").map(str::to_owned),
        [] => None,
    };
    let named = words.windows(2).find_map(beside);
    (named.as_deref().unwrap_or("default") == instance).then(|| role.to_owned())
}

/// Processor time of all its threads, from `stat`: fields 14 and 15, counted behind the name, which may hold anything.
fn cpu_s(stat: &[u8]) -> Option<f64> {
    let text = String::from_utf8_lossy(stat);
    let mut fields = text.rsplit_once(") ")?.1.split(' ').skip(11);
    let mut ticks = || fields.next()?.parse::<f64>().ok();
    Some((ticks()? + ticks()?) / TICKS_PER_S)
}

/// Resident memory, from `status`, which has it in kB of 1024 bytes.
fn memory_mb(status: &[u8]) -> Option<f64> {
    let text = String::from_utf8_lossy(status);
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    Some(line.split_whitespace().next()?.parse::<f64>().ok()? * 1024.0 * 1e-6)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processes_are_told_by_their_command_lines() {
        let role = |line: &str| role_of(line.replace(' ', "\0").as_bytes(), "cell");
        assert_eq!(role("/usr/bin/vservo camera --instance cell --camera 1 ").as_deref(), Some("camera"));
        assert_eq!(role("vservo-vision --instance=cell ").as_deref(), Some("vision"));
        assert_eq!(role("vservo ur5.toml --instance cell ").as_deref(), Some("run"));
        assert_eq!(role("vservo --instance cell ").as_deref(), Some("run"));
        for other in [
            "vservo ctl status --instance cell ",
            "vservo control --instance cell2 ",
            "vservo control ",
            "vim --instance cell ",
            "",
        ] {
            assert_eq!(role(other), None, "{other}");
        }
        assert_eq!(role_of(b"vservo\0serve\0", "default").as_deref(), Some("serve"));
    }

    #[test]
    fn proc_is_read_whatever_a_process_is_called() {
        let stat = b"12 (a ) b) S 1 2 3 4 5 6 7 8 9 10 150 50 0 0 20 0";
        assert_eq!(cpu_s(stat), Some(2.0));
        assert_eq!(memory_mb(b"Name:\tx\nVmRSS:\t    1000 kB\n"), Some(1.024));
        assert_eq!((cpu_s(b"nothing"), memory_mb(b"nothing")), (None, None));
    }
}
