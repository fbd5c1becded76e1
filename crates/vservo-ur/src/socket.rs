//! What a read of a socket has come to, the same for both ends of every connection.

use std::io::{Error, ErrorKind, Read, Result};

/// Reads what comes within the socket's read time-out; none when nothing came.
///
/// # Errors
/// When the other end is gone.
pub(crate) fn receive(stream: &mut impl Read, room: &mut [u8]) -> Result<Option<usize>> {
    match stream.read(room) {
        Ok(0) => Err(Error::new(ErrorKind::UnexpectedEof, "end of the stream")),
        Ok(count) => Ok(Some(count)),
        Err(e)
            if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted) =>
        {
            Ok(None)
        }
        Err(e) => Err(e),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A stream that has one thing to say.
    struct Once(Result<usize>);

    impl Read for Once {
        fn read(&mut self, _: &mut [u8]) -> Result<usize> {
            std::mem::replace(&mut self.0, Ok(0))
        }
    }

    #[test]
    fn nothing_yet_is_told_from_an_end() {
        let read = |result| receive(&mut Once(result), &mut [0; 4]);
        assert_eq!(read(Ok(3)).unwrap(), Some(3));
        for kind in [ErrorKind::WouldBlock, ErrorKind::TimedOut, ErrorKind::Interrupted] {
            assert_eq!(read(Err(kind.into())).unwrap(), None, "{kind}");
        }
        assert_eq!(read(Ok(0)).unwrap_err().to_string(), "end of the stream");
        assert_eq!(
            read(Err(ErrorKind::ConnectionReset.into())).unwrap_err().kind(),
            ErrorKind::ConnectionReset
        );
    }
}
