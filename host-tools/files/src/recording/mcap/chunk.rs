//! Chunk of an MCAP file: compressed records with one CRC.

use std::io::{Cursor, Read};

use mcap::McapError;
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use ruzstd::decoding::StreamingDecoder;
use ruzstd::decoding::errors::{FrameDecoderError, ReadFrameHeaderError};

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
        let content = unpacked(&data).map_err(McapError::DecompressionError)?;
        // Times, size and CRC stay; the compression has no name.
        let (same, name, length) = (&self.0[..NAME_AT - 4], [0; 4], content.len() as u64);
        Ok(Some([same, &name, &length.to_le_bytes(), &content].concat()))
    }
}

/// Decompresses the frames of zstd in `data`.
///
/// The result grows as it is decoded: the size that a chunk states may be damaged.
fn unpacked(mut data: &[u8]) -> Result<Vec<u8>, String> {
    use FrameDecoderError::ReadFrameHeaderError as InHeader;
    let mut content = Vec::new();
    while !data.is_empty() {
        let mut decoder = match StreamingDecoder::new(&mut data) {
            Ok(decoder) => decoder,
            Err(InHeader(ReadFrameHeaderError::SkipFrame { length, .. })) => {
                data = data.get(length as usize..).unwrap_or_default();
                continue;
            }
            Err(error) => return Err(error.to_string()),
        };
        let room = (LONGEST + 1).saturating_sub(content.len()) as u64;
        let read = decoder.by_ref().take(room).read_to_end(&mut content);
        read.map_err(|error| error.to_string())?;
        if content.len() > LONGEST {
            return Err(format!("more than {LONGEST} bytes in a chunk"));
        }
    }
    Ok(content)
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

#[cfg(test)]
mod tests {
    use super::*;

    fn packed(content: &[u8]) -> Vec<u8> {
        ruzstd::encoding::compress_to_vec(content, ruzstd::encoding::CompressionLevel::Fastest)
    }

    /// Chunk of zstd that states this size of its content.
    fn chunk(stated: u64, data: &[u8]) -> Chunk {
        let mut chunk = vec![0; 16];
        chunk.extend(stated.to_le_bytes());
        // No CRC.
        chunk.extend([0; 4]);
        chunk.extend(4u32.to_le_bytes());
        chunk.extend(b"zstd");
        chunk.extend((data.len() as u64).to_le_bytes());
        chunk.extend(data);
        Chunk(chunk)
    }

    #[test]
    fn memory_follows_content_not_stated_size() {
        let chunk = chunk(LONGEST as u64, &packed(b"few bytes"));
        let unpacked = chunk.without_zstd().unwrap().unwrap();
        assert!(unpacked.ends_with(b"few bytes"));
        let content = super::unpacked(&packed(b"few bytes")).unwrap();
        assert!(content.capacity() < 1 << 10, "{}", content.capacity());
    }

    #[test]
    fn content_beyond_the_longest_is_refused() {
        let bomb = packed(&vec![0; LONGEST + 1]);
        let error = unpacked(&bomb).unwrap_err();
        assert_eq!(error, format!("more than {LONGEST} bytes in a chunk"));
        assert_eq!(unpacked(&packed(&vec![0; 1 << 20])).unwrap().len(), 1 << 20);
    }

    #[test]
    fn frames_in_a_row_are_one_content() {
        let skipped = [b"\x50\x2a\x4d\x18\x03\x00\x00\x00abc".as_slice()].concat();
        let frames = [packed(b"one "), skipped, packed(b"two")].concat();
        assert_eq!(unpacked(&frames).unwrap(), b"one two");
        assert!(unpacked(&frames[..frames.len() - 2]).is_err());
    }
}
