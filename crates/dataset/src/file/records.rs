//! The MCAP records that reading needs, parsed without trusting a length: nothing is
//! allocated before the bytes for it are seen. (`mcap`'s own parser reserves what a
//! string says its length is, up to 4 GB for a file of a few bytes.)

use mcap::records::op;

/// Opcode and length before each record.
pub(super) const RECORD_HEAD: usize = 9;

/// A record, borrowed from the file's bytes.
pub(super) enum Record<'a> {
    Schema {
        id: u16,
        name: &'a str,
    },
    Channel {
        id: u16,
        schema_id: u16,
        topic: &'a str,
        encoding: &'a str,
    },
    ChunkIndex(ChunkPlace),
    Chunk {
        crc: u32,
        compression: &'a str,
        records: &'a [u8],
    },
    Message {
        head: MessageHead,
        data: &'a [u8],
    },
    Footer {
        summary_start: u64,
        crc: u32,
    },
    /// Whatever else there may be.
    Other,
}

/// Where a chunk is, and of which channels it has messages.
#[derive(Clone, Debug)]
pub(super) struct ChunkPlace {
    pub(super) start: u64,
    pub(super) length: u64,
    pub(super) channels: Vec<u16>,
}

/// What stands before a message.
#[derive(Clone, Copy)]
pub(super) struct MessageHead {
    pub(super) channel: u16,
    pub(super) sequence: u32,
}

/// Takes the first record off `bytes`; `None` when there is none.
pub(super) fn next_record<'a>(bytes: &mut &'a [u8]) -> Option<Record<'a>> {
    let (&opcode, rest) = bytes.split_first()?;
    let mut fields = Fields(rest);
    let body = fields.sized(|fields| fields.u64())?;
    *bytes = fields.0;
    parse(opcode, Fields(body))
}

fn parse(opcode: u8, mut body: Fields<'_>) -> Option<Record<'_>> {
    Some(match opcode {
        op::SCHEMA => Record::Schema {
            id: body.u16()?,
            name: body.text()?,
        },
        op::CHANNEL => Record::Channel {
            id: body.u16()?,
            schema_id: body.u16()?,
            topic: body.text()?,
            encoding: body.text()?,
        },
        op::CHUNK_INDEX => {
            let _times = body.take(16)?;
            let (start, length) = (body.u64()?, body.u64()?);
            let offsets = body.sized(|body| body.u32().map(u64::from))?;
            let (offsets, rest) = offsets.as_chunks::<10>();
            if !rest.is_empty() {
                return None;
            }
            let channel = |offset: &[u8; 10]| u16::from_le_bytes([offset[0], offset[1]]);
            let channels = offsets.iter().map(channel).collect();
            Record::ChunkIndex(ChunkPlace {
                start,
                length,
                channels,
            })
        }
        op::CHUNK => {
            let _times_and_size = body.take(24)?;
            Record::Chunk {
                crc: body.u32()?,
                compression: body.text()?,
                records: body.sized(|body| body.u64())?,
            }
        }
        op::MESSAGE => {
            let (channel, sequence) = (body.u16()?, body.u32()?);
            let _times = body.take(16)?;
            let head = MessageHead { channel, sequence };
            Record::Message { head, data: body.0 }
        }
        op::FOOTER => {
            let summary_start = body.u64()?;
            let _summary_offset_start = body.u64()?;
            let crc = body.u32()?;
            Record::Footer { summary_start, crc }
        }
        _ => Record::Other,
    })
}

/// Little-endian fields, taken from the front.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(taken)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.take(N)?.try_into().ok()
    }

    fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    /// Bytes behind their length.
    fn sized(&mut self, length: impl Fn(&mut Self) -> Option<u64>) -> Option<&'a [u8]> {
        let length = usize::try_from(length(self)?).ok()?;
        self.take(length)
    }

    fn text(&mut self) -> Option<&'a str> {
        std::str::from_utf8(self.sized(|fields| fields.u32().map(u64::from))?).ok()
    }
}
