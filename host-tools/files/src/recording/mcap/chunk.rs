//! Chunk of an MCAP file: compressed records with one CRC.

use std::io::{Cursor, Read};

use mcap::McapError;
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use ruzstd::decoding::FrameDecoder;

use super::container::number;

/// Longest accepted content of a chunk in bytes, far above this writer's own.
const LONGEST: usize = 64 << 20;
/// Place of the compression's name, after both times, size, CRC and the name's length.
const NAME_AT: usize = 32;

/// Record of a chunk, as it stands in the file without code and length.
#[derive(Clone)]
pub(super) struct Chunk(pub(super) Vec<u8>);

impl Chunk {
    /// Length of all that stands before a chunk's content, for the longest name of a compression.
    pub(super) const HEADER: u64 = NAME_AT as u64 + 4 + 8;

    /// Computes the length of a chunk's record from that of its content.
    pub(super) fn length(data: &[u8]) -> Option<u64> {
        let at = content_length_at(data)?;
        number(data, at, 8)?.checked_add(at as u64 + 8)
    }

    /// Sets the length of the content to what the record has; fails if it has none.
    pub(super) fn set_length(&mut self) -> bool {
        let Some(at) = content_length_at(&self.0) else { return false };
        let Some(content) = self.0.len().checked_sub(at + 8) else { return false };
        if let Some(length) = self.0.get_mut(at..at + 8) {
            length.copy_from_slice(&(content as u64).to_le_bytes());
        }
        true
    }

    /// Decompresses the records after their CRC is checked.
    pub(super) fn records(&self) -> Result<Records, McapError> {
        let decompressed = self.without_zstd()?;
        let data = decompressed.as_ref().map_or(self.0.as_slice(), Vec::as_slice);
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(LONGEST);
        let length = (data.len() as u64).to_le_bytes();
        let bytes = [&[op::CHUNK], length.as_slice(), data].concat();
        let reader = LinearReader::new_with_options(options);
        let mut records = Records { reader, bytes: Cursor::new(bytes), first: None };
        records.first = records.read().transpose()?;
        Ok(records)
    }

    /// Decompresses a chunk of zstd, which other programs write.
    fn without_zstd(&self) -> Result<Option<Vec<u8>>, McapError> {
        let Record::Chunk { header, data } = mcap::parse_record(op::CHUNK, &self.0)? else {
            return Ok(None);
        };
        if header.compression != "zstd" {
            return Ok(None);
        }
        let wrong = McapError::DecompressionError;
        let mut content = usize::try_from(header.uncompressed_size)
            .ok()
            .filter(|size| *size <= LONGEST)
            .map(|size| vec![0; size])
            .ok_or_else(|| wrong(format!("{} bytes in a chunk", header.uncompressed_size)))?;
        let decoded = FrameDecoder::new().decode_all(&data, &mut content);
        let decoded = decoded.map_err(|error| wrong(error.to_string()))?;
        content.truncate(decoded);
        // Times, size and CRC stay; the compression has no name.
        let (same, name, length) = (&self.0[..NAME_AT - 4], [0; 4], decoded as u64);
        Ok(Some([same, &name, &length.to_le_bytes(), &content].concat()))
    }
}

/// Returns where the content's length stands, behind the compression's name.
fn content_length_at(data: &[u8]) -> Option<usize> {
    NAME_AT.checked_add(usize::try_from(number(data, NAME_AT - 4, 4)?).ok()?)
}

/// Records of a chunk, one at a time.
pub(super) struct Records {
    reader: LinearReader,
    bytes: Cursor<Vec<u8>>,
    /// First record, read for the check of the CRC.
    first: Option<Record<'static>>,
}

impl Records {
    fn read(&mut self) -> Option<Result<Record<'static>, McapError>> {
        loop {
            match self.reader.next_event()? {
                Ok(LinearReadEvent::Record { opcode, data }) => {
                    return Some(mcap::parse_record(opcode, data).map(Record::into_owned));
                }
                Ok(LinearReadEvent::ReadRequest(wanted)) => {
                    match self.bytes.read(self.reader.insert(wanted)) {
                        Ok(read) => self.reader.notify_read(read),
                        Err(error) => return Some(Err(error.into())),
                    }
                }
                Err(error) => return Some(Err(error)),
            }
        }
    }
}

impl Iterator for Records {
    type Item = Result<Record<'static>, McapError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.first.take().map(Ok).or_else(|| self.read())
    }
}
