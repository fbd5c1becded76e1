//! The settings that decide over punctuality, one function each.

use super::DoctorCheck;
use crate::config::RealtimeRequest;
use crate::rt::prepare_thread;
use rustix::fs::statvfs;
use rustix::process::{Resource, getrlimit};
use rustix::time::{ClockId, clock_getres};
use std::fs;

/// Free shared memory that `doctor` asks for. Chosen by hand: a run of the default size needs about 25 MB, and a second one must fit too.
const SHARED_MEMORY_WANTED: u64 = 64 << 20;

pub(super) fn all() -> Vec<DoctorCheck> {
    // The cheapest remedy first, which the verdict names: a right, a setting, an option of the boot, another kernel.
    vec![
        fifo(),
        locked_memory(),
        shared_memory(),
        governor(),
        throttling(),
        clock_source(),
        timer_resolution(),
        isolated_cores(),
        preemption(),
    ]
}

fn good(name: &'static str, found: impl Into<String>) -> DoctorCheck {
    DoctorCheck { name, ok: true, found: found.into(), remedy: None }
}

fn bad(name: &'static str, found: impl Into<String>, remedy: &'static str) -> DoctorCheck {
    DoctorCheck { name, ok: false, found: found.into(), remedy: Some(remedy) }
}

fn read(path: &str) -> Option<String> {
    fs::read_to_string(path).ok().map(|s| s.trim().to_string())
}

fn preemption() -> DoctorCheck {
    let name = "kernel preemption";
    let version = read("/proc/sys/kernel/version").unwrap_or_default();
    if read("/sys/kernel/realtime").as_deref() == Some("1") || version.contains("PREEMPT_RT") {
        return good(name, "PREEMPT_RT");
    }
    let model =
        ["PREEMPT_DYNAMIC", "PREEMPT"].into_iter().find(|m| version.contains(m)).unwrap_or("not preemptible");
    bad(
        name,
        model,
        "a PREEMPT_RT kernel (Debian: linux-image-rt-amd64) bounds the wake-up latency; without it, single late ticks",
    )
}

fn throttling() -> DoctorCheck {
    let name = "RT throttling";
    match (read("/proc/sys/kernel/sched_rt_runtime_us"), read("/proc/sys/kernel/sched_rt_period_us")) {
        (Some(runtime), _) if runtime == "-1" => good(name, "off"),
        // The control thread needs some percent of its core: the usual 95 % never bite.
        (Some(runtime), Some(period)) => {
            let share = runtime.parse::<f64>().unwrap_or(0.0) / period.parse::<f64>().unwrap_or(1.0);
            let found = format!("{runtime} us of {period} us");
            if share >= 0.5 {
                good(name, found)
            } else {
                bad(name, found, "sysctl kernel.sched_rt_runtime_us=950000")
            }
        }
        _ => good(name, "not in this kernel"),
    }
}

fn fifo() -> DoctorCheck {
    let name = "SCHED_FIFO";
    let request = RealtimeRequest { priority: 80, cpu: None, lock_memory: false };
    let limit = getrlimit(Resource::Rtprio).current;
    let limit = limit.map_or("unlimited".to_string(), |l| l.to_string());
    let granted = std::thread::Builder::new()
        .name("fifo-probe".into())
        .spawn(move || prepare_thread(&request).fifo)
        .ok()
        .and_then(|t| t.join().ok())
        .flatten();
    match granted {
        Some(Ok(_)) => good(name, format!("priority 80 granted (rtprio limit {limit})")),
        Some(Err(e)) => bad(
            name,
            format!("refused: {e} (rtprio limit {limit})"),
            "setcap cap_sys_nice,cap_ipc_lock=ep on the binary, or `rtprio 98` in /etc/security/limits.conf, or LimitRTPRIO=98",
        ),
        None => bad(name, "could not be tried", "look at the limits of threads"),
    }
}

fn locked_memory() -> DoctorCheck {
    let name = "locked memory";
    match getrlimit(Resource::Memlock).current {
        None => good(name, "unlimited"),
        Some(bytes) if rustix::process::geteuid().is_root() => {
            good(name, format!("limit {} kB, does not bind root", bytes >> 10))
        }
        Some(bytes) if bytes >= SHARED_MEMORY_WANTED => good(name, format!("limit {} kB", bytes >> 10)),
        Some(bytes) => bad(
            name,
            format!("limit {} kB", bytes >> 10),
            "`memlock unlimited` in /etc/security/limits.conf, or LimitMEMLOCK=infinity",
        ),
    }
}

fn governor() -> DoctorCheck {
    let name = "CPU governor";
    let mut found: Vec<String> = (0..)
        .map_while(|cpu| {
            let folder = format!("/sys/devices/system/cpu/cpu{cpu}");
            fs::metadata(&folder).ok().map(|_| read(&format!("{folder}/cpufreq/scaling_governor")))
        })
        .flatten()
        .collect();
    found.sort();
    found.dedup();
    if found.is_empty() {
        return good(name, "no frequency scaling");
    }
    let all = found.join(", ");
    if all == "performance" {
        good(name, all)
    } else {
        bad(name, all, "cpupower frequency-set -g performance")
    }
}

fn timer_resolution() -> DoctorCheck {
    let name = "timer resolution";
    let t = clock_getres(ClockId::Monotonic);
    let ns = t.tv_sec * 1_000_000_000 + t.tv_nsec;
    if ns <= 1_000 {
        good(name, format!("{ns} ns"))
    } else {
        bad(name, format!("{ns} ns"), "a kernel with high-resolution timers (CONFIG_HIGH_RES_TIMERS)")
    }
}

fn clock_source() -> DoctorCheck {
    let name = "clock source";
    match read("/sys/devices/system/clocksource/clocksource0/current_clocksource") {
        Some(source) if ["tsc", "kvm-clock", "arch_sys_counter"].contains(&source.as_str()) => {
            good(name, source)
        }
        Some(source) => bad(
            name,
            source,
            "reading it needs a system call; boot with clocksource=tsc where the TSC is stable",
        ),
        None => good(name, "unknown"),
    }
}

fn shared_memory() -> DoctorCheck {
    let name = "/dev/shm";
    match statvfs("/dev/shm") {
        Ok(s) => {
            let (free, size) = (s.f_bavail * s.f_frsize, s.f_blocks * s.f_frsize);
            let found = format!("{} MB free of {} MB", free >> 20, size >> 20);
            if free >= SHARED_MEMORY_WANTED {
                good(name, found)
            } else {
                bad(name, found, "mount -o remount,size=256M /dev/shm (containers: --shm-size=256m)")
            }
        }
        Err(e) => bad(name, e.to_string(), "mount a tmpfs on /dev/shm"),
    }
}

fn isolated_cores() -> DoctorCheck {
    let name = "isolated cores";
    match read("/sys/devices/system/cpu/isolated") {
        Some(cores) if !cores.is_empty() => good(name, format!("{cores}; set realtime.cpu to one of them")),
        _ => bad(
            name,
            "none",
            "boot with isolcpus=N (or cpusets) and set realtime.cpu = N to keep other work off the core",
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_check_says_what_it_found_and_every_warning_what_to_do() {
        let checks = all();
        assert_eq!(checks.len(), 9);
        for c in checks {
            assert!(!c.found.is_empty(), "{}", c.name);
            assert_eq!(c.ok, c.remedy.is_none(), "{}", c.name);
        }
    }
}
