//! Prefaulting: no page fault must happen in the middle of a tick. All private memory of the process is touched
//! before the first tick, and page faults that happen nevertheless are counted.
//!
//! Code, constants, heap and stacks are fetched. Memory that is shared with other processes is not: the real-time thread never
//! touches it, and every buffer of every service would become resident.

use rustix::mm::{Advice, madvise};
use std::hint::black_box;

/// Stack below the caller that is touched where the kernel cannot be asked to fetch it, bytes. Chosen by hand: several times what a tick uses.
const STACK: usize = 256 * 1024;

/// Fetches all memory that the process has now. On kernels before 5.14 only the stack of the calling thread.
pub fn prefault() {
    touch_stack();
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap_or_default();
    for (area, advice) in maps.lines().filter_map(private_area) {
        let _ = fetch(area, advice); // refused: then a tick fetches it, and that is counted
    }
}

/// The address range of a line of `/proc/self/maps`, and how to fetch it; `None` for what is shared, not accessible, or
/// not memory at all.
fn private_area(line: &str) -> Option<((usize, usize), Advice)> {
    let mut words = line.split_ascii_whitespace();
    let (from, to) = words.next()?.split_once('-')?;
    let rights = words.next()?;
    let name = words.nth(3).unwrap_or_default();
    let special = name.starts_with("[v"); // [vvar], [vdso], [vsyscall]: the kernel's own
    let advice = match rights.as_bytes() {
        [_, b'w', _, b'p'] => Advice::LinuxPopulateWrite,
        [b'r', _, _, b'p'] => Advice::LinuxPopulateRead,
        _ => return None,
    };
    let address = |text| usize::from_str_radix(text, 16).ok();
    (!special).then_some(((address(from)?, address(to)?), advice))
}

/// Whether the kernel did it.
#[allow(unsafe_code)]
fn fetch((from, to): (usize, usize), advice: Advice) -> bool {
    let start = std::ptr::with_exposed_provenance_mut(from);
    // SAFETY: fetching changes no byte, and the call refuses what is not mapped any more.
    unsafe { madvise(start, to.saturating_sub(from), advice) }.is_ok()
}

#[inline(never)]
fn touch_stack() {
    black_box(&mut [0u8; STACK]);
}

/// Pages that the calling thread had to fetch so far: from memory and from files.
#[must_use]
#[allow(unsafe_code)]
pub fn page_faults() -> u64 {
    // SAFETY: `rusage` is a record of numbers, for which zero is a valid value.
    let mut usage: libc::rusage = unsafe { std::mem::zeroed() };
    // SAFETY: the call writes one record, which lives until it returns.
    unsafe { libc::getrusage(libc::RUSAGE_THREAD, &mut usage) };
    (usage.ru_minflt + usage.ru_majflt).max(0).unsigned_abs()
}

#[cfg(test)]
#[allow(clippy::print_stdout)]
mod tests {
    use super::*;

    #[test]
    fn memory_of_the_process_itself_is_told_from_shared_memory() {
        let area = |line| private_area(line).map(|((from, to), advice)| (to - from, advice as u32));
        let (read, write) = (Advice::LinuxPopulateRead as u32, Advice::LinuxPopulateWrite as u32);
        assert_eq!(area("7f00-9f00 r-xp 00000000 fe:00 12  /usr/bin/vservo"), Some((0x2000, read)));
        assert_eq!(area("7f00-9f00 rw-p 00000000 00:00 0   [heap]"), Some((0x2000, write)));
        assert_eq!(area("7f00-9f00 rw-p 00000000 00:00 0"), Some((0x2000, write)));
        assert_eq!(area("7f00-9f00 rw-s 00000000 00:19 7   /dev/shm/vservo.a.data"), None);
        assert_eq!(area("7f00-9f00 ---p 00000000 00:00 0"), None);
        assert_eq!(area("7f00-9f00 r--p 00000000 00:00 0   [vvar]"), None);
        assert_eq!(area("nonsense"), None);
    }

    #[test]
    fn memory_that_was_fetched_faults_no_more() {
        const PAGE: usize = 4096;
        // Blocks of more than 32 MB never come from memory that was used before.
        const SIZE: usize = 40 << 20;
        let touch = |bytes: &mut Vec<u8>| {
            let before = page_faults();
            bytes.iter_mut().step_by(PAGE).for_each(|b| *b = 1);
            black_box(bytes);
            page_faults() - before
        };
        let untouched = touch(&mut vec![0u8; SIZE]);
        assert!(untouched > 0, "untouched memory is fetched when it is written");
        let mut fetched = vec![0u8; SIZE];
        let page = fetched.as_ptr().map_addr(|a| (a + PAGE) & !(PAGE - 1)).expose_provenance();
        if !fetch((page, page + PAGE), Advice::LinuxPopulateWrite) {
            println!("skipped: this kernel does not fetch on demand");
            return;
        }
        prefault();
        // The kernel may take a page back meanwhile; without the call all would be fetched now.
        assert!(touch(&mut fetched) <= untouched / 4);
    }
}
