//! The bytes of a pickle file: read in order, with long strings left where they are.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// Strings of more bytes than this stay in the file.
const INLINE: u64 = 512;

/// A text line of protocol 0 may hold a whole array.
const MAX_LINE: u64 = 256 << 20;

/// What is wrong, and at which byte of the file.
#[derive(Debug)]
pub(super) struct Fault {
    pub position: u64,
    pub expected: String,
    pub found: String,
}

/// A pickle file with a read position.
pub(super) struct Source {
    reader: BufReader<File>,
    position: u64,
    len: u64,
}

/// A string: in memory if short, else a range of the file.
#[derive(Clone, Debug)]
pub(super) struct Stored {
    bytes: Bytes,
    /// Text in UTF-8. numpy's bytes may travel so: the code points, all below 256, are the bytes.
    pub utf8: bool,
}

#[derive(Clone, Debug)]
enum Bytes {
    Here(Box<[u8]>),
    InFile { start: u64, len: u64 },
}

impl Source {
    pub fn open(path: &Path) -> io::Result<Self> {
        let file = File::open(path)?;
        let len = file.metadata()?.len();
        Ok(Self {
            reader: BufReader::with_capacity(1 << 16, file),
            position: 0,
            len,
        })
    }

    pub fn fault<T>(
        &self,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Result<T, Fault> {
        Err(Fault {
            position: self.position,
            expected: expected.into(),
            found: found.into(),
        })
    }

    /// Checks that `len` bytes follow.
    pub fn require(&self, len: u64, what: &str) -> Result<(), Fault> {
        let rest = self.len.saturating_sub(self.position);
        if len > rest {
            let found = format!("the end of the file after {rest} (truncated or not a pickle)");
            return self.fault(format!("{len} bytes of {what}"), found);
        }
        Ok(())
    }

    /// The next `N` bytes.
    pub fn take<const N: usize>(&mut self, what: &str) -> Result<[u8; N], Fault> {
        self.require(N as u64, what)?;
        let mut bytes = [0; N];
        self.read(&mut bytes)?;
        Ok(bytes)
    }

    /// The text up to the end of the line, without it.
    pub fn line(&mut self, what: &str) -> Result<Vec<u8>, Fault> {
        let mut bytes = Vec::new();
        let read = (&mut self.reader)
            .take(MAX_LINE)
            .read_until(b'\n', &mut bytes);
        if let Err(error) = read {
            return self.fault(format!("a line with {what}"), error.to_string());
        }
        if bytes.pop() != Some(b'\n') {
            let found = format!("no end of the line within {} bytes", bytes.len());
            return self.fault(format!("a line with {what}"), found);
        }
        self.position += bytes.len() as u64 + 1;
        Ok(bytes)
    }

    /// The next `len` bytes as a string.
    pub fn string(&mut self, len: u64, utf8: bool) -> Result<Stored, Fault> {
        self.require(len, "a string")?;
        let bytes = if len <= INLINE {
            let mut bytes = vec![0; len as usize];
            self.read(&mut bytes)?;
            Bytes::Here(bytes.into())
        } else {
            let start = self.position;
            // Lengths are below the file's size, which fits an i64.
            if let Err(error) = self.reader.seek_relative(len as i64) {
                return self.fault("a readable file", error.to_string());
            }
            self.position += len;
            Bytes::InFile { start, len }
        };
        Ok(Stored { bytes, utf8 })
    }

    fn read(&mut self, bytes: &mut [u8]) -> Result<(), Fault> {
        if let Err(error) = self.reader.read_exact(bytes) {
            return self.fault("a readable file", error.to_string());
        }
        self.position += bytes.len() as u64;
        Ok(())
    }
}

impl Stored {
    /// A string that the file spells out in another way (protocol 0).
    pub fn here(bytes: Vec<u8>, utf8: bool) -> Self {
        Self {
            bytes: Bytes::Here(bytes.into()),
            utf8,
        }
    }

    /// Number of bytes as stored: UTF-8 may take two for one.
    pub fn len(&self) -> u64 {
        match &self.bytes {
            Bytes::Here(bytes) => bytes.len() as u64,
            Bytes::InFile { len, .. } => *len,
        }
    }

    /// Bytes it takes in memory.
    pub fn memory(&self) -> usize {
        match &self.bytes {
            Bytes::Here(bytes) => bytes.len(),
            Bytes::InFile { .. } => 0,
        }
    }

    /// The text, if it is short (names and keys are).
    pub fn text(&self) -> Option<String> {
        match &self.bytes {
            Bytes::Here(bytes) if self.utf8 => String::from_utf8(bytes.to_vec()).ok(),
            Bytes::Here(bytes) => Some(bytes.iter().copied().map(char::from).collect()),
            Bytes::InFile { .. } => None,
        }
    }

    /// The bytes, if they are few (those of a number are).
    pub fn short_bytes(&self) -> Option<Vec<u8>> {
        let Bytes::Here(bytes) = &self.bytes else {
            return None;
        };
        if !self.utf8 {
            return Some(bytes.to_vec());
        }
        let text = str::from_utf8(bytes).ok()?;
        text.chars().map(|c| u8::try_from(c).ok()).collect()
    }

    /// The bytes, one after the other, from the file at `path`.
    pub fn reader(&self, path: &Path) -> io::Result<Box<dyn Read>> {
        let plain: Box<dyn BufRead> = match &self.bytes {
            Bytes::Here(bytes) => Box::new(io::Cursor::new(bytes.clone())),
            Bytes::InFile { start, len } => {
                let mut file = File::open(path)?;
                file.seek(SeekFrom::Start(*start))?;
                Box::new(BufReader::with_capacity(1 << 16, file.take(*len)))
            }
        };
        Ok(if self.utf8 {
            Box::new(Latin1 { utf8: plain })
        } else {
            Box::new(plain)
        })
    }
}

/// Code points of a UTF-8 text as bytes.
struct Latin1 {
    utf8: Box<dyn BufRead>,
}

impl Read for Latin1 {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let mut done = 0;
        while done < out.len() {
            let available = self.utf8.fill_buf()?;
            let Some(&lead) = available.first() else {
                break;
            };
            if lead < 0x80 {
                let run = available
                    .iter()
                    .zip(&mut out[done..])
                    .take_while(|(byte, _)| **byte < 0x80)
                    .map(|(byte, out)| *out = *byte)
                    .count();
                self.utf8.consume(run);
                done += run;
                continue;
            }
            let mut pair = [0; 2];
            self.utf8.read_exact(&mut pair)?;
            // U+0080 to U+00FF are 0xC2 or 0xC3 and one continuation byte.
            if !matches!(pair[0], 0xC2 | 0xC3) || pair[1] & 0xC0 != 0x80 {
                let message = "text that is no Latin-1 bytes";
                return Err(io::Error::new(io::ErrorKind::InvalidData, message));
            }
            out[done] = (pair[0] & 3) << 6 | pair[1] & 0x3F;
            done += 1;
        }
        Ok(done)
    }
}
