//! MCAP's container, read record by record.

use std::collections::HashMap;
use std::io::Read as _;
use std::ops::Range;
use std::path::Path;

use evis_core::format::FormatError;

use super::bag::{CHANNEL, CHUNK, DATA_END, FOOTER, MAGIC, MESSAGE, SCHEMA};
use super::parse::Fields;
use crate::files::{Input, u64_at};

/// Largest record that is read, and largest chunk when it is unpacked.
const MOST_RECORD: u64 = 256 << 20;

/// Bytes of a message before its content: channel, number, two times.
const MESSAGE_HEAD: usize = 22;

/// A topic, as a channel names it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Topic {
    /// The type of its messages; empty where the file does not say.
    pub kind: String,
    pub name: String,
}

/// What a record was.
pub(super) enum Record {
    End,
    Other,
    /// A message of the topic at this place; [`BagReader::message`] has its content.
    Message(usize),
}

/// A bag that is being read.
pub(super) struct BagReader {
    input: Input,
    block: Vec<u8>,
    /// Records of the current chunk, and the next one's place in them.
    chunk: Vec<u8>,
    next: usize,
    /// Where the chunk, or the record, lies in the file.
    at: u64,
    schemas: HashMap<u16, String>,
    topics: Vec<Topic>,
    /// By number of channel.
    places: HashMap<u16, usize>,
    /// Whether the last message lies in the chunk, and where.
    message: (bool, Range<usize>),
}

impl BagReader {
    pub fn open(path: &Path) -> Result<Self, FormatError> {
        let mut reader = Self {
            input: Input::open(path)?,
            block: Vec::new(),
            chunk: Vec::new(),
            next: 0,
            at: 0,
            schemas: HashMap::new(),
            topics: Vec::new(),
            places: HashMap::new(),
            message: (false, 0..0),
        };
        reader.begin()?;
        Ok(reader)
    }

    /// Goes back to the first record. What is known of topics is kept.
    pub fn begin(&mut self) -> Result<(), FormatError> {
        self.input.seek(MAGIC.len() as u64)?;
        self.chunk.clear();
        self.next = 0;
        Ok(())
    }

    /// All that were named so far, each once.
    pub fn topics(&self) -> &[Topic] {
        &self.topics
    }

    /// The content of the last message.
    pub fn message(&self) -> &[u8] {
        let (in_chunk, range) = &self.message;
        let bytes = if *in_chunk { &self.chunk } else { &self.block };
        bytes.get(range.clone()).unwrap_or_default()
    }

    /// The part of the file that has been read.
    pub fn part(&self) -> f64 {
        self.input.part()
    }

    /// The last record, or the chunk that it is in, is damaged.
    pub fn damaged(&self, what: &str) -> FormatError {
        self.input.damaged(self.at, what)
    }

    /// Reads the next record; the inner error says what is wrong with it.
    pub fn step(&mut self) -> Result<Result<Record, String>, FormatError> {
        if self.next < self.chunk.len() {
            let chunk = std::mem::take(&mut self.chunk);
            let mut fields = Fields::new(&chunk);
            fields.skip(self.next);
            let head = (|| Some((*fields.bytes(1)?.first()?, fields.u64()?)))();
            let start = fields.at();
            let record =
                head.and_then(|(op, length)| Some((op, fields.bytes(usize::try_from(length).ok()?)?)));
            self.next = fields.at();
            let step = match record {
                Some((op, record)) => self.record(op, record, start),
                None => Err("a record leads outside of its chunk".into()),
            };
            self.message.0 = true;
            self.chunk = chunk;
            return Ok(step);
        }
        self.at = self.input.at();
        let mut block = std::mem::take(&mut self.block);
        let step = self.outer(&mut block);
        self.message.0 = false;
        self.block = block;
        step
    }

    fn outer(&mut self, block: &mut Vec<u8>) -> Result<Result<Record, String>, FormatError> {
        self.input.read_block(block, 9)?;
        let (Some(&op), Some(length)) = (block.first(), u64_at(block, 1)) else {
            return Ok(Err("it ends before its end mark".into()));
        };
        let left = self.input.length().saturating_sub(self.input.at());
        if length > left.min(MOST_RECORD) {
            return Ok(Err(format!("a record would be {length} bytes long, and {left} are left")));
        }
        if matches!(op, DATA_END | FOOTER) {
            return Ok(Ok(Record::End));
        }
        self.input.read_block(block, length as usize)?;
        if op != CHUNK {
            return Ok(self.record(op, block, 0));
        }
        let mut fields = Fields::new(block);
        let head = (|| {
            fields.u64()?;
            fields.u64()?;
            let size = fields.u64()?;
            fields.u32()?;
            let compression = fields.text()?;
            let length = fields.u64()?;
            Some((size, compression, fields.bytes(usize::try_from(length).ok()?)?))
        })();
        let Some((size, compression, records)) = head else {
            return Ok(Err("a chunk ends within its head".into()));
        };
        if size > MOST_RECORD {
            return Ok(Err(format!("a chunk would be {size} bytes long")));
        }
        self.chunk.clear();
        self.next = 0;
        let unpacked = match compression {
            "" => (&mut &records[..]).take(size).read_to_end(&mut self.chunk),
            "lz4" => lz4_flex::frame::FrameDecoder::new(records).take(size).read_to_end(&mut self.chunk),
            "zstd" => rust_zstd::DecompressReader::new(records).take(size).read_to_end(&mut self.chunk),
            other => {
                return Ok(Err(format!("a chunk is packed by '{other}', and only lz4 and zstd are read")));
            }
        };
        Ok(match unpacked {
            Ok(_) => Ok(Record::Other),
            Err(error) => Err(format!("a chunk cannot be unpacked ({error})")),
        })
    }

    /// A record whose content lies `start` bytes behind the beginning of its buffer.
    fn record(&mut self, op: u8, bytes: &[u8], start: usize) -> Result<Record, String> {
        let mut fields = Fields::new(bytes);
        match op {
            SCHEMA => {
                let schema = (|| Some((fields.u16()?, fields.text()?)))();
                let (id, name) = schema.ok_or("a schema ends within its name")?;
                self.schemas.entry(id).or_insert_with(|| name.to_owned());
            }
            CHANNEL => {
                let channel = (|| Some((fields.u16()?, fields.u16()?, fields.text()?)))();
                let (id, schema, topic) = channel.ok_or("a channel ends within its topic")?;
                if !self.places.contains_key(&id) {
                    let kind = self.schemas.get(&schema).cloned().unwrap_or_default();
                    let topic = Topic { kind, name: topic.to_owned() };
                    let known = self.topics.iter().position(|known| *known == topic);
                    let place = known.unwrap_or(self.topics.len());
                    if known.is_none() {
                        self.topics.push(topic);
                    }
                    self.places.insert(id, place);
                }
            }
            MESSAGE => {
                let id = fields.u16().filter(|_| bytes.len() >= MESSAGE_HEAD);
                let id = id.ok_or("a message ends within its head")?;
                if let Some(place) = self.places.get(&id) {
                    self.message.1 = start + MESSAGE_HEAD..start + bytes.len();
                    return Ok(Record::Message(*place));
                }
            }
            _ => {}
        }
        Ok(Record::Other)
    }
}
