//! What a caller in C gets instead of a panic or an error: a code, and words that it can ask for.

use std::cell::RefCell;
use std::ffi::{CStr, CString};
use std::os::raw::c_char;
use std::panic::{AssertUnwindSafe, catch_unwind};
use vservo::ipc::IpcError;

/// What is said of a panic, whose own words the hook of the process has printed.
const PANIC: &str = "a defect of this library; brake, and end";

/// The errors of `vservo_drive.h`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(i32)]
pub enum ErrorCode {
    /// A pointer, a text or a count that cannot be.
    Argument = -1,
    /// A number that is not finite, or not one of its kind.
    Value = -2,
    /// Shared memory or the transport failed.
    Transport = -3,
    /// Another thread than the one that opened the handle.
    Thread = -4,
    /// A panic.
    Internal = -5,
}

/// An error on its way to the caller.
#[derive(Debug)]
pub(crate) struct Failure {
    pub(crate) code: ErrorCode,
    pub(crate) words: String,
}

impl Failure {
    pub(crate) fn argument(words: impl Into<String>) -> Self {
        Self { code: ErrorCode::Argument, words: words.into() }
    }

    pub(crate) fn value(words: impl Into<String>) -> Self {
        Self { code: ErrorCode::Value, words: words.into() }
    }

    pub(crate) fn transport(cause: impl ToString) -> Self {
        Self { code: ErrorCode::Transport, words: cause.to_string() }
    }
}

impl From<IpcError> for Failure {
    fn from(error: IpcError) -> Self {
        Self::transport(error)
    }
}

thread_local! {
    static LAST: RefCell<CString> = RefCell::default();
}

/// Keeps the words for this thread. Bytes that would end a text in C are left out.
fn keep(words: &str) {
    let bytes: Vec<u8> = words.bytes().filter(|byte| *byte != 0).collect();
    LAST.with_borrow_mut(|last| *last = CString::new(bytes).unwrap_or_default());
}

/// The words that were kept last in this thread.
pub(crate) fn last_words() -> *const c_char {
    // A thread that is about to end has forgotten them.
    LAST.try_with(|last| last.try_borrow().map_or(c"".as_ptr(), |last| last.as_ptr())).unwrap_or(c"".as_ptr())
}

/// Lets neither an error nor a panic through: the value, or what `of_error` makes of the code, whose words are kept.
pub(crate) fn guarded<T>(
    work: impl FnOnce() -> Result<T, Failure>,
    of_error: impl FnOnce(ErrorCode) -> T,
) -> T {
    let failure = match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(value)) => return value,
        Ok(Err(failure)) => failure,
        Err(_) => Failure { code: ErrorCode::Internal, words: PANIC.into() },
    };
    // The words may be lost in a thread that ends; the code is not.
    let _ = catch_unwind(|| keep(&failure.words));
    of_error(failure.code)
}

/// A text of the caller.
///
/// # Safety
/// `text` is null, or a text that ends with a zero byte and stays as it is while it is used.
pub(crate) unsafe fn text_of<'a>(text: *const c_char, what: &str) -> Result<&'a CStr, Failure> {
    if text.is_null() {
        return Err(Failure::argument(format!("{what} is NULL")));
    }
    // SAFETY: it is not null, and the caller promises the rest.
    Ok(unsafe { CStr::from_ptr(text) })
}

/// A text of the caller that must be UTF-8.
///
/// # Safety
/// As [`text_of`].
pub(crate) unsafe fn utf8_of<'a>(text: *const c_char, what: &str) -> Result<&'a str, Failure> {
    // SAFETY: the caller promises what is needed there.
    let text = unsafe { text_of(text, what) }?;
    text.to_str().map_err(|_| Failure::argument(format!("{what} is no UTF-8")))
}
